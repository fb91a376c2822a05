"""Radial functions of neighbouring azimuthal orders, by those of the lowest of them: sums become products of matrices.

All p_j^m of one m obey a recurrence, which passes through memory at every degree. Yet p_j^m is a polynomial, and so a
sum of p_0^l ... p_j^l for any l. With l the lowest of `WIDTH` neighbours the numbers that connect them stay small (44
at order 16, 170 at 32; for slopes 1800 and 27000), which they do not for l = 0 and large m. In float32 they cost no
digit of the largest value; of gradients that are small beside the largest, inside, they cost half of one at order 32.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hshjax._special import RadialTables, Recurrences, recurrences

WIDTH = 4
"""Azimuthal orders in a band: 8 rows of a matrix for each channel; twice as many lose two bits at order 16."""


class Band(NamedTuple):
    """Azimuthal orders `first`, `first + 1`, ... Host arrays in float64, 0 where an order has no such degree."""

    first: int
    degrees: slice  # of the first order, among the rows of all bands
    values: np.ndarray  # (orders, degrees, degrees): p_j^m = Σ_k values[m - first, j, k] p_k^first
    slopes: np.ndarray  # the same of d/dx p_j^m

    @property
    def orders(self) -> slice:
        return slice(self.first, self.first + len(self.values))


@lru_cache
def bands(basis) -> tuple[Band, ...]:
    """All azimuthal orders of a basis of single directions."""
    tables, found, begin = basis.tables(), [], 0
    for first in range(0, len(tables.start), WIDTH):
        # Fewer radial functions at a higher order, in all bases: those of the first span the others.
        end = begin + int(tables.counts[first])
        here = range(first, min(first + WIDTH, len(tables.start)))
        values = np.stack([_values(tables, first, m) for m in here])
        found.append(Band(first, slice(begin, end), values, values @ _slopes(tables, first)))
        begin = end
    return tuple(found)


@lru_cache
def first_orders(basis) -> Recurrences:
    """The radial functions of the first order of every band."""
    return recurrences(basis.tables(), [(band.first, 0) for band in bands(basis)])


def _times_x(tables: RadialTables, m: int) -> np.ndarray:
    """x p_k^m = Σ_l found[k, l] p_l^m; of the last k only what is below it, for no polynomial here goes beyond."""
    count = tables.counts[m]
    slope, shift, back = (table[m, 1:count] for table in (tables.slope, tables.shift, tables.back))
    found = np.diag(1 / slope, 1)
    found[np.arange(count - 1), np.arange(count - 1)] = -shift / slope
    found[np.arange(1, count - 1), np.arange(count - 2)] = (back / slope)[1:]
    return found


def _values(tables: RadialTables, first: int, m: int) -> np.ndarray:
    """p_j^m by p_k^first: the recurrence of m, for coefficients instead of values."""
    size = tables.counts[first]
    found = np.zeros((size, size))
    found[0, 0] = tables.start[m] / tables.start[first]
    _follow(tables, m, _times_x(tables, first), found, np.zeros_like(found))
    return found


def _slopes(tables: RadialTables, m: int) -> np.ndarray:
    """d/dx p_j^m by p_k^m: the derivative of the recurrence."""
    size = tables.counts[m]
    found = np.zeros((size, size))
    _follow(tables, m, _times_x(tables, m), found, np.eye(size))
    return found


def _follow(tables: RadialTables, m: int, times_x: np.ndarray, found: np.ndarray, beside: np.ndarray) -> None:
    """Rows of `found` after the first, by the recurrence of m, with slope_j times a row of `beside` in each."""
    for j in range(1, tables.counts[m]):
        found[j] = tables.slope[m, j] * (found[j - 1] @ times_x + beside[j - 1]) + tables.shift[m, j] * found[j - 1]
        if j > 1:
            found[j] -= tables.back[m, j] * found[j - 2]
