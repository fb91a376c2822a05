"""Real functions on the hemisphere: the interface, and the evaluation that all bases share.

A final class brings three things: its mode table, the tables of its radial polynomials and its chart. Everything else
(the design row, the fused sum, the derivatives) is written once, here.
"""

import abc
import operator
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from hshjax._special import RadialTables, azimuthal_fold, blockwise, powers, radial_fold
from hshjax._typing import Array, Float, Real
from hshjax.bases import _written_out
from hshjax.geometry import as_directions, common_dtype

BLOCK = 1024
"""Points a block: three channels of order 16 then stay in the second-level cache."""

ROWS_BLOCK = 4096
"""Points a block of rows that are summed at once."""


def checked_order(order: int) -> int:
    """The order as an int, or a ValueError."""
    try:
        value = operator.index(order)
    except TypeError:
        value = -1
    if value < 0 or isinstance(order, bool):
        raise ValueError(f"order must be an integer >= 0, got {order!r}")
    return value


class Chart(eqx.Module):
    """A direction as a basis sees it: the radial variable x; s² and s as pairs (real, imaginary); each `(points,)`."""

    x: Real
    square: tuple[Real, Real]
    odd: tuple[Real, Real]


class AbstractBasis(eqx.Module):
    """Real functions on the upper hemisphere, orthonormal: ∫ y_p y_q dω = δ_pq [sr^-1/2].

    Static: no array leaves; equal and hashable by value. Columns are ordered by n, then m from -n to n; the functions
    of a lower order are therefore the first columns of a higher one. `m > 0` is cos(m φ), `m < 0` is sin(|m| φ).

    Directions are unit vectors `(*batch, 3)` in the local frame, normal +z. Values and derivatives refer to the
    formula in (x, y, z); a direction with z < 0 is evaluated at z = 0.
    """

    order: eqx.AbstractVar[int]

    @property
    @abc.abstractmethod
    def modes(self) -> tuple[tuple[int, int], ...]:
        """(n, m) of every column."""

    @abc.abstractmethod
    def radial_counts(self) -> tuple[int, ...]:
        """How many radial functions there are at each azimuthal order m = 0 ... order."""

    @property
    def count(self) -> int:
        """Number of functions, `len(modes)` without the list."""
        first, *rest = self.radial_counts()
        return first + 2 * sum(rest)

    @property
    def hemispherical(self) -> bool:
        """Whether the functions are orthonormal on the hemisphere; all are but `SphericalHarmonics`."""
        return True

    @abc.abstractmethod
    def tables(self) -> RadialTables:
        """Recurrence coefficients of the radial polynomials, one row for each m >= 0."""

    @abc.abstractmethod
    def chart(self, w: Float[Array, "points 3"]) -> Chart:
        """The radial variable and the complex number whose powers carry the azimuth."""

    @abc.abstractmethod
    def radial_index(self, n: int, m: int) -> int:
        """Position j of order n among the radial polynomials of azimuthal order |m|."""

    def columns(self) -> np.ndarray:
        """Column of (m, j, cosine | sine), `(orders, degrees, 2)`; absent functions point one past the last column."""
        tables = self.tables()
        table = np.full((*tables.slope.shape, 2), self.count, np.int32)
        for column, (n, m) in enumerate(self.modes):
            table[abs(m), self.radial_index(n, m), int(m < 0)] = column
        return table

    def __call__(self, w: Float[Array, "*batch 3"]) -> Float[Array, "*batch modes"]:
        """The design row y_1(w) ... y_K(w). `evaluate` is faster wherever only Σ c_k y_k is needed."""
        (w,) = as_directions(w)
        return _rows(self, w.reshape(-1, 3)).reshape(*w.shape[:-1], self.count)

    def evaluate(self, coefficients: Float[Array, " modes *channels"], w: Float[Array, "*batch 3"]) -> Real:
        """Σ_k c_k y_k(w), `(*batch, *channels)`, for any number of channels; the design row is never materialised.

        **Raises:** ValueError if `coefficients` does not have one row per mode.
        """
        (w,) = as_directions(w)
        coefficients, w = common_dtype(coefficients, w)
        check_modes(self, coefficients)
        channels = coefficients.shape[1:]
        value = _sums(self, coefficients.reshape(self.count, -1), w.reshape(-1, 3))
        return value.reshape(*w.shape[:-1], *channels)

    def __hash__(self) -> int:
        return hash((type(self), self.order))

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self.order == other.order  # pyright: ignore[reportAttributeAccessIssue]


def check_modes(basis, coefficients: Array) -> None:
    """ValueError unless `coefficients` has one row per mode of `basis`."""
    if coefficients.ndim < 1 or coefficients.shape[0] != basis.count:
        raise ValueError(
            f"coefficients of {basis} must have shape ({basis.count}, *channels), got {coefficients.shape}"
        )


# The loops. `exact` trip counts are faster, padded ones can be differentiated in reverse; see hshjax/_special.py.


def _block_rows(basis: AbstractBasis, exact: bool, w: Float[Array, "points 3"]) -> Float[Array, "points modes"]:
    tables, chart = basis.tables(), basis.chart(w)
    columns = jnp.asarray(basis.columns())

    def visit_order(m, re, im, rows):
        def visit_degree(j, p, rows):
            rows = rows.at[columns[m, j, 1]].set(p * im, mode="drop")
            return rows.at[columns[m, j, 0]].set(p * re, mode="drop")

        return radial_fold(tables, m, chart.x, rows, visit_degree, exact=exact)

    rows = jnp.zeros((basis.count, w.shape[0]), w.dtype)
    return azimuthal_fold(chart.square, chart.odd, len(tables.start), rows, visit_order).T


def _block_sums(basis: AbstractBasis, exact: bool, coefficients: Array, w: Float[Array, "points 3"]) -> Array:
    tables, chart = basis.tables(), basis.chart(w)
    table = _by_order(basis, coefficients)

    def visit_order(m, re, im, total):
        def visit_degree(j, p, parts):
            return parts + table[m, j][..., None] * p[None, None]

        parts = radial_fold(tables, m, chart.x, jnp.zeros((2, *total.shape), total.dtype), visit_degree, exact=exact)
        return total + parts[0] * re[None] + parts[1] * im[None]

    total = jnp.zeros((coefficients.shape[1], w.shape[0]), w.dtype)
    return azimuthal_fold(chart.square, chart.odd, len(tables.start), total, visit_order).T


def _by_order(basis: AbstractBasis, coefficients: Float[Array, "modes channels"]) -> Array:
    """Coefficients by (m, j, cosine | sine), `(orders, degrees, 2, channels)`; 0 where there is no function."""
    padded = jnp.concatenate([coefficients, jnp.zeros((1, coefficients.shape[1]), coefficients.dtype)])
    return padded[jnp.asarray(basis.columns())]


def _block_gradients(basis: AbstractBasis, exact: bool, coefficients: Array, w: Array) -> Array:
    """∂/∂w of the sums, `(points, channels, 3)`.

    Radial functions depend on the radial variable alone: one tangent goes through their loop, three through the powers.
    """
    tables, table = basis.tables(), _by_order(basis, coefficients)
    orders, channels, x = len(tables.start), coefficients.shape[1], basis.chart(w).x

    def charted(w):
        chart = basis.chart(w)
        return chart.x, powers(chart.square, chart.odd, orders)

    power = charted(w)[1]
    d_x, d_power = jax.vmap(lambda axis: jax.jvp(charted, (w,), (jnp.broadcast_to(axis, w.shape),))[1])(
        jnp.eye(3, dtype=w.dtype)
    )

    def visit_order(m, total):
        def parts_at(x):
            zeros = jnp.zeros((2, channels, w.shape[0]), w.dtype)
            return radial_fold(
                tables, m, x, zeros, lambda j, p, parts: parts + table[m, j][..., None] * p[None, None], exact=exact
            )

        parts, slopes = jax.jvp(parts_at, (x,), (jnp.ones_like(x),))
        turned = parts[0, None] * d_power[:, 0, m, None] + parts[1, None] * d_power[:, 1, m, None]
        run = slopes[0] * power[0, m, None] + slopes[1] * power[1, m, None]
        return total + turned + d_x[:, None] * run[None]

    total = jax.lax.fori_loop(0, orders, visit_order, jnp.zeros((3, channels, w.shape[0]), w.dtype))
    return jnp.moveaxis(total, (0, 1, 2), (2, 1, 0))


def differentiable(block_function):
    """`block_function(basis, exact, *arrays)` as a function of (basis, *arrays).

    Exact trip counts for values; padded ones wherever a derivative is taken, so that every order of it exists.
    """

    @partial(jax.custom_jvp, nondiff_argnums=(0,))
    def run(basis, *args):
        return block_function(basis, True, *args)

    @run.defjvp
    def _(basis, primals, tangents):
        return jax.jvp(partial(block_function, basis, False), primals, tangents)

    return run


_rows_of_block = differentiable(_block_rows)
_gradients_of_block = differentiable(_block_gradients)


def written_out_if(short, written_out, loops):
    """`written_out(basis, *arrays)` where `short` says so, else `loops`, of which derivatives are taken in any case."""

    @partial(jax.custom_jvp, nondiff_argnums=(0,))
    def run(basis, *args):
        return (written_out if short(basis, *args) else loops)(basis, *args)

    @run.defjvp
    def _(basis, primals, tangents):
        return jax.jvp(partial(loops, basis), primals, tangents)

    return run


def _looped_rows(basis: AbstractBasis, w: Float[Array, "points 3"]) -> Float[Array, "points modes"]:
    return blockwise(partial(_rows_of_block, basis), BLOCK, w)


def _looped_sums(basis: AbstractBasis, coefficients: Array, w: Array) -> Array:
    return blockwise(partial(_block_sums, basis, True, coefficients), BLOCK, w)


def _looped_gradients(basis: AbstractBasis, coefficients: Array, w: Array) -> Array:
    return blockwise(partial(_gradients_of_block, basis, coefficients), BLOCK, w)


def _short(basis: AbstractBasis, coefficients: Array, w: Array) -> bool:
    return _written_out.short(basis.count, coefficients.shape[1])


def _short_rows(basis: AbstractBasis, w: Array) -> bool:
    return _written_out.short(basis.count, _written_out.AS_ROWS)


_quick_rows = written_out_if(_short_rows, _written_out.rows, _looped_rows)
_quick_rows_by_mode = written_out_if(
    _short_rows, _written_out.rows_by_mode, lambda basis, w: _rows_of_block(basis, w).T
)
_quick_gradients = written_out_if(_short, _written_out.gradients, _looped_gradients)

# Compiled once for a basis and a shape, also where a user calls without jit: the loops are new functions at every call.
_rows = jax.jit(_quick_rows, static_argnums=0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _differentiable_sums(basis: AbstractBasis, coefficients: Array, w: Array) -> Array:
    sums = _written_out.sums if _short(basis, coefficients, w) else _looped_sums
    return sums(basis, coefficients, w)


@partial(_differentiable_sums.defjvp, symbolic_zeros=True)
def _(basis, primals, tangents):
    """dΣ = Y dc + (∂Σ/∂w) dw: two linear maps, whose transposes cost one product each, blocked GEMM and contraction."""
    coefficients, w = primals
    d_coefficients, d_w = tangents
    value = _differentiable_sums(basis, coefficients, w)
    tangent = jnp.zeros_like(value)
    if not isinstance(d_coefficients, SymbolicZero):
        # Recomputed, not stored, for the transpose: the rows would be the largest array of the program.
        product = jax.checkpoint(lambda d, part: matmul(_quick_rows_by_mode(basis, part).T, d))
        tangent += blockwise(partial(product, d_coefficients), ROWS_BLOCK, w)
    if not isinstance(d_w, SymbolicZero):
        gradient = _quick_gradients(basis, coefficients, w)
        tangent += jnp.sum(gradient * d_w[:, None, :], axis=-1)
    return value, tangent


_sums = jax.jit(_differentiable_sums, static_argnums=0)


def matmul(a: Array, b: Array) -> Array:
    """a @ b at full precision on every device."""
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)
