"""Short series written out: straight lines of arithmetic that XLA makes one kernel of.

At order 8 a sum of three channels takes six tenths of the time of `hshjax/bases/_series.py`. Programs grow with the
number of functions, and time to compile with them: `short` says up to where. Values only: derivatives have ways of
their own.
"""

from collections.abc import Callable, Iterable
from functools import partial, reduce
from operator import add

import jax
import jax.numpy as jnp

from hshjax._special import RadialTables, blockwise, multiply
from hshjax._typing import Array, Float, Real
from hshjax.bases._kernel import kernel

FUNCTIONS = 128
"""As many functions are written out at most, order 10: the kernel of one channel then compiles in 0.2 s."""

CHANNELS = 8
"""Up to so many channels run through it one by one: beyond, products of matrices take less."""

AT_ONCE = 128
"""Coefficients, of all channels together, up to which one kernel has all channels: no loop, and more to compile."""

FEW = 1024
"""Points up to which that holds for twice as many: one kernel starts in a third of the time of several."""

ROWS = 42
"""Functions of design rows that are written out at most: a kernel for `COLUMNS` of them each has to be compiled."""

POINTS = 2**16
"""Points a block: what every channel is written to before the transposition, and charts of pairs, stay below 2 MB."""

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
    """Whether a series of so many functions is to be written out: a kernel of one channel has `limit` at most."""
    return 0 < functions * channels <= AT_ONCE or (functions <= limit and 0 < channels <= CHANNELS)


def radial(tables: RadialTables, x: Real, m: int) -> list[Array]:
    """p_0, p_1 ... of the azimuthal order m."""
    start, slope, shift, back, counts = tables
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


def by_azimuth(series: Callable[[int], Iterable[Array | None]], square: Pair, odd: Pair, orders: int) -> Array:
    """Σ_m of what `series(m)` yields, the first times Re s^m, the second times Im s^m; None is 0."""
    even, terms = even_powers(square, orders), []
    for m in range(orders):
        power = times(even[m // 2], odd if m % 2 else None)
        for part, value in enumerate(series(m)):
            if value is not None:
                terms.append(value if power is None else value * power[part])
    return total(terms)


def bilinear(left: list[Array], right: list[Array], entries: Iterable[tuple[int, int, Array]]) -> Array | None:
    """Σ a left_j right_k over entries (j, k, a), a product with `right` for every k; None if there are no entries."""
    rows: dict[int, list[Array]] = {}
    for j, k, value in entries:
        rows.setdefault(k, []).append(value * left[j])
    return total(right[k] * total(row) for k, row in rows.items()) if rows else None


def sums(basis, coefficients: Float[Array, "modes channels"], w: Float[Array, "points 3"]) -> Array:
    """Σ_k c_k y_k(w), `(points, channels)`."""

    tables, columns = basis.tables(), basis.columns()

    def of_channel(coefficients, w):
        chart, one = basis.chart(w), one_by_one(coefficients)

        def series(m):
            p = radial(tables, chart.x, m)
            for part in range(2 if m else 1):
                yield total(one[column] * f for column, f in zip(columns[m, :, part], p, strict=False))

        return by_azimuth(series, chart.square, chart.odd, len(tables.start))

    return blockwise(partial(by_channel, of_channel, coefficients), POINTS, w)


def by_channel(
    function: Callable, coefficients: Float[Array, "modes channels"], *arrays: Float[Array, "points ..."]
) -> Float[Array, "points channels"]:
    """`function(coefficients, *arrays)`, `(points,)`, of every channel: traced once, and compiled once where there is
    more to compile than `AT_ONCE`."""
    once, size, points = jax.jit(function), coefficients.size, arrays[0].shape[0]
    if size <= AT_ONCE or (size <= 2 * AT_ONCE and points <= FEW):

        def of_all(coefficients, *arrays):
            return jnp.stack([once(channel, *arrays) for channel in coefficients.T], axis=-1)

        return kernel(of_all, coefficients, *arrays)
    return jax.lax.map(lambda channel: kernel(once, channel, *arrays), coefficients.T).T


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
    p = [radial(basis.tables(), chart.x, m) for m in range(orders)]
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
