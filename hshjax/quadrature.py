"""Rules on the hemisphere and on pairs of directions, exact to a stated degree.

"Exact to degree d" means: exact for z^a times any trigonometric polynomial in φ of order b, a <= d and b <= d. The
Gram matrix of a basis of order N needs d = 2N. With `sqrt=True` half-integer powers z^{a/2} are exact as well (the
substitution z = v², at twice the nodes): products of odd HSH with functions that are polynomial in z need it.

Weights are solid angles [sr] (dω = dz dφ), cosines NOT included.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float

ANISOTROPIC_DEGREE = 16
"""Of the `pair_rule` for anisotropic materials unless one is asked for: of a degree of 64 nobody has the memory."""


class Rule(NamedTuple):
    """Directions `(n, 3)`, weights `(n,)` [sr] with sum 2π, and the degree to which the rule is exact."""

    w: Float[Array, "n 3"]
    weight: Float[Array, " n"]
    degree: int


class PairRule(NamedTuple):
    """Pairs of directions `(n, 3)`, weights `(n,)` [sr²] with sum (2π)², and the degree in either direction.

    `isotropic` says that wi lies at φ = 0 throughout: the rule is then exact only for functions of φ_i - φ_o.
    """

    wi: Float[Array, "n 3"]
    wo: Float[Array, "n 3"]
    weight: Float[Array, " n"]
    degree: int
    isotropic: bool


def polar_nodes(degree: int, *, sqrt: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Nodes z in (0, 1) and weights, host float64: exact for z^a, a <= degree (with `sqrt` also z^{a/2})."""
    if degree < 0:
        raise ValueError(f"degree must be >= 0, got {degree}")
    if sqrt:
        # z = v², dz = 2v dv: z^{a/2} becomes a polynomial of degree a + 1 <= 2 degree + 1 in v.
        v, weight = np.polynomial.legendre.leggauss(degree + 1)
        v, weight = (v + 1) / 2, weight / 2
        return v * v, 2 * v * weight
    z, weight = np.polynomial.legendre.leggauss(degree // 2 + 1)
    return (z + 1) / 2, weight / 2


def azimuth_nodes(degree: int) -> np.ndarray:
    """Equispaced φ, host float64, each of weight 2π/n: exact for trigonometric polynomials of order <= degree."""
    n = degree + 1
    return 2 * np.pi * np.arange(n) / n


def graded_azimuths(levels: int, order: int, *, nodes: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """φ in (-π, π) and weights with sum 2π, host float64: Gauss panels halved `levels` times towards φ = 0 and φ = ±π.

    For functions with narrow lobes there (specular, retro-reflective). Panels are no wider than a period of
    cos(order φ), so that products with it stay accurate.
    """
    width = min(np.pi / 4, 2 * np.pi / max(order, 1))
    edges = np.unique(np.r_[0, np.pi / 2 ** np.arange(1.0, levels + 1), np.arange(0, np.pi / 2, width)])
    edges = np.r_[edges, np.pi - edges[-2::-1]]
    t, weight = np.polynomial.legendre.leggauss(nodes)
    half = np.diff(edges)[:, None] / 2
    phi, dphi = (edges[:-1, None] + half * (1 + t)).ravel(), (half * weight).ravel()
    return np.r_[-phi[::-1], phi], np.r_[dphi[::-1], dphi]


def hemisphere_rule(degree: int, *, sqrt: bool = False, dtype=None) -> Rule:
    """Gauss-Legendre in z (or in v, z = v²) x equispaced φ."""
    z, weight = polar_nodes(degree, sqrt=sqrt)
    phi = azimuth_nodes(degree)
    w = _directions(z[:, None], phi[None, :]).reshape(-1, 3)
    weights = np.repeat(weight * (2 * np.pi / phi.size), phi.size)
    return Rule(_device(w, dtype), _device(weights, dtype), degree)


def pair_rule(degree: int, *, dtype=None) -> PairRule:
    """The product of two hemisphere rules, (degree/2 + 1)² (degree + 1)² pairs: for functions without symmetry."""
    one = hemisphere_rule(degree, dtype=dtype)
    n = one.weight.size
    wi, wo = jnp.repeat(one.w, n, axis=0), jnp.tile(one.w, (n, 1))
    return PairRule(wi, wo, jnp.repeat(one.weight, n) * jnp.tile(one.weight, n), degree, isotropic=False)


def isotropic_pair_rule(degree: int, *, azimuths: int | None = None, dtype=None) -> PairRule:
    """Pairs with wi at φ = 0: (degree/2 + 1)² nodes in (z_i, z_o) x `azimuths` (degree + 1) in φ_o.

    Exact for isotropic integrands. `azimuths` may be raised alone for lobes that are sharp in azimuth.
    """
    if azimuths is not None and azimuths < 1:
        raise ValueError(f"azimuths must be >= 1, got {azimuths}")
    z, weight = polar_nodes(degree)
    phi = azimuth_nodes(degree if azimuths is None else azimuths - 1)
    zi, zo, dphi = (a.ravel() for a in np.meshgrid(z, z, phi, indexing="ij"))
    pair_weight = (weight[:, None] * weight[None, :])[:, :, None] * np.full(phi.size, (2 * np.pi) ** 2 / phi.size)
    wi, wo = _directions(zi, np.zeros_like(zi)), _directions(zo, dphi)
    degree = min(degree, phi.size - 1)
    return PairRule(_device(wi, dtype), _device(wo, dtype), _device(pair_weight.ravel(), dtype), degree, isotropic=True)


def _directions(z: np.ndarray, phi: np.ndarray) -> np.ndarray:
    z, phi = np.broadcast_arrays(z, phi)
    rim = np.sqrt((1 - z) * (1 + z))
    return np.stack([rim * np.cos(phi), rim * np.sin(phi), z], axis=-1)


def _device(array: np.ndarray, dtype) -> Array:
    """In the asked dtype, else in the default float of the caller's configuration."""
    return jnp.asarray(array, jnp.result_type(float) if dtype is None else dtype)
