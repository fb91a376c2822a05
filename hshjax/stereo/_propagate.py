"""Normals handed on between neighbours: a pixel takes one of theirs where it explains the photographs as well.

A pixel alone often has several minima, and where light comes from other parts of the object the wrong one may be the
deeper. What neighbours have found is looked at, and agreement with them counts.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float, Int
from hshjax.photographs import numbers
from hshjax.stereo._chart import from_chart
from hshjax.stereo._misfit import misfit
from hshjax.stereo._shading import AbstractShadingTable

FAR = (8, 4, 2, 16)
"""Distances of far neighbours, one a sweep, in turn."""

TURN = 0.5
"""Where that of a difference between neighbours ends to grow, a chord of unit normals: 29 degrees are an edge."""


def neighbours(mask: Bool[np.ndarray, "rows columns"], distance: int = 1) -> Int[np.ndarray, "pixels 8"]:
    """Numbers of the eight neighbours of every pixel of a mask, row by row, at a distance; -1 where there is none."""
    number = numbers(np.pad(mask, distance)).astype(np.int32)
    row, column = np.nonzero(mask)
    steps = [(i, j) for i in (0, 1, 2) for j in (0, 1, 2) if (i, j) != (1, 1)]
    return np.stack([number[row + distance * i, column + distance * j] for i, j in steps], axis=1)


@eqx.filter_jit
def take_over(
    table: AbstractShadingTable,
    values: Float[Array, "n lights"],
    trust: Float[Array, "n lights"],
    scale: Float[Array, "n 1"],
    pq: Float[Array, "n 2"],
    near: Float[Array, "n 8 2"],
    far: Float[Array, "n 8 2"],
    there: Bool[Array, "n 8"],
    smoothness: Float[Array, ""],
) -> Float[Array, "n 2"]:
    """The best of a pixel's own normal, those of pixels near and far, the mean of the near ones and normals between
    that and its own: by misfit and by agreement with the near ones.

    - `trust`: before residuals are looked at. - `scale`: of a pixel's residuals. - `there`: which near ones exist.
    """
    around = from_chart(near)
    count = jnp.maximum(jnp.sum(there, axis=1), 1).astype(values.dtype)
    mean = jnp.sum(jnp.where(there[..., None], near, 0), axis=1) / count[:, None]

    def cost(candidate):
        chord = jnp.sqrt(jnp.sum((from_chart(candidate)[:, None] - around) ** 2, axis=-1))
        fit = misfit(table, values, trust, scale, candidate)
        return fit + smoothness * jnp.sum(jnp.where(there, jnp.minimum(chord, TURN), 0), axis=1) / count

    def look(best, candidate):
        value = cost(candidate)
        better = value < best[0]
        return (jnp.where(better, value, best[0]), jnp.where(better[:, None], candidate, best[1])), None

    alone = (jnp.sum(there, axis=1) == 0)[:, None]
    mean = jnp.where(alone, pq, mean)
    between = jnp.stack([mean, (mean + pq) / 2, (mean + 3 * pq) / 4])
    candidates = jnp.concatenate([between, jnp.moveaxis(near, 1, 0), jnp.moveaxis(far, 1, 0)])
    return jax.lax.scan(look, (cost(pq), pq), candidates)[0][1]
