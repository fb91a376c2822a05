"""Recurrences: the one code path behind every hemispherical basis.

A basis function is (a polynomial in z) x (Re | Im of a complex power). This module holds both halves:

* `RadialTables` and `radial_fold`: polynomials p_j^m orthonormal for a weight of the azimuthal order m, by their
  three-term recurrence, with coefficients computed on the host in float64;
* `azimuthal_fold`: the powers s^m of a complex number, from s² and s, so that even powers never see a square root.

Both are loops inside the compiled program, so compile time does not grow with the order. Trip counts depend on m;
`exact=True` runs just the steps that are needed (fast, forward differentiable), `exact=False` pads every m to the
longest (reverse differentiable too; the padding multiplies zeros). `blockwise` keeps the working set in the cache.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, Int, Real

Carry = TypeVar("Carry")


class RadialTables(NamedTuple):
    """p_0 = start[m];  p_j = (slope[m, j] x + shift[m, j]) p_{j-1} - back[m, j] p_{j-2},  0 <= j < counts[m].

    Host arrays, float64; cast where they are used.
    """

    start: np.ndarray  # (orders,)
    slope: np.ndarray  # (orders, degrees)
    shift: np.ndarray
    back: np.ndarray
    counts: np.ndarray  # (orders,) int32


def radial_tables(
    counts: Sequence[int],
    first_norm: Callable[[int], float],
    jacobi: Callable[[int, int], tuple[np.ndarray, np.ndarray]],
) -> RadialTables:
    """Tables for `counts[m]` polynomials at each m.

    `jacobi(m, n)` returns the entries (alpha_0..alpha_{n-1}, beta_1..beta_n) of the Jacobi matrix, where
    x p_j = beta_{j+1} p_{j+1} + alpha_j p_j + beta_j p_{j-1}; `first_norm(m)` is the constant p_0.
    """
    degrees = max(counts)
    shape = (len(counts), degrees)
    slope, shift, back = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for m, count in enumerate(counts):
        if count > 1:
            alpha, beta = jacobi(m, count - 1)
            slope[m, 1:count] = 1 / beta
            shift[m, 1:count] = -alpha / beta
            back[m, 2:count] = beta[:-1] / beta[1:]
    start = np.array([first_norm(m) for m in range(len(counts))])
    return RadialTables(start, slope, shift, back, np.asarray(counts, np.int32))


def jacobi_matrix(a: int, b: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Jacobi matrix of the weight (1 - x)^a (1 + x)^b on [-1, 1], integers a, b >= 0, in closed form.

    Source: Gautschi, Orthogonal Polynomials (2004), table 1.1.
    """
    j = np.arange(n, dtype=np.float64)
    alpha = np.full(n, (b - a) / (a + b + 2.0))
    alpha[1:] = (b * b - a * a) / ((2 * j[1:] + a + b) * (2 * j[1:] + a + b + 2))
    k = j + 1
    c = 2 * k + a + b
    beta2 = 4 * k * (k + a) * (k + b) * (k + a + b)
    # At a = b = 0, k = 1 the general denominator (c² - 1) c² is right as it stands: no special case is needed.
    beta2 /= (c * c - 1) * c * c
    return alpha, np.sqrt(beta2)


def stieltjes_matrix(nodes: np.ndarray, weights: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Jacobi matrix of a discrete weight, by the Stieltjes procedure on orthonormal polynomials.

    Source: Gautschi 2004, section 2.2.
    """
    alpha, beta = np.zeros(n), np.zeros(n)
    previous = np.zeros_like(nodes)
    current = np.full_like(nodes, 1 / np.sqrt(weights.sum()))
    b = 0.0
    for j in range(n):
        alpha[j] = np.sum(weights * nodes * current**2)
        following = (nodes - alpha[j]) * current - b * previous
        b = beta[j] = np.sqrt(np.sum(weights * following**2))
        previous, current = current, following / b
    return alpha, beta


def radial_fold(
    tables: RadialTables,
    m: Int[Array, ""],
    x: Real,
    carry: Carry,
    visit: Callable[[Int[Array, ""], Real, Carry], Carry],
    *,
    exact: bool,
) -> Carry:
    """Fold `visit(j, p_j^m(x), carry)` over j = 0, 1, ... counts[m] - 1."""
    start, slope, shift, back = (jnp.asarray(table, x.dtype) for table in tables[:4])
    stop = jnp.asarray(tables.counts)[m] if exact else tables.slope.shape[1]

    def step(j, state):
        previous, current, carry = state
        carry = visit(j, current, carry)
        following = (slope[m, j + 1] * x + shift[m, j + 1]) * current - back[m, j + 1] * previous
        return current, following, carry

    # One column more, so that the step past the last degree reads a zero instead of being clamped to a wrong entry.
    slope, shift, back = (jnp.pad(table, ((0, 0), (0, 1))) for table in (slope, shift, back))
    first = jnp.broadcast_to(start[m], x.shape)
    return jax.lax.fori_loop(0, stop, step, (jnp.zeros_like(x), first, carry))[2]


def azimuthal_fold(
    square: tuple[Real, Real],
    odd: tuple[Real, Real],
    orders: int,
    carry: Carry,
    visit: Callable[[Int[Array, ""], Real, Real, Carry], Carry],
) -> Carry:
    """Fold `visit(m, Re s^m, Im s^m, carry)` over m = 0 ... orders - 1, given s² and s as (real, imaginary)."""

    def multiply(a, b):
        return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]

    def step(m, state):
        even, power, carry = state
        re, im = power
        carry = visit(m, re, im, carry)
        next_even = multiply(even, square)
        after_odd = m % 2 == 1
        power = jax.tree.map(lambda a, b: jnp.where(after_odd, a, b), next_even, multiply(even, odd))
        even = jax.tree.map(lambda a, b: jnp.where(after_odd, a, b), next_even, even)
        return even, power, carry

    one = (jnp.ones_like(square[0]), jnp.zeros_like(square[0]))
    return jax.lax.fori_loop(0, orders, step, (one, one, carry))[2]


def radial_rows(tables: RadialTables, x: Float[Array, " points"]) -> Float[Array, "orders degrees points"]:
    """Every p_j^m(x); entries past an order's count are zero."""
    start, *columns = (jnp.asarray(table, x.dtype) for table in tables[:4])
    present = jnp.asarray(np.arange(tables.slope.shape[1])[:, None] < tables.counts[None, :])

    def step(state, coefficients):
        previous, current = state
        slope, shift, back, here = coefficients
        following = (slope[:, None] * x[None] + shift[:, None]) * current - back[:, None] * previous
        following = jnp.where(here[:, None], following, 0)
        return (current, following), following

    first = jnp.broadcast_to(start[:, None], (start.size, x.size))
    columns = [*(column.T[1:] for column in columns), present[1:]]
    _, rest = jax.lax.scan(step, (jnp.zeros_like(first), first), tuple(columns))
    return jnp.swapaxes(jnp.concatenate([first[None], rest]), 0, 1)


def powers(square: tuple[Real, Real], odd: tuple[Real, Real], orders: int) -> Float[Array, "2 orders points"]:
    """(Re, Im) of s^m for m < orders, given s² and s."""
    rows = jnp.zeros((2, orders, square[0].size), square[0].dtype)
    return azimuthal_fold(square, odd, orders, rows, lambda m, re, im, rows: rows.at[:, m].set(jnp.stack([re, im])))


def blockwise(function: Callable[..., Array], block: int, *arrays: Array) -> Array:
    """`function(*arrays)` over the leading axis, at most `block` rows at a time, in bounded memory.

    Blocks are scanned, in and out, so that a derivative costs as much at every block: slices of whole arrays in a loop
    would each add a cotangent as long as all of them. Blocks are of a size that divides the rows, if one above half of
    `block` does; otherwise the first rows are computed again to fill the last one, and what comes of them is dropped.
    """
    rows = arrays[0].shape[0]
    if rows <= block:
        return function(*arrays)
    divisors = (size for size in range(block, block // 2, -1) if rows % size == 0)
    size = next(divisors, -(-rows // -(-rows // block)))
    again = -rows % size

    def split(array):
        if again:
            array = jnp.concatenate([array, array[:again]])
        return array.reshape(-1, size, *array.shape[1:])

    out = jax.lax.map(lambda parts: function(*parts), tuple(map(split, arrays)))
    return out.reshape(rows + again, *out.shape[2:])[:rows]
