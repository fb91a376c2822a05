"""Lambert's law on values of middle ranks: the start of everything."""

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.bases._base import matmul
from hshjax.stereo._trust import initial_trust
from hshjax.stereo._weights import solve

BAND = (0.1, 0.6)
"""Ranks of values, of those that are not dark: below lie soft shadows, above highlights."""

FEWEST = 8
"""Values in the band; with fewer, all that are not dark are taken."""


@eqx.filter_jit
def scaled_normals(
    values: Float[Array, "n lights"], trust: Float[Array, "n lights"], directions: Float[Array, "... lights 3"]
) -> Float[Array, "n 3"]:
    """b = albedo x normal, of least Σ_j trust (values - b·l_j)²; (0, 0, 0) where lights with trust span no space.

    - `directions`: of all pixels, or `(n, lights, 3)`.
    """
    if directions.ndim == 2:
        products = (directions[:, :, None] * directions[:, None, :]).reshape(-1, 9)
        gram, moment = matmul(trust, products).reshape(-1, 3, 3), matmul(trust * values, directions)
    else:
        weighted = jnp.swapaxes(trust[..., None] * directions, 1, 2)
        gram, moment = matmul(weighted, directions), matmul(weighted, values[..., None])[..., 0]
    found = jnp.stack(solve([[gram[:, i, j] for j in range(3)] for i in range(3)], list(moment.T)), axis=1)
    return jnp.where(jnp.all(jnp.isfinite(found), axis=1, keepdims=True), found, 0)


def cosines(normals: Float[Array, "n 3"], directions: Float[Array, "... lights 3"]) -> Float[Array, "n lights"]:
    """b·l_j, for directions of all pixels or of each."""
    if directions.ndim == 2:
        return matmul(normals, directions.T)
    return matmul(directions, normals[..., None])[..., 0]


@eqx.filter_jit
def band_trust(values: Float[Array, "n lights"], known: Float[Array, "n lights"]) -> Float[Array, "n lights"]:
    """`initial_trust` of the values in the band, relative to `brightness`; 0 of all others."""
    lit = initial_trust(values, known)
    there = lit > 0
    count = jnp.sum(there, axis=1, keepdims=True)
    rank = jnp.argsort(jnp.argsort(jnp.where(there, values, -jnp.inf), axis=1), axis=1) - (values.shape[1] - count)
    share = rank.astype(values.dtype) / jnp.maximum(count, 1).astype(values.dtype)
    band = there & (share >= BAND[0]) & (share <= BAND[1])
    band = jnp.where(jnp.sum(band, axis=1, keepdims=True) < FEWEST, there, band)
    return jnp.where(band, lit, 0)
