"""Half-vector functions on a grid of half and difference angles, where each is a product of three factors."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._special import radial_rows
from hshjax._typing import Array
from hshjax.bases._half_vector import HalfVectorBasis, function_layout


class Separated(NamedTuple):
    """B_t(h, d, f) = half[p, j, h] difference[p, k, d] azimuth[p, f] with (p, j, k) = place[t]. Host arrays.

    `half` `(orders, degrees, h)`, `difference` `(orders, degrees, d)`, `azimuth` `(orders, f)`, `place`
    `(functions, 3)`.
    """

    half: np.ndarray
    difference: np.ndarray
    azimuth: np.ndarray
    place: np.ndarray


def separated(basis: HalfVectorBasis, half: np.ndarray, difference: np.ndarray, cosine: np.ndarray) -> Separated:
    """Factors of bilateral functions on a grid of 1 - cos θ_h, of 1 - cos θ_d, and of cos 2φ_d.

    **Raises:** ValueError for a basis with sines of φ_d.
    """
    n = function_layout(basis.functions)
    if np.any(n.sine):
        raise ValueError("a grid of cos 2φ_d cannot tell sines; it takes a basis of functions with m >= 0")
    orders = np.arange(n.half.counts.size)[:, None]
    azimuth = np.where(orders == 0, 1, np.sqrt(2)) * np.cos(orders * np.arccos(np.clip(cosine, -1, 1)))
    along_half, along_difference = _radial(basis, jnp.asarray(half), jnp.asarray(difference))
    place = np.stack([n.p, n.j, n.k], axis=1)
    return Separated(np.asarray(along_half), np.asarray(along_difference), azimuth, place)


@eqx.filter_jit
def _radial(basis: HalfVectorBasis, half: Array, difference: Array) -> tuple[Array, Array]:
    n = function_layout(basis.functions)
    orders = jnp.arange(n.half.counts.size, dtype=half.dtype)[:, None]
    u, v = basis.warp(half), basis.difference_warp(difference)
    return (
        radial_rows(n.half, 2 * u - 1) * (u[None] ** orders)[:, None],
        radial_rows(n.difference, 2 * v - 1) * (v[None] ** orders)[:, None],
    )
