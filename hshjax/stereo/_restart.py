"""A second start for every pixel: the best of normals all over the hemisphere, under the materials that were learned.

Lambert's law takes a pixel that many lights make shine, or that is lit by other parts, to a minimum far from the best.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.bases._base import matmul
from hshjax.stereo._chart import grid
from hshjax.stereo._misfit import misfit
from hshjax.stereo._refine import Estimate, predicted, robust_refine, weigh
from hshjax.stereo._shading import SIZE, FarTable, ShadingTable
from hshjax.stereo._trust import SHADOWS, initial_trust, residual_scale
from hshjax.stereo._weights import non_negative_weights

STRIDE = 6
"""Every so manieth node of a table along each axis is looked at: about 350 normals, 6 to 11 degrees apart."""

FEW = 6
"""Steps before two minima are compared."""

TOGETHER = 512
"""Pixels that are looked at together: their normal equations at all nodes stay in the cache."""


@eqx.filter_jit
def refine_from_both(
    table: ShadingTable, values: Float[Array, "n lights"], known: Float[Array, "n lights"], pq: Float[Array, "n 2"],
    rounds: int, steps: int,
) -> Float[Array, "n 2"]:  # fmt: skip
    """`robust_refine` from given normals or from `best_node`: from where a few steps lead to what fits better.

    Dark values count as `SHADOWS` where minima are compared: one that wants light there needs a shadow cast.
    """
    plain, counted = initial_trust(values, known), initial_trust(values, known, SHADOWS)
    starts = pq, best_node(table, values, counted)
    found = [robust_refine(table, values, plain, begin, 1, FEW)[0] for begin in starts]
    scale = jnp.minimum(*(_scale(table, values, plain, estimate) for estimate in found))
    own, other = (misfit(table, values, counted, scale, estimate.pq) for estimate in found)
    begin = jnp.where((other < own)[:, None], found[1].pq, found[0].pq)
    return robust_refine(table, values, plain, begin, rounds, steps)[0].pq


@eqx.filter_jit
def best_node(
    table: ShadingTable, values: Float[Array, "n lights"], trust: Float[Array, "n lights"]
) -> Float[Array, "n 2"]:
    """The node of every `STRIDE`th that leaves the least weighted squares."""
    if not isinstance(table, FarTable):
        return _best_of_each(table, values, trust, jnp.asarray(_nodes(SIZE)[1], values.dtype))
    chosen, pq = _nodes(table.size)
    rows = table.values[chosen]
    nodes, materials, lights = rows.shape
    products = (rows[:, :, None] * rows[:, None]).reshape(-1, lights).T
    flat = rows.reshape(-1, lights).T

    def best(pixel):
        values, trust = pixel
        gram = matmul(trust[None], products).reshape(nodes, materials, materials)
        moment = matmul((trust * values)[None], flat).reshape(nodes, materials)
        return jnp.argmax(non_negative_weights(gram, moment)[1])

    return jnp.asarray(pq, values.dtype)[jax.lax.map(best, (values, trust), batch_size=TOGETHER)]


def _best_of_each(
    table: ShadingTable, values: Float[Array, "n lights"], trust: Float[Array, "n lights"], nodes: Float[Array, "m 2"]
) -> Float[Array, "n 2"]:
    """The same where every pixel has shading of its own: node by node."""

    def look(best, node):
        at = jnp.broadcast_to(node, best[1].shape)
        _, cost = weigh(table.at(at), values, trust)
        better = cost < best[0]
        return (jnp.where(better, cost, best[0]), jnp.where(better[:, None], at, best[1])), None

    begin = jnp.full_like(values[:, 0], jnp.inf), jnp.zeros((len(values), 2), values.dtype)
    return jax.lax.scan(look, begin, nodes)[0][1]


def _nodes(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of every `STRIDE`th node of a grid that lies in the disk, the centre among them, and where they are."""
    normals, inside = grid(size)
    every = np.arange(size) % STRIDE == size // 2 % STRIDE
    chosen = np.flatnonzero(inside & np.outer(every, every).ravel())
    return chosen, normals[chosen, :2] / (1 + normals[chosen, 2:])


def _scale(table: ShadingTable, values: Array, plain: Array, estimate: Estimate) -> Float[Array, "n 1"]:
    return residual_scale(values - predicted(table, estimate), plain > 0)
