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

from hshjax._special import RadialTables, blockwise, matmul
from hshjax._typing import Array, Float, Real
from hshjax.bases import _series, _written_out
from hshjax.bases._merged import merged
from hshjax.bases._operation import Zero, instantiated, operation
from hshjax.bases._rows import by_function, rows
from hshjax.geometry import as_directions, common_dtype, dot

BLOCK = 1024
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


# Jitted here: compiled once for a basis and a shape, also where a user calls without jit.


# No operation: where a loop drops this rule, the program that is left has the same derivatives and more to compile.
@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _differentiable_rows(basis: AbstractBasis, w: Float[Array, "points 3"]) -> Float[Array, "points modes"]:
    return (_written_out.rows if _short_rows(basis) else rows)(basis, w)


@_differentiable_rows.defjvp
def _(basis, primals, tangents):
    return jax.jvp(partial(rows, basis), primals, tangents)


_rows = jax.jit(_differentiable_rows, static_argnums=0)


def _short_rows(basis: AbstractBasis) -> bool:
    return basis.count <= _written_out.ROWS


def _slope_of_gradients(basis: AbstractBasis, primals, tangents) -> tuple[Array, Array]:
    differentiable = partial(_series.differentiable_gradients, basis)
    _, tangent = jax.jvp(differentiable, tuple(primals), tuple(map(instantiated, tangents)))
    return _gradients(basis, *primals), tangent  # not the value beside the tangent, which is slower


_gradients = operation("series_gradients", _series.gradients, _slope_of_gradients, merged, linear=-2)
"""∂/∂w of `_sums`, `(points, channels, 3)`."""


def _values(basis: AbstractBasis, coefficients: Array, w: Array) -> Array:
    short = _written_out.short(basis.count, coefficients.shape[1])
    return (_written_out.sums if short else _series.sums)(basis, coefficients, w)


def _slope_of_values(basis: AbstractBasis, primals, tangents) -> tuple[Array, Array]:
    """dΣ = Y dc + (∂Σ/∂w) dw: two linear maps, whose transposes cost one product each, blocked GEMM and contraction."""
    coefficients, w = primals
    d_coefficients, d_w = tangents
    value = _series_sums(basis, coefficients, w)
    tangent = jnp.zeros_like(value)
    if not isinstance(d_coefficients, Zero):

        @jax.checkpoint  # recomputed, not stored, for the transpose: rows would be the largest array of the program
        def product(d, w):
            if _short_rows(basis):
                return matmul(_written_out.rows_by_mode(basis, w).T, d)
            functions, columns = by_function(basis, w)
            return matmul(functions.T, d[jnp.asarray(columns)])

        tangent += blockwise(partial(product, d_coefficients), BLOCK, w)
    if not isinstance(d_w, Zero):
        gradient = _gradients(basis, coefficients, w)
        tangent += dot(gradient, d_w[:, None, :])
    return value, tangent


_series_sums = operation("series_sums", _values, _slope_of_values, merged, linear=-2)
"""Σ_k c_k y_k(w), `(points, channels)`."""

_sums = jax.jit(_series_sums, static_argnums=0)
