"""Short series written out: straight lines of arithmetic that XLA makes one kernel of.

At order 4 a sum of three channels takes six tenths of the time of `hshjax/bases/_series.py`. Programs grow with the
number of functions, and time to compile with them: `short` says up to where. Values only: derivatives have ways of
their own.
"""

from collections.abc import Callable, Iterable
from functools import partial, reduce
from operator import add
from typing import Any

import jax
import jax.numpy as jnp

from hshjax._special import blockwise, multiply
from hshjax._typing import Array, Float, Real
from hshjax.bases._kernel import kernel

FUNCTIONS = 128
"""As many coefficients, of all channels together, are written out at most: beyond, products of matrices take less."""

FEW = 1024
"""Points up to which twice as many are: one kernel starts in a third of the time of several."""

AS_ROWS = 3
"""Channels that take as long to compile as a design row."""

COLUMNS = 4
"""Columns of design rows that one kernel writes: a vector register."""

MODES = 8
"""The same of transposed rows."""

WHOLE = 2**27
"""Values of design rows times their number of columns, so many as are made at once: what all kernels run through."""

VALUES = 2**18
"""Values of a block of them, about, where there are more."""

Pair = tuple[Array, Array]


def short(functions: int, channels: int, limit: int = FUNCTIONS) -> bool:
    """Whether a series of so many functions is to be written out."""
    return 0 < functions * channels <= limit


def radial(basis, x: Real, m: int) -> list[Array]:
    """p_0, p_1 ... of the azimuthal order m."""
    start, slope, shift, back, counts = basis.tables()
    p = [jnp.full_like(x, start[m])]
    for j in range(1, counts[m]):
        following = _line(slope[m, j], shift[m, j], x) * p[-1]
        p.append(following - float(back[m, j]) * p[-2] if j > 1 else following)
    return p


def _line(slope: float, shift: float, x: Array) -> Array:
    return float(slope) * x + float(shift) if shift else float(slope) * x


def times(a: Pair | None, b: Pair | None) -> Pair | None:
    """The product of two complex numbers; None is 1."""
    return multiply(a, b) if a is not None and b is not None else a or b


def even_powers(square: Pair, orders: int) -> list[Pair | None]:
    """s^0, s^2, s^4 ... below s^orders."""
    even: list[Pair | None] = [None]
    while 2 * len(even) < orders:
        even.append(times(even[-1], square))
    return even


def sums(basis, coefficients: Float[Array, "modes channels"], w: Float[Array, "points 3"]) -> Array:
    """Σ_k c_k y_k(w), `(points, channels)`."""

    columns, orders = basis.columns(), len(basis.tables().start)

    def of_channel(coefficients, chart):
        even, one, terms = even_powers(chart.square, orders), one_by_one(coefficients), []
        for m in range(orders):
            p = radial(basis, chart.x, m)
            power = times(even[m // 2], chart.odd if m % 2 else None)
            for part in range(2 if m else 1):
                value = total(one[column] * f for column, f in zip(columns[m, :, part], p, strict=False))
                terms.append(value if power is None else value * power[part])
        return total(terms)

    def of_block(coefficients, w):
        return jnp.stack(by_channel(of_channel, coefficients, basis.chart(w)), axis=-1)

    return kernel(of_block, coefficients, w)


def by_channel(function: Callable, coefficients: Float[Array, "modes channels"], *arrays: Any) -> list:
    """`function(coefficients, *arrays)` of every channel, traced once."""
    once = jax.jit(function)
    return [once(coefficients[:, channel], *arrays) for channel in range(coefficients.shape[1])]


def one_by_one(coefficients: Float[Array, " modes"]) -> list[Array]:
    """Coefficients `(1,)` each. Indexing them would take longer than the rest to trace."""
    return list(jax.lax.split(coefficients, (1,) * coefficients.size))


def total(terms: Iterable[Array]) -> Array:
    return reduce(add, terms)


def rows(basis, w: Float[Array, "points 3"]) -> Float[Array, "points modes"]:
    """y_1(w) ... y_K(w), a few columns at a time into their place: one kernel for all would pick each value."""

    def of_block(w):
        return _grouped(_functions(basis, w), COLUMNS, 1)

    # Every kernel runs through the whole result: a large one would come from memory each time, and be held twice.
    whole = w.shape[0] * basis.count**2 <= WHOLE
    return kernel(of_block, w) if whole else blockwise(partial(kernel, of_block), VALUES // basis.count, w)


def rows_by_mode(basis, w: Float[Array, "points 3"]) -> Float[Array, "modes points"]:
    """The same, transposed: what a product with them is faster with."""
    return kernel(lambda w: _grouped(_functions(basis, w), MODES, 0), w)


def _functions(basis, w: Float[Array, "points 3"]) -> list[Array]:
    chart, orders = basis.chart(w), len(basis.tables().start)
    even = even_powers(chart.square, orders)
    powers = [times(even[m // 2], chart.odd if m % 2 else None) for m in range(orders)]
    p = [radial(basis, chart.x, m) for m in range(orders)]
    found = []
    for n, m in basis.modes:
        value, power = p[abs(m)][basis.radial_index(n, m)], powers[abs(m)]
        found.append(value if power is None else value * power[int(m < 0)])
    return found


def _grouped(values: list[Array], size: int, axis: int) -> Array:
    """`jnp.stack(values, axis)`, written `size` values at a time."""
    shape = [values[0].size]
    shape.insert(axis, len(values))
    found = jnp.zeros(shape, values[0].dtype)
    for first in range(0, len(values), size):
        begin = (0, first) if axis else (first, 0)
        found = jax.lax.dynamic_update_slice(found, jnp.stack(values[first : first + size], axis), begin)
    return found
