"""Recurrences: the one code path behind every hemispherical basis.

A basis function is (a polynomial in z) x (Re | Im of a complex power). This module holds both halves:

* `RadialTables` and `recurrence`: polynomials p_j^m orthonormal for a weight of the azimuthal order m, by their
  three-term recurrence, with coefficients computed on the host in float64;
* `powers`: s^m of a complex number, from s² and s, so that even powers never see a square root.

Both are loops inside the compiled program, differentiable in both modes: compile time does not grow with the order.
`blockwise` keeps the working set in the cache.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from operator import add
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, Real


class RadialTables(NamedTuple):
    """p_0 = start[m];  p_j = (slope[m, j] x + shift[m, j]) p_{j-1} - back[m, j] p_{j-2},  0 <= j < counts[m].

    Host arrays, float64; cast where they are used.
    """

    start: np.ndarray  # (orders,)
    slope: np.ndarray  # (orders, degrees)
    shift: np.ndarray
    back: np.ndarray
    counts: np.ndarray  # (orders,) int32

    def steps(self) -> np.ndarray:
        """Those of `recurrence` for all degrees of every order, `(orders, degrees, 4)`; 0 past an order's count."""
        steps = np.stack([self.slope, self.shift, self.back, np.zeros_like(self.slope)], -1)
        steps[:, 0] = 0
        steps[:, 0, 3] = self.start
        return steps


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


class Recurrences(NamedTuple):
    """One after the other, as `recurrence` takes them. Host arrays."""

    steps: np.ndarray  # (rows, 4): slope, shift, back, start; where the first three are 0 another one begins
    turns: np.ndarray  # (rows, 2) int32: (cosine | sine, m) of the power that the start is multiplied with
    first: np.ndarray  # (recurrences,) int32: rows where they begin


def recurrences(tables: RadialTables, parts: Sequence[tuple[int, int]]) -> Recurrences:
    """Of all radial functions of the orders m, for each (m, 0 for the cosine | 1 for the sine) in `parts`."""
    steps, counts = tables.steps(), [int(tables.counts[m]) for m, _ in parts]
    return Recurrences(
        np.concatenate([steps[m, :count] for (m, _), count in zip(parts, counts, strict=True)]),
        np.repeat([(part, m) for m, part in parts], counts, axis=0).astype(np.int32),
        np.cumsum([0, *counts[:-1]]).astype(np.int32),
    )


def recurrence(
    all_of: Recurrences, x: Float[Array, " points"], power: Float[Array, "2 orders points"] | None = None
) -> Float[Array, "rows points"]:
    """q_i = (slope_i x + shift_i) q_{i-1} - back_i q_{i-2} + start_i, the start times its s^m of `powers`, if given.

    A recurrence is linear: what begins with a power of s yields functions with that azimuth.

    Many recurrences are one loop, of one kernel, which takes as long to compile as one of them.
    """

    def step(state, row):
        before, last = state
        (slope, shift, back, start), (part, m) = row
        begun = start if power is None else start * power[part, m]
        following = (slope * x + shift) * last + (begun - back * before)
        return (last, following), following

    rows = jnp.asarray(all_of.steps, x.dtype), jnp.asarray(all_of.turns)
    return jax.lax.scan(step, (jnp.zeros_like(x), jnp.zeros_like(x)), rows)[1]


def radial_rows(tables: RadialTables, x: Float[Array, " points"]) -> Float[Array, "orders degrees points"]:
    """Every p_j^m(x); entries past an order's count are zero."""
    steps = tables.steps()
    rows = steps.shape[0] * steps.shape[1]
    all_of = Recurrences(steps.reshape(rows, 4), np.zeros((rows, 2), np.int32), np.arange(0, rows, steps.shape[1]))
    return recurrence(all_of, x).reshape(*steps.shape[:2], x.size)


def products(
    places: Iterable[tuple[np.ndarray, np.ndarray]],
    weights: Iterable[np.ndarray],
    a: Float[Array, "rows points"],
    b: Float[Array, "others points"],
) -> Float[Array, "columns points"]:
    """Σ weight_k a_i(k) b_j(k) for every column k, over the terms (i, j) of `places` and their `weights`, `(columns,)`.

    A column a step: to pick the rows of both first would pass through memory value by value.
    """
    terms = [
        (*(jnp.asarray(place, jnp.int32) for place in pair), jnp.asarray(weight, a.dtype))
        for pair, weight in zip(places, weights, strict=True)
    ]

    def step(_, column):
        return None, reduce(add, [weight * a[i] * b[j] for i, j, weight in column])

    return jax.lax.scan(step, None, terms)[1]


def inner(a: Float[Array, "rows channels points"], b: Float[Array, "rows points"]) -> Float[Array, "channels points"]:
    """Σ_r a_r b_r, a row a step: XLA's reductions over a leading axis are not vectorised."""

    def step(total, row):
        left, right = row
        return total + left * right[None], None

    return jax.lax.scan(step, jnp.zeros_like(a[0]), (a, b))[0]


def matmul(a: Array, b: Array) -> Array:
    """a @ b at full precision on every device."""
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


def contracted(
    matrix: Float[Array, "others channels rows"], a: Float[Array, "rows points"], b: Float[Array, "others points"]
) -> Float[Array, "channels points"]:
    """Σ_ij b_i M_ij a_j for every channel."""
    found = matmul(matrix.reshape(-1, matrix.shape[2]), a)
    return inner(found.reshape(*matrix.shape[:2], a.shape[1]), b)


def multiply(a: tuple[Real, Real], b: tuple[Real, Real]) -> tuple[Real, Real]:
    """The product of two complex numbers."""
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def powers(square: tuple[Real, Real], odd: tuple[Real, Real], orders: int) -> Float[Array, "2 orders points"]:
    """(Re, Im) of s^m for m < orders, given s² and s: even powers never see s, which may be a square root."""
    one = (jnp.ones_like(square[0]), jnp.zeros_like(square[0]))
    even = jax.lax.scan(lambda power, _: (multiply(power, square), power), one, length=(orders + 1) // 2)[1]
    of_all = odd[0][None], odd[1][None]
    by_parity = [jnp.stack(parts, axis=1) for parts in zip(even, multiply(even, of_all), strict=True)]
    return jnp.stack(by_parity).reshape(2, 2 * len(even[0]), *square[0].shape)[:, :orders]


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
