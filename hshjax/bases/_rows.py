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
    parts = [(m, part) for m in range(len(tables.start)) for part in range(2 if m else 1)]
    return recurrences(tables, parts), np.concatenate([columns[m, : tables.counts[m], part] for m, part in parts])


def by_function(basis, w: Float[Array, "points 3"]) -> tuple[Float[Array, "modes points"], np.ndarray]:
    """y_k(w) of one block, a function a row, and the columns k of the rows: a product does not need them in order."""
    (functions, columns), chart = _in_order(basis), basis.chart(w)
    power = powers(chart.square, chart.odd, len(basis.tables().start))
    return recurrence(functions, chart.x, power), columns


def rows(basis, w: Float[Array, "points 3"]) -> Float[Array, "points modes"]:
    """y_1(w) ... y_K(w)."""

    def block(w):
        found, columns = by_function(basis, w)
        return found[jnp.asarray(np.argsort(columns), jnp.int32)].T

    return blockwise(block, POINTS, w)
