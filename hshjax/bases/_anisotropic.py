"""Reciprocal functions of the half vector and the difference vector, azimuths included: brushed metal, fabric."""

from collections.abc import Iterator
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._special import Recurrences, contracted, powers, products, recurrence, recurrences
from hshjax._typing import Array, Float
from hshjax.bases._half_vector import AbstractHalfVectorBasis, circle_tables, circles, first_modes, integers
from hshjax.bases._warp import AbstractWarp, IdentityWarp, LogWarp

Mode = tuple[int, int, int, int]

COST = (0.5 / 1.4, 0.5, 1.2, 0.3)
"""Of a degree in the half vector, one in the difference vector, an azimuthal order of the latter, and an order in
which a function follows the material when that is turned: what functions are sorted by."""


def anisotropic_order(
    count: int, *, bilateral: bool = True, half_turn: bool = True, cost: tuple[float, float, float, float] = COST
) -> tuple[Mode, ...]:
    """The first functions (j, k, n, m) of `AnisotropicHalfVectorBasis`, in the order of their cost.

    That is j·cost[0] + n·cost[1] + |m|·cost[2] + |k + m|·cost[3]: isotropic functions, of k = -m, come in the order of
    `total_order`, with others between them. A shorter table is a prefix of a longer one.

    - `bilateral`: those alone that do not change under y -> -y, of a material whose x axis (or y axis) lies along the
      brush; False if it is not known how it lies, or for one that no mirror leaves alone.
    - `half_turn`: those alone that do not change under half a turn about the normal, as of anything that is brushed.

    **Raises:** ValueError for a count below 1, or degrees without a cost.
    """
    if min(cost) < 0 or min(cost[:2]) == 0:
        raise ValueError(f"costs are >= 0, and > 0 of degrees, got {cost}")
    return first_modes(count, lambda limit: _below(limit, bilateral, half_turn, cost))


def _below(limit: float, bilateral: bool, half_turn: bool, cost: tuple[float, float, float, float]) -> Iterator[tuple]:
    """Functions of a cost up to `limit`, each behind what they are sorted by."""
    per_j, per_n, per_m, per_turn = cost
    for n in range(0, int(limit / per_n) + 1, 2):
        for j in range(int((limit - n * per_n) / per_j) + 1):
            for m in range(0 if bilateral else -n, n + 1, 2):
                for k in range(-j, j + 1, 2):
                    sine = _is_sine(k, m)
                    price = j * per_j + n * per_n + abs(m) * per_m + abs(k + m) * per_turn
                    if price <= limit and not (bilateral and sine) and not (half_turn and k % 2):
                        yield price, j, n, abs(m), abs(k + m), sine, k, (j, k, n, m)


def _is_sine(k: int, m: int) -> bool:
    return m < 0 or (m == 0 and k < 0)


def _table(functions: Any) -> tuple[Mode, ...]:
    if isinstance(functions, int | np.integer):
        return anisotropic_order(int(functions))
    functions = tuple(functions)
    for mode in functions:
        j, k, n, m = mode if len(mode) == 4 else (0, 1, 0, 0)
        if m % 2 or n % 2 or (j - k) % 2 or not (j >= abs(k) and n >= abs(m)):
            raise ValueError(f"functions are (j, k, n, m), j - k, n and m even, |k| <= j and |m| <= n, got {mode}")
    return integers(functions)


class AnisotropicHalfVectorBasis(AbstractHalfVectorBasis):
    """Reciprocal functions of the half vector and the difference vector, for materials that a turn changes.

        B_jknm = sqrt(j + 1) R_j^|k|(|p|) sqrt(n + 1) R_n^|m|(|q|) Φ_km(φ_h, ψ),    ψ = φ_h + φ_d,
        Φ_km = sqrt2 cos(k φ_h + m ψ) for m > 0, and for m = 0 < k;    1 for k = m = 0;
        Φ_km = -sqrt2 sin(k φ_h + m ψ) for m < 0, and for m = 0 > k

    with Zernike's circle polynomials R_j^k(r) = r^k P_{(j-k)/2}^{(0,k)}(2r² - 1) of p = sqrt(u) exp(iφ_h) and q =
    sqrt(v) exp(iψ), u = warp(1 - cos θ_h), v = difference_warp(1 - cos θ_d). ψ is the azimuth of the difference vector
    after it is turned the short way from h to the pole; j - k is even, |k| <= j, |m| <= n. `modes` holds (j, k, n, m):
    a cosine and its sine are (k, m) and (-k, -m).

    - A swap of wi and wo turns q into -q: n and m are even, and reciprocity exact.
    - Those of k = -m are isotropic: (2a, -m, n, m) is (a, n, m) of `HalfVectorBasis`.
    - Cosines do not change under y -> -y. Those of even k do not change under half a turn about the normal; cosines
      among them do not change under x -> -x either.

    Orthonormal for du dv dφ_h dψ / 4π². Circle polynomials are smooth where h is the normal, and where wi = wo, and no
    angle is ever computed.

    - `functions`: such a table; or how many, by `anisotropic_order`.
    - `warp`, `difference_warp`: as those of `HalfVectorBasis`.

    **Raises:** ValueError for functions that do not exist.

    Source: as `HalfVectorBasis`.
    """

    functions: tuple[Mode, ...] = eqx.field(static=True, converter=_table)
    warp: AbstractWarp = eqx.field(default_factory=lambda: LogWarp(jnp.asarray(0.01)))
    difference_warp: AbstractWarp = eqx.field(default_factory=IdentityWarp)

    def degrees(self) -> np.ndarray:
        return np.array([(j, n) for j, _, n, _ in self.functions])

    def block_rows(self, wi, wo):
        n = _layout(self.functions)
        return products(zip(n.half_at, n.difference_at, strict=True), n.value, *_factors(self, wi, wo)).T

    def block_sums(self, coefficients, wi, wo):
        n = _layout(self.functions)
        half, difference = _factors(self, wi, wo)
        weighted = jnp.asarray(n.value, wi.dtype)[..., None] * coefficients[None]
        matrix = jnp.zeros((len(difference), coefficients.shape[1], len(half)), wi.dtype)
        matrix = matrix.at[n.difference_at, :, n.half_at].add(weighted)
        return contracted(matrix, half, difference).T


class Disk(NamedTuple):
    """Circle polynomials of one vector: azimuthal orders, in steps of 2 if all are even, recurrences of an order and
    cosine or sine, and in which row of those each polynomial is. Host arrays."""

    step: int
    orders: int
    rows: Recurrences
    at: np.ndarray


class Layout(NamedTuple):
    """Functions as sums of two products, value[t] · half[half_at[t]] · difference[difference_at[t]], by rows of the
    disks; of one where the second value is 0. Host arrays."""

    half: Disk
    difference: Disk
    value: np.ndarray
    half_at: np.ndarray
    difference_at: np.ndarray


@lru_cache
def _layout(functions: tuple[Mode, ...]) -> Layout:
    half, difference, terms = {}, {}, []
    for j, k, n, m in functions:
        norm = np.sqrt(2) if k or m else 1.0

        def product(value, sine_k, sine_m, j=j, k=k, n=n, m=m):
            """Numbered as they are met; where an order is 0 there is no sine, and the value is 0."""
            value *= (np.sign(k) if sine_k else 1) * (np.sign(m) if sine_m else 1)
            at_half = half.setdefault((j, abs(k), sine_k and k != 0), len(half))
            return value, at_half, difference.setdefault((n, abs(m), sine_m and m != 0), len(difference))

        if _is_sine(k, m):
            one, other = product(-norm, True, False), product(-norm, False, True)
            terms.append((one, other) if k else (other, one))
        else:
            terms.append((product(norm, False, False), product(-norm, True, True)))
    value, *places = np.array(terms).T
    disks = _disk(half), _disk(difference)
    return Layout(*disks, value, *(disk.at[place.astype(int)] for disk, place in zip(disks, places, strict=True)))


def _disk(polynomials: dict[tuple[int, int, bool], int]) -> Disk:
    degree, order, sine = np.array(list(polynomials)).T
    step = 1 if np.any(order % 2) else 2
    order, j = order // step, (degree - order) // 2
    tables = circle_tables(order, j, step)
    parts, part = np.unique(np.stack([order, sine]), axis=1, return_inverse=True)
    rows = recurrences(tables, list(zip(*parts.tolist(), strict=True)))
    return Disk(step, len(tables.counts), rows, rows.first[part] + j)


def _factors(basis: AnisotropicHalfVectorBasis, wi: Array, wo: Array) -> tuple[Array, Array]:
    """Circle polynomials of the half and the difference vector, `(rows, pairs)` each, rows as in their disks."""
    n, chart = _layout(basis.functions), circles(wi, wo)
    half = _circle_rows(n.half, basis.warp, chart.o_h, chart.half)
    return half, _circle_rows(n.difference, basis.difference_warp, chart.o_d, chart.difference)


def _circle_rows(disk: Disk, warp: AbstractWarp, o: Array, vector: tuple[Array, Array]) -> Float[Array, "rows pairs"]:
    ratio = warp.ratio(o)
    x, y = vector
    square = ratio * (x * x - y * y), ratio * 2 * x * y
    if disk.step == 2:
        re, im = square
        azimuth = powers((re * re - im * im, 2 * re * im), square, disk.orders)
    else:
        # `RootWarp` alone has a ratio of 0, where it stands for an infinite one: the root is not differentiable there.
        positive = ratio > 0
        root = jnp.where(positive, jnp.sqrt(jnp.where(positive, ratio, 1)), 0)
        azimuth = powers(square, (root * x, root * y), disk.orders)
    return recurrence(disk.rows, 2 * o * ratio - 1, azimuth)
