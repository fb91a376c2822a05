"""Models that renderers are told of, small ones of each kind; and the arithmetic of NumPy for their formulas."""

import numpy as np

import hshjax
from hshjax import bases
from hshjax.brdfs import ExpBRDF
from tests.helpers import DTYPE


def coefficients(basis, channels: int = 3, seed: int = 0) -> np.ndarray:
    """A grey diffuse series, disturbed in every function."""
    found = 0.03 * np.random.default_rng(seed).normal(size=(basis.count, channels))
    found[0] += (1.2, 0.9, 0.6)[:channels]
    return found.astype(DTYPE)


def linear(basis, target="brdf", channels=3):
    return hshjax.LinearBRDF(basis, coefficients(basis, channels), target)


def logarithm(basis, sizes, **bounds):
    rng = np.random.default_rng(1)
    parts = [(0.3 * rng.normal(size=n)).astype(DTYPE) for n in sizes]
    parts[0][:2] = -1.5, -1.0
    return hshjax.LogLinearBRDF(basis, parts, **bounds)


def half_vector(count, warp=None, difference=None, bilateral=True):
    warps = {"warp": warp or bases.LogWarp(np.asarray(0.01, DTYPE))}
    return bases.HalfVectorBasis(
        bases.total_order(count, bilateral=bilateral), **warps, difference_warp=difference or bases.IdentityWarp()
    )


def models() -> dict:
    exp = bases.IsotropicBasis(bases.HSH(2))
    return {
        "hsh": linear(bases.IsotropicBasis(bases.HSH(5))),
        "hsh foreshortened": linear(bases.IsotropicBasis(bases.HSH(3)), "foreshortened"),
        "zernike, chiral": linear(bases.IsotropicBasis(bases.Zernike(6), bilateral=False)),
        "shr grey": linear(bases.IsotropicBasis(bases.SHR(4)), channels=1),
        "helmholtz": linear(bases.HelmholtzBasis(bases.HSH(2)), "half_foreshortened"),
        "helmholtz zernike": linear(bases.HelmholtzBasis(bases.Zernike(3))),
        "tensor": linear(bases.TensorBasis(bases.SHR(2))),
        "constant": linear(bases.IsotropicBasis(bases.HSH(0))),
        "half vector": linear(half_vector(20, bases.RootWarp())),
        "compact": logarithm(half_vector(30), (30, 8, 4), low=np.full(3, -4, DTYPE), high=np.full(3, 2, DTYPE)),
        "retro, chiral": logarithm(
            half_vector(30, bases.RationalWarp(np.asarray(0.1, DTYPE)), bases.LogWarp(np.asarray(0.02, DTYPE)), False),
            (30, 5, 5),
        ),
        "exponential": ExpBRDF(exp, coefficients(exp)),
    }


class OnNumpy:
    """Arithmetic of `hshjax.io._formula` on arrays of NumPy, float64."""

    sqrt, log, select = staticmethod(np.sqrt), staticmethod(np.log), staticmethod(np.where)

    def keep(self, name, value):
        return value

    def part(self, title):
        pass
