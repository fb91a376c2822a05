"""What compact models are judged by: a table that follows the highlight, images of spheres, measured pairs, albedo."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import block_diag

from experiments.recipes._blocks import square_blocks
from hshjax import (
    DirectionalLight,
    EnvironmentMap,
    LogLinearBRDF,
    OrthographicCamera,
    angles,
    half_vector,
    half_vector_samples,
    plotting,
    sphere,
)
from hshjax.fitting._blocks import PAIRS, evaluated
from hshjax.fitting._furnace import furnace_rule
from hshjax.geometry import frame
from hshjax.io import read_exr
from hshjax.lighting import AbstractLighting, Points

SHAPE = (90, 30, 12)
"""Cells of the table in sqrt(θ_h), θ_d, φ_d."""

LARGEST = float(np.radians(80))
LAMPS = (((0.55, 0.55, 0.63), 2.0), ((-0.9, 0.3, 0.32), 1.2), ((0.2, -0.75, 0.63), 0.8))
CEILING = 80.0
"""Of a peak signal-to-noise ratio [dB]."""

POLAR = tuple(np.radians(np.arange(0, 81, 8)).tolist())
"""Of the eye in a white furnace [radians]."""

NODES = (240, 64)
"""Of half vectors there, in θ and φ: more than a fit looks at."""


class Cells(NamedTuple):
    """Pairs `(n, 3)` of the judge's table, and their weights in L2 `(n,)`."""

    wi: np.ndarray
    wo: np.ndarray
    weight: np.ndarray


class Positive(eqx.Module):
    """max(ρ, 0): measured values and networks may lie below."""

    brdf: Callable

    def __call__(self, wi, wo):
        return jnp.maximum(self.brdf(wi, wo), 0)


class Folded(eqx.Module):
    """The mean over the swap of directions and the mirror image: the nearest BRDF that is reciprocal and bilateral."""

    brdf: Callable

    def __call__(self, wi, wo):
        mi, mo = (w.at[..., 1].multiply(-1) for w in (wi, wo))
        return (self.brdf(wi, wo) + self.brdf(wo, wi) + self.brdf(mi, mo) + self.brdf(mo, mi)) / 4


def table(brdf: Callable) -> np.ndarray:
    """What a material is in the cells, reciprocal and bilateral, `(n, channels)`."""
    return np.asarray(half_vector_samples(Positive(brdf), shape=SHAPE, largest=LARGEST, grazing=0.0).value)


def cells() -> Cells:
    """The cells of every table."""
    samples = half_vector_samples(lambda wi, wo: wi[:, 2], shape=SHAPE, largest=LARGEST, grazing=0.0)
    wi, wo = np.asarray(samples.wi), np.asarray(samples.wo)
    return Cells(wi, wo, measure(wi, wo) * (wi[:, 2] * wo[:, 2]) ** 2)


def measure(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """What a cell of equal width in sqrt(θ_h), θ_d and φ_d holds of dω_i dω_o, up to a factor, `(n,)`."""
    theta_h = np.asarray(angles(half_vector(jnp.asarray(wi), jnp.asarray(wo)))[0])
    cos_d = np.linalg.norm(wi + wo, axis=1) / 2
    # dω_i dω_o = 4 cos θ_d dω_h dω_d
    return np.sin(theta_h) * np.sqrt(theta_h) * np.sqrt(1 - np.minimum(cos_d, 1) ** 2) * cos_d


def gloss(table: np.ndarray) -> float:
    """The largest value over the median one, of the mean of the channels: 1 for Lambert, thousands for a mirror."""
    mean = table.mean(axis=1)
    return float(mean.max() / np.median(mean))


def log_error(value: np.ndarray, fitted: np.ndarray, wi: np.ndarray, wo: np.ndarray) -> float:
    """1000 x mean |Δ ln(1 + ρ z)| over pairs, channels and both cosines z."""
    errors = [np.mean(np.abs(np.log1p(value * w[:, 2:]) - np.log1p(fitted * w[:, 2:]))) for w in (wi, wo)]
    return 1e3 * float(np.mean(errors))


def l2_error(value: np.ndarray, fitted: np.ndarray, weight: np.ndarray) -> float:
    """Relative, of ρ cos cos, all channels together."""
    return float(np.sqrt(np.sum(weight[:, None] * (fitted - value) ** 2) / np.sum(weight[:, None] * value**2)))


class Picture(NamedTuple):
    """Pairs of directions `(n, 3)`, pixel after pixel, that light what is seen of a sphere from +z.

    Both below 80 degrees: what is known of a material. `irradiance` `(n, channels)` has the cosine in it; `pixel`
    `(n,)` is increasing.
    """

    wi: np.ndarray
    wo: np.ndarray
    irradiance: np.ndarray
    pixel: np.ndarray


def pictures(environments: Sequence[Path], size: int = 128) -> list[Picture]:
    """Three lamps on `size` pixels, and each environment, averaged over boxes to 64 x 32 pixels, on half as many."""
    lamps = [DirectionalLight(jnp.asarray(towards), jnp.asarray(power)) for towards, power in LAMPS]
    found = [_picture(_ball(size), lamps[0] + lamps[1] + lamps[2])]
    for path in environments:
        boxes = square_blocks(np.asarray(read_exr(path), float), 32).mean((1, 3))
        found.append(_picture(_ball(size // 2), EnvironmentMap(jnp.asarray(boxes), up="y")))
        # Maps of one size light the same pairs, which are then evaluated once.
        if len(found) > 2 and np.array_equal(found[-1].wi, found[1].wi):
            found[-1] = found[1]._replace(irradiance=found[-1].irradiance)
    return found


def _ball(size: int) -> np.ndarray:
    camera = OrthographicCamera(jnp.asarray([0.0, 0, 1]), jnp.asarray([0.0, 1, 0]), resolution=(size, size))
    normals = np.asarray(sphere(camera).normal).reshape(-1, 3)
    return normals[normals[:, 2] >= np.cos(LARGEST)]


def _picture(normals: np.ndarray, light: AbstractLighting) -> Picture:
    anywhere = Points(jnp.eye(3)[None], None, jnp.zeros(1, jnp.int32), (1,))
    direction, irradiance = (np.asarray(part)[0] for part in jax.tree.leaves(light.incident(anywhere)))
    frames = np.asarray(frame(jnp.asarray(normals)))
    wi, wo, power, count = [], [], [], []
    for turn in frames:
        local = direction @ turn.T
        lit = local[:, 2] > np.cos(LARGEST)
        wi.append(local[lit])
        wo.append(np.broadcast_to(turn[:, 2], wi[-1].shape))
        power.append(np.broadcast_to(irradiance, direction.shape)[lit] * local[lit, 2:])
        count.append(np.count_nonzero(lit))
    parts = (np.concatenate(part).astype(np.float32) for part in (wi, wo, power))
    return Picture(*parts, np.repeat(np.arange(len(normals)), count))


def images(brdf: Callable, pictures: list[Picture]) -> list[np.ndarray]:
    """Radiance `(pixels, channels)` of each picture; of several materials together, each is lit in its own channels."""
    found = []
    for _, alike in groupby(pictures, key=lambda one: id(one.wi)):
        found += _lit(brdf, list(alike))
    return found


def _lit(brdf: Callable, pictures: list[Picture]) -> list[np.ndarray]:
    """Pictures of the same pairs: each is evaluated once."""
    wi, wo, pixel = pictures[0].wi, pictures[0].wo, pictures[0].pixel
    found: list[np.ndarray] = []
    for start in range(0, len(pixel), PAIRS):
        part = slice(start, start + PAIRS)
        value = evaluated(brdf, wi[part], wo[part])
        first = np.flatnonzero(np.diff(pixel[part], prepend=-1))
        found = found or [np.zeros((pixel[-1] + 1, value.shape[1])) for _ in pictures]
        for radiance, one in zip(found, pictures, strict=True):
            lit = value.reshape(len(value), -1, one.irradiance.shape[1]) * one.irradiance[part, None]
            radiance[pixel[part][first]] += np.add.reduceat(lit.reshape(value.shape), first, axis=0)
    return found


def psnr(truth: list[np.ndarray], fitted: list[np.ndarray]) -> float:
    """Mean over pictures [dB], each exposed as its truth and shown in sRGB."""
    found = []
    for a, b in zip(truth, fitted, strict=True):
        factor = plotting.exposure(a[None])
        found.append(min(CEILING, plotting.psnr(b[None], a[None], factor)))
    return float(np.mean(found))


def largest_albedo(brdf: Callable, polar: Sequence[float] = POLAR) -> np.ndarray:
    """Of each channel, over these angles of the eye: integrals over half vectors, on nodes that follow highlights."""
    wi, wo, weights = _furnaces(tuple(polar))
    value = evaluated(brdf, wi, wo)
    parts = np.split(value, np.cumsum([weight.size for weight in weights])[:-1])
    return np.max([weight @ part for weight, part in zip(weights, parts, strict=True)], axis=0)


@lru_cache
def _furnaces(polar: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Lit pairs of all angles, one after the other, and the weights of each angle."""
    wi, wo, weights = [], [], []
    for angle in polar:
        towards, eye, weight = furnace_rule(angle, NODES)
        lit = weight > 0
        wi.append(towards[lit])
        wo.append(np.broadcast_to(eye, wi[-1].shape))
        weights.append(weight[lit])
    return np.concatenate(wi), np.concatenate(wo), weights


def together(models: Sequence[LogLinearBRDF]) -> LogLinearBRDF:
    """Models over one basis as one of all their channels: functions are evaluated once."""
    first = models[0]
    return LogLinearBRDF(
        first.basis,
        list(jnp.concatenate([model.matrix for model in models], axis=1).T),
        jnp.asarray(block_diag(*(np.asarray(model.mixing) for model in models))),
        jnp.concatenate([model.low for model in models]),
        jnp.concatenate([model.high for model in models]),
    )
