"""Design rows: every function of a basis at every point, in blocks."""

from functools import lru_cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from hshjax._special import blockwise, powers, recurrence
from hshjax._typing import Array, Float

POINTS = 1024
"""Points a block: the rows of order 16 then stay near the second-level cache."""


class _Order(NamedTuple):
    """Functions by m, cosine before sine, then degree: each m, and each of the two, is a recurrence. Host arrays."""

    steps: np.ndarray  # (modes, 4)
    columns: np.ndarray  # (modes,), their columns in the basis
    powers: np.ndarray  # (modes,): Re or Im s^m, in `powers` with its first two axes made one


@lru_cache
def _order(basis) -> _Order:
    tables, columns = basis.tables(), basis.columns()
    orders, steps = len(tables.start), tables.steps()
    found = [(m, part, tables.counts[m]) for m in range(orders) for part in range(2 if m else 1)]
    return _Order(
        np.concatenate([steps[m, :count] for m, _, count in found]),
        np.concatenate([columns[m, :count, part] for m, part, count in found]),
        np.repeat([part * orders + m for m, part, _ in found], [count for *_, count in found]),
    )


def by_function(basis, w: Float[Array, "points 3"]) -> tuple[Float[Array, "modes points"], np.ndarray]:
    """y_k(w) of one block, a function a row, and the columns k of the rows: a product does not need them in order.

    The recurrence of degrees is linear: started with Re or Im of s^m it yields the functions themselves.
    """
    order, chart = _order(basis), basis.chart(w)
    power = powers(chart.square, chart.odd, len(basis.tables().start))
    starts = power.reshape(2 * power.shape[1], w.shape[0]), order.powers
    return recurrence(order.steps, chart.x, starts), order.columns


def rows(basis, w: Float[Array, "points 3"]) -> Float[Array, "points modes"]:
    """y_1(w) ... y_K(w)."""

    def block(w):
        found, columns = by_function(basis, w)
        return found[jnp.asarray(np.argsort(columns), jnp.int32)].T

    return blockwise(block, POINTS, w)
