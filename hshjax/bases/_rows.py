"""Design rows: every function of a basis at every point, in blocks."""

from functools import lru_cache

import jax.numpy as jnp
import numpy as np

from hshjax._special import Recurrences, blockwise, powers, recurrence, recurrences
from hshjax._typing import Array, Float

POINTS = 1024
"""Points a block: the rows of order 16 then stay near the second-level cache."""


@lru_cache
def _in_order(basis) -> tuple[Recurrences, np.ndarray]:
    """Functions by m, cosine before sine, then degree: recurrences, and their columns in the basis. Host arrays."""
    tables, columns = basis.tables(), basis.columns()
    orders = len(tables.start)
    parts = [(m, part) for m in range(orders) for part in range(2 if m else 1)]
    found = recurrences(tables, [(m, part * orders + m) for m, part in parts])
    return found, np.concatenate([columns[m, : tables.counts[m], part] for m, part in parts])


def by_function(basis, w: Float[Array, "points 3"]) -> tuple[Float[Array, "modes points"], np.ndarray]:
    """y_k(w) of one block, a function a row, and the columns k of the rows: a product does not need them in order.

    The recurrence of degrees is linear: started with Re or Im of s^m it yields the functions themselves.
    """
    (functions, columns), chart = _in_order(basis), basis.chart(w)
    power = powers(chart.square, chart.odd, len(basis.tables().start))
    return recurrence(functions, chart.x, power.reshape(2 * power.shape[1], w.shape[0])), columns


def rows(basis, w: Float[Array, "points 3"]) -> Float[Array, "points modes"]:
    """y_1(w) ... y_K(w)."""

    def block(w):
        found, columns = by_function(basis, w)
        return found[jnp.asarray(np.argsort(columns), jnp.int32)].T

    return blockwise(block, POINTS, w)
