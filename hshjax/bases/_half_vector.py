"""Reciprocal functions of the half vector and the difference vector: compact where a material has a highlight."""

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._special import (
    RadialTables,
    Recurrences,
    blockwise,
    contracted,
    jacobi_matrix,
    multiply,
    powers,
    products,
    radial_tables,
    recurrence,
    recurrences,
)
from hshjax._typing import Array, Float
from hshjax.bases import _written_out
from hshjax.bases._pairs import AbstractPairBasis
from hshjax.bases._warp import AbstractWarp, IdentityWarp, LogWarp
from hshjax.geometry import dot

Mode = tuple[int, int, int]

UNWARPED = IdentityWarp()

FUNCTIONS = 200
"""As many functions are written out at most: what products of matrices take as long to compile."""

COST = (1 / 1.4, 0.5, 1.2)
"""Of a degree in the half angle, one in the difference angle, an azimuthal order: what functions are sorted by."""


def total_order(count: int, *, bilateral: bool = True, cost: tuple[float, float, float] = COST) -> tuple[Mode, ...]:
    """The first `count` functions (a, n, m) of `HalfVectorBasis` in the order of a·cost[0] + n·cost[1] + |m|·cost[2].

    A shorter table is a prefix of a longer one. The default costs suit measured isotropic materials: a highlight takes
    high degrees in the half angle, little depends on the azimuth.
    """
    return first_modes(count, lambda limit: _below(limit, bilateral, cost))


def first_modes(count: int, below: Callable[[float], Iterable[tuple]]) -> tuple:
    """The first modes in the order of their cost; `below(limit)` is of those up to one, behind what sorts them."""
    if count < 1:
        raise ValueError(f"a basis has at least one function, got a count of {count}")
    limit = 2.0
    while True:
        found = sorted(below(limit))
        if len(found) >= count:
            return tuple(mode for *_, mode in found[:count])
        limit *= 1.5


def _below(limit: float, bilateral: bool, cost: tuple[float, float, float]):
    """Functions of a cost up to `limit`, each behind what they are sorted by."""
    per_a, per_n, per_m = cost
    for m in range(0, int(limit / per_m) + 1, 2):
        for n in range(m, int((limit - m * per_m) / per_n) + 1, 2):
            for a in range(m // 2, int((limit - m * per_m - n * per_n) / per_a) + 1):
                for sign in (1,) if bilateral or m == 0 else (1, -1):
                    yield a * per_a + n * per_n + m * per_m, a, n, m, sign < 0, (a, n, sign * m)


def _table(functions: Any) -> tuple[Mode, ...]:
    if isinstance(functions, int | np.integer):
        return total_order(int(functions))
    functions = tuple(functions)
    for mode in functions:
        a, n, m = mode if len(mode) == 3 else (0, 0, 1)
        if m % 2 or n % 2 or not (2 * a >= abs(m) <= n):
            raise ValueError(f"functions are (a, n, m), n and m even, |m| <= n and |m| <= 2a, got {mode}")
    return integers(functions)


def integers(functions: tuple) -> tuple:
    """A mode table of integers, of one function at least, each once."""
    table = tuple(tuple(map(int, mode)) for mode in functions)
    if not table:
        raise ValueError("a basis has at least one function, got an empty table")
    if len(set(table)) < len(table):
        raise ValueError("a function stands twice in the table")
    return table


class AbstractHalfVectorBasis(AbstractPairBasis):
    """Reciprocal functions of the half and the difference vector, under a warp of each."""

    functions: eqx.AbstractVar[tuple]
    warp: eqx.AbstractVar[AbstractWarp]
    difference_warp: eqx.AbstractVar[AbstractWarp]

    def __check_init__(self):
        for warp in (self.warp, self.difference_warp):
            if not isinstance(warp, AbstractWarp):
                raise ValueError(f"a {type(self).__name__} needs a warp, got {warp!r}")

    @property
    def modes(self) -> tuple:
        return self.functions

    @property
    def count(self) -> int:
        return len(self.functions)

    @property
    def reciprocal(self) -> bool:
        return True


class HalfVectorBasis(AbstractHalfVectorBasis):
    """Isotropic reciprocal functions of the half angle θ_h and the difference direction (θ_d, φ_d).

        B_anm = U_a^μ V_n^μ Φ_m(φ_d),    U_a^μ = sqrt(2a + 1) u^{μ/2} P_{a-μ/2}^{(0,μ)}(2u - 1),
                                         V_n^μ = sqrt(n + 1) v^{μ/2} P_{(n-μ)/2}^{(0,μ)}(2v - 1),

    with μ = |m|, u = warp(1 - cos θ_h), v = difference_warp(1 - cos θ_d), Φ_m = sqrt2 cos(m φ_d) for m > 0,
    sqrt2 sin(|m| φ_d) for m < 0, and 1 for m = 0. A swap of wi and wo adds π to φ_d: m is even, and reciprocity
    exact. Functions of m >= 0 alone are bilateral as well (unchanged under φ_d -> -φ_d). They are polynomials in u,
    times Zernike's circle polynomials of even order in the difference direction.

    The factors u^{μ/2} and v^{μ/2} are what makes them smooth where wi and wo mirror each other or are equal, and φ_d
    loses its meaning; φ_d is never computed. They are orthonormal for du dv dφ_d / 2π on [0, 1] x [0, 1] x [0, 2π):
    more than the pairs of two hemispheres, and in a measure that follows the warps. `modes` holds (a, n, m).

    - `functions`: such a table; or how many, by `total_order`.
    - `warp`: its scale α is differentiable, and belongs to the material: about the width of its highlight.
    - `difference_warp`: the same about wi = wo, for materials that reflect back to the light in a narrow lobe.

    **Raises:** ValueError for functions that do not exist.

    Source: Rusinkiewicz, A New Change of Variables for Efficient BRDF Representation, EGWR 1998 (the coordinates).
    """

    functions: tuple[Mode, ...] = eqx.field(static=True, converter=_table)
    warp: AbstractWarp = eqx.field(default_factory=lambda: LogWarp(jnp.asarray(0.01)))
    difference_warp: AbstractWarp = eqx.field(default_factory=IdentityWarp)

    @property
    def isotropic(self) -> bool:
        return True

    def degrees(self) -> np.ndarray:
        return np.array([mode[:2] for mode in self.functions])

    def block_rows(self, wi, wo):
        n = function_layout(self.functions)
        return products([(n.left_at, n.right_at)], [n.norm], *_factors(self, wi, wo)).T

    def written_out_sums(self, coefficients, wi, wo):
        if not _written_out.short(self.count, coefficients.shape[1], FUNCTIONS):
            return None
        return _written_out_sums(self, coefficients, wi, wo)

    def block_sums(self, coefficients, wi, wo):
        # A dense product, most of which is zeros, takes less time than a product for every azimuthal order.
        n = function_layout(self.functions)
        left, right = _factors(self, wi, wo)
        weighted = jnp.asarray(n.norm, wi.dtype)[:, None] * coefficients
        matrix = jnp.zeros((len(right), coefficients.shape[1], len(left)), wi.dtype)
        matrix = matrix.at[n.right_at, :, n.left_at].set(weighted)
        return contracted(matrix, left, right).T


class Layout(NamedTuple):
    """Functions by their factors, host arrays: m = ±2p, degrees j and k of the polynomials, sine or cosine, norm.

    `left`: polynomials of the half vector with cosine or sine of 2pφ_d, `right` those of the difference vector, all
    degrees of what occurs; `left_at`, `right_at`: rows of a function's factors among them.
    """

    p: np.ndarray
    j: np.ndarray
    k: np.ndarray
    sine: np.ndarray
    norm: np.ndarray
    half: RadialTables
    difference: RadialTables
    left: Recurrences
    left_at: np.ndarray
    right: Recurrences
    right_at: np.ndarray


@lru_cache
def function_layout(functions: tuple[Mode, ...]) -> Layout:
    a, n, m = np.array(functions, np.int32).T  # int32 for the reason that is given in _isotropic.py
    p = np.abs(m) // 2
    j, k = a - p, (n - 2 * p) // 2
    norm, sine = np.where(m == 0, 1, np.sqrt(2)), (m < 0).astype(np.int32)
    half, difference = circle_tables(p, j, 2), circle_tables(p, k, 2)

    turned, part = np.unique(np.stack([p, sine]), axis=1, return_inverse=True)
    orders, order = np.unique(p, return_inverse=True)
    left = recurrences(half, list(zip(*turned.tolist(), strict=True)))
    right = recurrences(difference, [(q, 0) for q in orders.tolist()])
    return Layout(p, j, k, sine, norm, half, difference, left, left.first[part] + j, right, right.first[order] + k)


def circle_tables(order: np.ndarray, degree: np.ndarray, step: int) -> RadialTables:
    """Polynomials in 2u - 1 up to some degree at the azimuthal orders step · order that there are, orthonormal for
    u^(step · order) du: circle polynomials of radius sqrt(u) without that power of it."""
    counts = [int(max(degree[order == q], default=0)) + 1 for q in range(order.max() + 1)]
    return radial_tables(counts, lambda q: np.sqrt(step * q + 1), lambda q, size: jacobi_matrix(0, step * q, size))


def _factors(basis: HalfVectorBasis, wi: Array, wo: Array) -> tuple[Array, Array]:
    """Rows of `Layout.left` and of `Layout.right`, `(rows, pairs)`."""
    n = function_layout(basis.functions)
    chart = half_chart(basis.warp, wi, wo, basis.difference_warp)
    azimuth = powers(multiply(chart.turn, chart.turn), chart.turn, n.half.counts.size)
    return recurrence(n.left, 2 * chart.u - 1, azimuth), recurrence(n.right, 2 * chart.v - 1)


def _written_out_sums(basis: HalfVectorBasis, coefficients: Array, wi: Array, wo: Array) -> Array:
    """Σ_p Σ_k V_k Σ_j c_jk U_j times cosine or sine."""
    n = function_layout(basis.functions)

    def of_channel(coefficients, u, v, *turn):
        one = _written_out.one_by_one(coefficients)

        def series(p):
            half, difference = (
                _written_out.radial(tables, 2 * x - 1, p) for tables, x in ((n.half, u), (n.difference, v))
            )
            for sine in (0, 1):
                here = np.flatnonzero((n.p == p) & (n.sine == sine)).tolist()
                yield _written_out.bilinear(half, difference, ((n.j[t], n.k[t], one[t]) for t in here))

        return _written_out.by_azimuth(series, multiply(turn, turn), turn, n.half.counts.size)

    weighted = jnp.asarray(n.norm, wi.dtype)[:, None] * coefficients

    def block(wi, wo):  # the chart once for all channels: a warp takes as long as the functions of one
        chart = half_chart(basis.warp, wi, wo, basis.difference_warp)
        return _written_out.by_channel(of_channel, weighted, chart.u, chart.v, *chart.turn)

    return blockwise(block, _written_out.POINTS, wi, wo)


class HalfChart(NamedTuple):
    """Of pairs: u = warp(1 - cos θ_h), v = difference_warp(1 - cos θ_d), and c = u v exp(2i φ_d) as (Re, Im)."""

    u: Float[Array, " pairs"]
    v: Float[Array, " pairs"]
    turn: tuple[Float[Array, " pairs"], Float[Array, " pairs"]]


def half_chart(
    warp: AbstractWarp,
    wi: Float[Array, "pairs 3"],
    wo: Float[Array, "pairs 3"],
    difference_warp: AbstractWarp = UNWARPED,
) -> HalfChart:
    """Smooth wherever both directions lie above the horizon, without an angle: as smooth as the warps."""
    o_h, o_d, (px, py), (qx, qy) = circles(wi, wo)
    ratio_h, ratio_d = warp.ratio(o_h), difference_warp.ratio(o_d)
    re, im = qx * px + qy * py, qy * px - qx * py  # relative to the azimuth of h
    scale = ratio_h * ratio_d
    return HalfChart(o_h * ratio_h, o_d * ratio_d, (scale * (re * re - im * im), scale * 2 * re * im))


class Circles(NamedTuple):
    """o_h = 1 - cos θ_h, o_d = 1 - cos θ_d, and the half vector and the difference vector, turned the short way from
    there to the pole, on the equal-area disk: (x, y) of sqrt(o_h) exp(iφ_h) and sqrt(o_d) exp(i(φ_h + φ_d))."""

    o_h: Float[Array, " pairs"]
    o_d: Float[Array, " pairs"]
    half: tuple[Float[Array, " pairs"], Float[Array, " pairs"]]
    difference: tuple[Float[Array, " pairs"], Float[Array, " pairs"]]


def circles(wi: Float[Array, "pairs 3"], wo: Float[Array, "pairs 3"]) -> Circles:
    """Smooth wherever both directions lie above the horizon; a swap of them changes the sign of the difference."""
    total, half = wi + wo, (wi - wo) / 2
    square = dot(total, total)
    proper = square > 0  # wi = -wo, on the horizon, has no half vector
    length = jnp.sqrt(jnp.where(proper, square, 1))
    hx, hy, hz = (total[:, k] / length for k in range(3))
    hz = jnp.where(proper, hz, 1)
    cos_d = jnp.where(proper, length / 2, 0)
    # Without the cancellation of 1 - cos.
    o_h, o_d = (hx * hx + hy * hy) / (1 + hz), dot(half, half) / (1 + cos_d)
    lift = half[:, 2] / (1 + hz)
    scale_h, scale_d = 1 / jnp.sqrt(1 + hz), 1 / jnp.sqrt(1 + cos_d)
    difference = scale_d * (half[:, 0] - lift * hx), scale_d * (half[:, 1] - lift * hy)
    return Circles(o_h, o_d, (scale_h * hx, scale_h * hy), difference)
