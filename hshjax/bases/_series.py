"""Sums of a series and their derivatives, in blocks of points: products of matrices, then a polynomial in s by Horner.

    Σ_k c_k y_k = Re Σ_m (A_m(x) - i B_m(x)) s^m,   A_m = Σ_j a_jm p_j^m(x),   B_m = Σ_j b_jm p_j^m(x)

with a and b the coefficients of cosines and sines. The amplitudes A and B of a band of orders m (see _bands.py) are one
matrix, made of the coefficients, times the radial functions of its first order: most of the work, at the speed of a
product of matrices. s^m comes as s² to a power, times s for odd m: s² is smooth where s may have a root.
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._special import blockwise, matmul, multiply, recurrence
from hshjax._typing import Array, Float
from hshjax.bases._bands import bands, first_orders
from hshjax.bases._kernel import kernel

POINTS = 1024
"""Points a block at most: amplitudes of three channels of order 16 then stay in the second-level cache."""

AMPLITUDES = 2**18
"""Amplitudes a block, about, where there are more."""

Pair = tuple[Array, Array]


def sums(basis, coefficients: Float[Array, "modes channels"], w: Float[Array, "points 3"]) -> Array:
    """Σ_k c_k y_k(w), `(points, channels)`. Values only."""
    channels, matrix = coefficients.shape[1], _matrices(basis, coefficients)

    def combined(w, *found):
        chart, terms = _chart(basis, w), _terms(basis, found, channels)
        even, odd = (_horner(terms[first::2], chart.square) for first in (0, 1))
        return even[0] + multiply(chart.odd, odd)[0]

    def block(w):
        return kernel(combined, w, *_amplitudes(basis, matrix, w)).T

    return blockwise(block, _block(basis, channels), w)


def gradients(basis, coefficients: Float[Array, "modes channels"], w: Float[Array, "points 3"]) -> Array:
    """∂/∂w of the sums, `(points, channels, 3)`: by x, s² and s, then those of the chart. Values only:
    see `differentiable_gradients`."""
    channels, matrix = coefficients.shape[1], _matrices(basis, coefficients, slopes=True)

    def parts(w, *found):
        chart, halves = _chart(basis, w), [jnp.split(one, 2) for one in found]
        terms, slopes = (_terms(basis, [half[side] for half in halves], channels) for side in (0, 1))
        even_by_x, odd_by_x = (_horner(slopes[first::2], chart.square) for first in (0, 1))
        even, odd = (_horner(_derivative(terms[first::2]), chart.square) for first in (0, 1))
        by_x = even_by_x[0] + multiply(chart.odd, odd_by_x)[0]
        return by_x, _plus(even, multiply(chart.odd, odd)), _horner(terms[1::2], chart.square)

    def block(w):
        found = kernel(partial(_along_axes, basis), w, *kernel(parts, w, *_amplitudes(basis, matrix, w)))
        return jnp.stack(found).T

    return blockwise(block, _block(basis, 2 * channels), w)


def differentiable_gradients(basis, coefficients: Float[Array, "modes channels"], w: Float[Array, "points 3"]) -> Array:
    """The same as `gradients`, of operations that have derivatives of every order: Horner in a loop."""
    channels, matrix = coefficients.shape[1], _matrices(basis, coefficients, slopes=True)

    @jax.checkpoint  # recomputed, not stored, in reverse: amplitudes of all points would be the largest array
    def block(w):
        chart, points = _chart(basis, w), w.shape[0]
        both = zip(bands(basis), _amplitudes(basis, matrix, w), strict=True)
        found = [one.reshape(2, len(band.values), 2, channels, points) for band, one in both]
        terms = jnp.concatenate(found, axis=1)
        terms = jnp.pad(terms, ((0, 0), (0, terms.shape[1] % 2), *[(0, 0)] * 3))
        # By k, (values | slopes, cosine | sine, m = 2k | 2k + 1, channels, points).
        terms = terms.reshape(2, terms.shape[1] // 2, 2, 2, channels, points).transpose(1, 0, 3, 2, 4, 5)
        square = chart.square[0][None], chart.square[1][None]

        def step(state, term):
            value, by_square, by_x = state
            by_square = _plus(multiply(by_square, square), value)
            following = [
                _plus(multiply(before, square), (cosine, -sine))
                for before, (cosine, sine) in zip((value, by_x), term, strict=True)
            ]
            return (following[0], by_square, following[1]), None

        zeros = (jnp.zeros_like(terms[0, 0, 0]),) * 2
        found = jax.lax.scan(step, (zeros,) * 3, terms, reverse=True)[0]
        value, by_square, by_x = (tuple(zip(*pair, strict=True)) for pair in found)  # even and odd m of each
        by_square = _plus(by_square[0], multiply(chart.odd, by_square[1]))
        along = _along_axes(basis, w, by_x[0][0] + multiply(chart.odd, by_x[1])[0], by_square, value[1])
        return jnp.stack(along).T

    return blockwise(block, _block(basis, 2 * channels), w)


def _matrices(basis, coefficients: Float[Array, "modes channels"], *, slopes: bool = False) -> list[Array]:
    """Of every band, what makes amplitudes of radial functions: `(orders * 2 * channels, degrees)`, order slowest.

    `slopes`: below them as many rows again, for derivatives by x.
    """
    # By (m, j, cosine | sine), 0 where there is no function.
    padded = jnp.concatenate([coefficients, jnp.zeros((1, coefficients.shape[1]), coefficients.dtype)])
    table, found = padded[jnp.asarray(basis.columns())], []
    for band in bands(basis):
        change = np.stack([band.values, band.slopes]) if slopes else band.values[None]
        here = table[band.orders, : change.shape[-1]]
        matrix = jnp.einsum("dmjk,mjpc->dmpck", jnp.asarray(change, table.dtype), here, precision="highest")
        found.append(matrix.reshape(-1, change.shape[-1]))
    return found


def _amplitudes(basis, matrices: list[Array], w: Float[Array, "points 3"]) -> list[Array]:
    """Of every band, `(orders * 2 * channels, points)`, doubled with slopes."""
    radial = recurrence(first_orders(basis), basis.chart(w).x)
    return [matmul(matrix, radial[band.degrees]) for band, matrix in zip(bands(basis), matrices, strict=True)]


def _terms(basis, found: Sequence[Array], channels: int) -> list[Pair]:
    """A_m - i B_m for m = 0, 1, ..., `(channels, points)` each."""
    points = found[0].shape[1]
    shapes = [(len(band.values), 2, channels, points) for band in bands(basis)]
    parts = [part for one, shape in zip(found, shapes, strict=True) for part in one.reshape(shape)]
    return [(cosine, -sine) for cosine, sine in parts]


def _chart(basis, w: Float[Array, "points 3"]):
    """`(1, points)` each, for all channels."""
    return jax.tree.map(lambda one: one[None], basis.chart(w))


def _along_axes(basis, w: Float[Array, "points 3"], by_x: Array, by_square: Pair, by_odd: Pair) -> list[Array]:
    """∂/∂x, ∂/∂y, ∂/∂z, `(channels, points)` each, from derivatives by what the chart holds."""
    axes = [jnp.zeros_like(w).at[:, k].set(1) for k in range(3)]  # varying as w does, in `jax.shard_map`
    moved = [jax.jvp(lambda w: _chart(basis, w), (w,), (axis,))[1] for axis in axes]
    return [by_x * to.x + multiply(by_square, to.square)[0] + multiply(by_odd, to.odd)[0] for to in moved]


def _block(basis, channels: int) -> int:
    """Points of one: a power of 2."""
    amplitudes = 2 * max(channels, 1) * len(basis.tables().start)
    return min(POINTS, 1 << max(7, (AMPLITUDES // amplitudes).bit_length() - 1))


def _horner(terms: Sequence[Pair], z: Pair) -> Pair:
    """Σ_k terms_k z^k, of complex numbers."""
    if not terms:
        zero = jnp.zeros_like(z[0])
        return zero, zero
    *others, value = terms
    for term in reversed(others):
        value = _plus(multiply(value, z), term)
    return value


def _derivative(terms: Sequence[Pair]) -> list[Pair]:
    """Those of the derivative of a polynomial."""
    return [(k * re, k * im) for k, (re, im) in enumerate(terms)][1:]


def _plus(a: Pair, b: Pair) -> Pair:
    return a[0] + b[0], a[1] + b[1]
