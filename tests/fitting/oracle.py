"""Norms, designs and least squares in numpy, written from section 4 of the mathematics and not from the library."""

import math

import equinox as eqx
import numpy as np

from hshjax.samples import Samples

# name: (p of the target (z_i z_o)^p ρ, exponent of the fit's weight, exponent of the judge's weight on ρ, largest θ)
NORM_TABLE = {
    "A": (0.0, 1.0, 1.0, math.pi / 2),
    "B": (0.5, 0.0, 1.0, math.pi / 2),
    "C": (0.0, 0.0, 1.0, math.pi / 2),
    "D": (1.0, 0.0, 2.0, math.pi / 2),
    "E": (0.0, 1.0, 1.0, math.radians(80)),
}
TARGETS = {"A": "brdf", "B": "half_foreshortened", "C": "brdf", "D": "foreshortened", "E": "brdf"}


@eqx.filter_jit
def values(model, wi, wo):
    """A model at pairs, compiled once for each class and shape."""
    return model(wi, wo)


def host(*arrays) -> list[np.ndarray]:
    return [np.asarray(a, np.float64) for a in arrays]


def weighted_design(basis, samples: Samples, norm: str) -> tuple[np.ndarray, np.ndarray]:
    """sqrt(w) B and sqrt(w) f."""
    p, fit, _, max_theta = NORM_TABLE[norm]
    wi, wo, value, weight = host(samples.wi, samples.wo, samples.value, samples.weight)
    cosines = wi[:, 2] * wo[:, 2]
    inside = np.minimum(wi[:, 2], wo[:, 2]) >= math.cos(max_theta) - 1e-12
    root = np.sqrt(weight * cosines**fit * inside)[:, None]
    return root * host(basis(samples.wi, samples.wo))[0], root * (cosines**p)[:, None] * value


def least_squares(basis, samples: Samples, norm: str, gamma: np.ndarray | None = None) -> np.ndarray:
    """The coefficients by numpy's SVD, a penalty as rows below the design."""
    design, target = weighted_design(basis, samples, norm)
    if gamma is not None:
        design = np.concatenate([design, np.diag(np.sqrt(gamma))])
        target = np.concatenate([target, np.zeros((gamma.size, target.shape[1]))])
    return np.linalg.lstsq(design, target, rcond=None)[0]


def condition(basis, samples: Samples, norm: str) -> float:
    """2-norm condition number of the weighted design."""
    return float(np.linalg.cond(weighted_design(basis, samples, norm)[0]))


def judged(model, samples: Samples, norm: str) -> tuple[np.ndarray, np.ndarray]:
    """Roots of Σ w |ρ - ρ̂|² and Σ w |ρ|² in the judge's norm, per channel."""
    _, _, judge, max_theta = NORM_TABLE[norm]
    wi, wo, value, weight = host(samples.wi, samples.wo, samples.value, samples.weight)
    inside = np.minimum(wi[:, 2], wo[:, 2]) >= math.cos(max_theta) - 1e-12
    weight = weight * (wi[:, 2] * wo[:, 2]) ** judge * inside
    error = value - host(values(model, samples.wi, samples.wo))[0]
    return np.sqrt(weight @ error**2), np.sqrt(weight @ value**2)
