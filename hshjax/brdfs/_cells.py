"""Multilinear interpolation between the nodes of a grid, some of which may hold nothing."""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hshjax._typing import Array, Bool, Float, Int, Real

GRAZING = 1e-6
"""Cosine up to which a direction counts as on the horizon: 90 degrees in float32, or with six digits in radians."""

AT_NODE = 1e-4
"""Share of a cell, up to which a place counts as at the node itself: float32 knows a place in a cell to 1e-5."""

End = tuple[Int[Array, " n"], Float[Array, " n"]]
"""An index a place, and its weight."""


def cell(nodes: Float[Array, " nodes"], x: Float[Array, " n"]) -> tuple[End, End]:
    """The nodes on either side of x with their weights; beyond the ends, all of it the last node's."""
    below = jnp.searchsorted(nodes[1:-1], x, side="right", method="scan").astype(jnp.int32)
    low, high = nodes[below], nodes[below + 1]
    fraction = jnp.clip((x - low) / (high - low), 0, 1)
    return (below, 1 - fraction), (below + 1, fraction)


def periodic_cell(nodes: Float[Array, " nodes"], phi: Float[Array, " n"], period: float) -> tuple[End, End]:
    """The same on a circle; with a single node, that one twice."""
    count = nodes.size
    below = jnp.searchsorted(nodes, phi, side="right", method="scan").astype(jnp.int32) - 1
    below = jnp.where(below < 0, count - 1, below)
    above = jnp.where(below == count - 1, 0, below + 1)
    gap = jnp.mod(nodes[above] - nodes[below], period) if count > 1 else period
    fraction = jnp.mod(phi - nodes[below], period) / gap
    return (below, 1 - fraction), (above, fraction)


def interpolated(
    values: Float[Array, "*grid channels"], measured: Bool[Array, "*grid"] | None, ends: Sequence[tuple[End, End]]
) -> Float[Array, "n channels"]:
    """Σ weight x value over the corners of cells, `ends` being those along every axis of the grid.

    With `measured`, over the corners that are, the weights scaled to a sum of 1; 0 where none is, or only ones whose
    weight along an axis is none but for rounding: see `AT_NODE`.
    """
    first = ends[0][0][1]
    total = jnp.zeros((first.size, values.shape[-1]), first.dtype)
    found, within = jnp.zeros(first.size, first.dtype), jnp.zeros(first.size, bool)
    for corner in product(*ends):
        index = tuple(where for where, _ in corner)
        weight = least = corner[0][1]
        for _, part in corner[1:]:
            weight, least = weight * part, jnp.minimum(least, part)
        value = values[index]
        if measured is not None:
            there = measured[index]
            weight, value = jnp.where(there, weight, 0), jnp.where(there[:, None], value, 0)
            found += weight
            within |= there & (least > AT_NODE)
        total += weight[:, None] * value
    if measured is None:
        return total
    return jnp.where(within[:, None], total / jnp.where(within, found, 1)[:, None], 0)


def walls(nodes: np.ndarray, end: float) -> np.ndarray:
    """Where the cells of nodes on a line meet: halfway between them; 0 and `end` outside."""
    return np.concatenate([[0], (nodes[1:] + nodes[:-1]) / 2, [end]])


def arcs(nodes: np.ndarray, period: float) -> np.ndarray:
    """Lengths of the cells of nodes on a circle, halfway to the next ones."""
    after = np.diff(np.append(nodes, nodes[0] + period))
    return (after + np.roll(after, 1)) / 2


class Axis(NamedTuple):
    """Nodes within [0, end], or [0, end) of one that is not `closed`, which goes round."""

    nodes: Float[Array, " nodes"]
    end: float
    closed: bool


def check_grid(
    values: Array, measured: Array | None, channel_names: tuple[str, ...], axes: dict[str, Axis], least: str
) -> None:
    """ValueError unless values and mask have the shape of the axes, closed axes two nodes and others one, as `least`
    says, and nodes rise. Nodes that are traced are not looked at.
    """
    nodes = tuple(axis.nodes.size for axis in axes.values())
    expected = (*nodes, len(channel_names))
    if values.shape != expected:
        got = values.shape
        raise ValueError(f"values of a table must have shape {expected}, by its nodes and channel names, got {got}")
    if measured is not None and measured.shape != nodes:
        raise ValueError(f"measured of a table must have shape {nodes}, by its nodes, got {measured.shape}")
    if any(axis.nodes.size < (2 if axis.closed else 1) for axis in axes.values()):
        raise ValueError(f"a table needs {least}, got {nodes}")
    for name, axis in axes.items():
        if not isinstance(axis.nodes, Tracer):
            _check_nodes(name, np.asarray(axis.nodes, np.float64), axis.end, closed=axis.closed)


def _check_nodes(name: str, nodes: np.ndarray, end: float, *, closed: bool) -> None:
    """ValueError unless they rise within [0, end], or [0, end) if not `closed`."""
    slack = 1e-6 * end  # a right angle in float32 may lie above one in float64
    last = nodes[-1] <= end + slack if closed else nodes[-1] < end - slack
    if not (nodes[0] >= 0 and last and np.all(np.diff(nodes) > 0)):
        bracket = "]" if closed else ")"
        raise ValueError(
            f"{name} of a table must rise within [0, {end:.6g}{bracket}, got {nodes[0]:.6g} ... {nodes[-1]:.6g}"
        )


def root(theta: Real) -> Real:
    """sqrt(θ), with derivative 0 at 0."""
    positive = theta > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, theta, 1)), 0)
