"""Short series written out: straight lines of arithmetic that XLA makes one kernel of.

At order 4 a sum of three channels takes six tenths of the time of `hshjax/bases/_series.py`. Programs grow with the
number of functions, and time to compile with them: `short` says up to where. Values only: derivatives have ways of
their own.
"""

from collections.abc import Callable, Iterable
from functools import reduce
from operator import add
from typing import Any

import jax
import jax.numpy as jnp

from hshjax._special import multiply
from hshjax._typing import Array, Float, Real
from hshjax.bases._kernel import kernel

FUNCTIONS = 128
"""As many coefficients, of all channels together, are written out at most: beyond, products of matrices take less."""

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
