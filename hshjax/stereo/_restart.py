"""A second start for every pixel: the best of normals all over the hemisphere, under the materials that were learned.

Lambert's law takes a pixel that many lights make shine, or that is lit by other parts, to a minimum far from the best.
"""

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.stereo._misfit import misfit
from hshjax.stereo._refine import Estimate, predicted, robust_refine
from hshjax.stereo._shading import AbstractShadingTable
from hshjax.stereo._trust import SHADOWS, initial_trust, residual_scale

FEW = 6
"""Steps before two minima are compared."""


@eqx.filter_jit
def refine_from_both(
    table: AbstractShadingTable, values: Float[Array, "n lights"], known: Float[Array, "n lights"],
    pq: Float[Array, "n 2"], rounds: int, steps: int,
) -> Float[Array, "n 2"]:  # fmt: skip
    """`robust_refine` from given normals or from the table's `best_node`: from where a few steps lead to what fits
    better.

    Dark values count as `SHADOWS` where minima are compared: one that wants light there needs a shadow cast.
    """
    plain, counted = initial_trust(values, known), initial_trust(values, known, SHADOWS)
    starts = pq, table.best_node(values, counted)
    found = [robust_refine(table, values, plain, begin, 1, FEW)[0] for begin in starts]
    scale = jnp.minimum(*(_scale(table, values, plain, estimate) for estimate in found))
    own, other = (misfit(table, values, counted, scale, estimate.pq) for estimate in found)
    begin = jnp.where((other < own)[:, None], found[1].pq, found[0].pq)
    return robust_refine(table, values, plain, begin, rounds, steps)[0].pq


def _scale(table: AbstractShadingTable, values: Array, plain: Array, estimate: Estimate) -> Float[Array, "n 1"]:
    return residual_scale(values - predicted(table, estimate), plain > 0)
