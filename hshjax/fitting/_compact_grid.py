"""Samples on a grid of half and difference angles: sums over them in the time of three small products."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from hshjax.bases import HalfVectorBasis, IdentityWarp
from hshjax.bases._half_vector import half_chart
from hshjax.bases._half_vector_grid import separated
from hshjax.fitting._compact_rows import AbstractRows

ROUNDING = 64
"""Units in the last place of a component of a direction: what lies closer counts as one level."""

NARROW = 1e-4
"""Levels of cos 2φ_d that lie closer are never one: a degree from 0 makes six times as much."""

SPARSE = 4
"""Cells for each sample up to which samples count as a grid."""


class Grid(NamedTuple):
    """Levels of 1 - cos θ_h, 1 - cos θ_d and cos 2φ_d, and the cell of every sample in the array of all of them."""

    half: np.ndarray
    difference: np.ndarray
    cosine: np.ndarray
    cell: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.half.size, self.difference.size, self.cosine.size


def find_grid(wi: np.ndarray, wo: np.ndarray, precision: float = np.finfo(np.float64).eps) -> Grid | None:
    """The grid that pairs `(n, 3)` lie on, or None where they are scattered.

    `precision`: of the directions, as they were given. Levels must be apart by more than what it makes of one.
    """
    identity = IdentityWarp()
    chart = half_chart(identity, jnp.asarray(wi), jnp.asarray(wo), identity)
    u, v, re, im = (np.asarray(part) for part in (chart.u, chart.v, *chart.turn))
    least = ROUNDING * precision
    h, d = np.sqrt(2 * u), np.sqrt(2 * v)  # about sines, which rounding moves by as much wherever they are
    azimuthal = (h > least) & (d > least)  # elsewhere φ_d has no meaning, and functions of it vanish
    cosine = np.where(azimuthal, re / np.where(azimuthal, np.hypot(re, im), 1), 1.0)
    blurred = min(least / min(np.min(one[azimuthal], initial=1) for one in (h, d)), NARROW)
    levels, places, cells = [], [], 1
    for coordinate, tolerance in ((h, least), (d, least), (cosine, blurred)):
        found = _levels(coordinate, tolerance)
        cells *= found[0].size
        if cells > SPARSE * len(wi) or np.max(np.abs(found[0][found[1]] - coordinate)) > tolerance:
            return None
        levels.append(found[0])
        places.append(found[1])
    half, difference, azimuth = levels
    cell = np.ravel_multi_index(tuple(places), [axis.size for axis in levels])
    return Grid(half**2 / 2, difference**2 / 2, azimuth, np.asarray(cell))


def _levels(x: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """The means of what lies together, increasing, and to which of them each belongs."""
    order = np.argsort(x, kind="stable")
    first = np.r_[True, np.diff(x[order]) > tolerance]
    place = np.empty(x.size, int)
    place[order] = np.cumsum(first) - 1
    return np.bincount(place, x) / np.bincount(place), place


class _Products(NamedTuple):
    """Of the functions of two azimuthal orders, `rows` and `columns`: products of factors along each axis.

    `half` `(j j, h)`, `difference` `(d, k k)`, `azimuth` `(f,)`; `place` `(rows, columns)`: which of their sums
    `(j, j, k, k)` belongs to a pair of functions.
    """

    rows: np.ndarray
    columns: np.ndarray
    half: np.ndarray
    difference: np.ndarray
    azimuth: np.ndarray
    place: np.ndarray


class GridRows(AbstractRows):
    """Functions of a basis on a grid, by their factors: no row is formed.

    Σ_s w_s B_a B_b is a sum over φ_d, then over θ_d, then over θ_h; the products of factors that it takes are few.
    """

    def __init__(self, basis: HalfVectorBasis, grid: Grid):
        self.grid = grid
        self.half, self.difference, self.azimuth, place = separated(basis, grid.half, grid.difference, grid.cosine)
        self.order, self.j, self.k = place.T
        orders = range(len(self.azimuth))
        self.members = [np.flatnonzero(self.order == p) for p in orders]
        self.products = [self._products(p, q) for p in orders for q in range(p + 1)]

    def _products(self, p: int, q: int) -> "_Products":
        """Of two azimuthal orders: what their functions multiply to along each axis, and where their sums belong."""
        a, b = self.members[p], self.members[q]
        jp, jq, kp, kq = (1 + max(degree[t], default=0) for degree in (self.j, self.k) for t in (a, b))
        shape = jp, jq, kp, kq
        place = np.asarray(
            np.ravel_multi_index((self.j[a][:, None], self.j[b][None], self.k[a][:, None], self.k[b][None]), shape)
        )
        by_half = (self.half[p, :jp, None] * self.half[q, None, :jq]).reshape(jp * jq, -1)
        by_difference = (self.difference[p, :kp, None] * self.difference[q, None, :kq]).reshape(kp * kq, -1)
        return _Products(a, b, by_half, by_difference.T, self.azimuth[p] * self.azimuth[q], place)

    def _on_grid(self, values: np.ndarray) -> np.ndarray:
        """Sums of `(n, sets)` in the cells, `(sets, h, d, f)`."""
        shape = self.grid.shape
        cells = int(np.prod(shape))
        dense = [np.bincount(self.grid.cell, column, minlength=cells) for column in values.T]
        return np.stack(dense).reshape(-1, *shape)

    def gram(self, weight):
        dense, count = self._on_grid(weight), self.order.size
        found = np.zeros((len(dense), count, count))
        for one in self.products:
            inner = (dense @ one.azimuth) @ one.difference
            sums = np.matmul(one.half, inner).reshape(len(dense), -1)[:, one.place.ravel()]
            part = sums.reshape(len(dense), *one.place.shape)
            found[:, one.rows[:, None], one.columns] = part
            found[:, one.columns[:, None], one.rows] = np.swapaxes(part, 1, 2)
        return found

    def moment(self, weighted):
        dense = self._on_grid(weighted)
        found = np.zeros((weighted.shape[1], self.order.size))
        for p, members in enumerate(self.members):
            sums = self.half[p] @ ((dense @ self.azimuth[p]) @ self.difference[p].T)
            found[:, members] = sums[:, self.j[members], self.k[members]]
        return found

    def evaluate(self, columns):
        h, d, _ = self.grid.shape
        channels = columns.shape[1]
        parts = np.zeros((h, d, channels, len(self.azimuth)))
        for p, members in enumerate(self.members):
            matrix = np.zeros((*self.half.shape[1:2], *self.difference.shape[1:2], channels))
            matrix[self.j[members], self.k[members]] = columns[members]
            inner = np.einsum("jh,jkc->hck", self.half[p], matrix, optimize=True)
            parts[..., p] = np.swapaxes(inner @ self.difference[p], 1, 2)
        dense = np.moveaxis(parts @ self.azimuth, 2, -1)
        return dense.reshape(-1, channels)[self.grid.cell]
