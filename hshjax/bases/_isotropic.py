"""Reciprocal functions of an isotropic material: dependence on φ_i - φ_o only."""

from functools import lru_cache, partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._special import Recurrences, blockwise, inner, powers, products, recurrence, recurrences
from hshjax._typing import Array
from hshjax.bases import _written_out
from hshjax.bases._base import AbstractBasis, Chart, matmul
from hshjax.bases._pairs import AbstractProductBasis, Entries

PAIR_FUNCTIONS = 300
"""As many functions of pairs are written out at most, order 10: what products of matrices take as long to compile."""


class IsotropicBasis(AbstractProductBasis):
    """The isotropic subspace of `HelmholtzBasis(basis)`.

        m >= 0:  N cos(m Δφ) [R_n^m(i) R_p^m(o) + R_p^m(i) R_n^m(o)],   n <= p,   Δφ = φ_i - φ_o
        m < 0:   N sin(|m| Δφ) [R_n^m(i) R_p^m(o) - R_p^m(i) R_n^m(o)],  n < p

    with R_n^m the radial part of the basis (its azimuth taken off) and N = 1/sqrt(2 (1 + δ_np) (2 - δ_m0)). The
    second line is absent under bilateral symmetry (invariance under Δφ -> -Δφ), the default. `modes` holds (n, p, m).

    Evaluation contracts one small matrix per |m|: Σ k_m² operations for k_m radial functions, where the full
    Helmholtz basis takes (Σ k_m)².
    """

    basis: AbstractBasis
    bilateral: bool = eqx.field(static=True, default=True)

    @property
    def modes(self) -> tuple[tuple[int, int, int], ...]:
        return _modes(self.basis, self.bilateral)

    @property
    def count(self) -> int:
        first, *rest = self.basis.radial_counts()
        return first * (first + 1) // 2 + sum(k * (k + 1) // 2 if self.bilateral else k * k for k in rest)

    def degrees(self) -> np.ndarray:
        return np.array([mode[:2] for mode in self.modes])

    @property
    def reciprocal(self) -> bool:
        return True

    @property
    def isotropic(self) -> bool:
        return True

    def entries(self) -> Entries:
        columns, n = self.basis.columns(), self.table()
        mode = np.arange(n.m.size)
        cosine, sine = columns[..., 0], columns[..., 1]
        parts = []
        # cos mΔφ = cos cos + sin sin; sin mΔφ = sin cos - cos sin, written as matrices over the tensor basis.
        for pick, left, right, signs in (
            (~n.sine, cosine, cosine, (1, 1)),
            (~n.sine & (n.m > 0), sine, sine, (1, 1)),
            (n.sine, sine, cosine, (1, -1)),
            (n.sine, cosine, sine, (-1, 1)),
        ):
            m, j, k = n.m[pick], n.j[pick], n.k[pick]
            parts.append((mode[pick], left[m, j], right[m, k], signs[0] * n.norm[pick]))
            parts.append((mode[pick], left[m, k], right[m, j], signs[1] * n.norm[pick]))
        return Entries(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def table(self) -> "RadialModes":
        """The columns in terms of radial functions."""
        return _radial_modes(self.basis, self.bilateral)

    def block_rows(self, wi, wo):
        return _rows(self, wi, wo)

    def block_sums(self, coefficients, wi, wo):
        return _sums(self, coefficients, wi, wo)

    def written_out_sums(self, coefficients, wi, wo):
        if not _written_out.short(self.count, coefficients.shape[1], PAIR_FUNCTIONS):
            return None
        return _written_out_sums(self, coefficients, wi, wo)

    def __hash__(self) -> int:
        return hash((type(self), self.basis, self.bilateral))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IsotropicBasis) and (self.basis, self.bilateral) == (other.basis, other.bilateral)


class RadialModes(NamedTuple):
    """One entry a column, host arrays: azimuthal order m >= 0, radial indices j and k, sine or cosine, norm N."""

    m: np.ndarray
    j: np.ndarray
    k: np.ndarray
    sine: np.ndarray
    norm: np.ndarray


@lru_cache
def _modes(basis: AbstractBasis, bilateral: bool) -> tuple[tuple[int, int, int], ...]:
    orders = [[n for n, mode_m in basis.modes if mode_m == m] for m in range(basis.order + 1)]
    cosines = [(n, p, m) for m, ns in enumerate(orders) for p in ns for n in ns if n <= p]
    sines = [] if bilateral else [(n, p, -m) for n, p, m in cosines if m > 0 and n < p]
    # Ordered by the larger order first: a lower order is a prefix of a higher one.
    return tuple(sorted(cosines + sines, key=lambda mode: (mode[1], mode[0], abs(mode[2]), mode[2] < 0)))


@lru_cache
def _radial_modes(basis: AbstractBasis, bilateral: bool) -> RadialModes:
    modes = _modes(basis, bilateral)
    j, k = (np.array([basis.radial_index(mode[side], mode[2]) for mode in modes]) for side in (0, 1))
    m = np.array([mode[2] for mode in modes])
    norm = 1 / np.sqrt(2 * (1 + (j == k)) * np.where(m == 0, 1, 2))
    # int32, which jax leaves alone whether 64-bit types are on or off: it keeps what it makes of int64 from one to the
    # other, and then finds two types where it expects one.
    m, j, k = (index.astype(np.int32) for index in (m, j, k))
    return RadialModes(np.abs(m), j, k, m < 0, norm)


def _difference_chart(i: Chart, o: Chart) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """s² and s of the pair, s = s_i conj(s_o): its powers carry cos and sin of m (φ_i - φ_o)."""

    def times_conjugate(a, b):
        return a[0] * b[0] + a[1] * b[1], a[1] * b[0] - a[0] * b[1]

    return times_conjugate(i.square, o.square), times_conjugate(i.odd, o.odd)


@lru_cache
def _factors(pairs: IsotropicBasis) -> tuple[Recurrences, Recurrences, np.ndarray]:
    """Functions of wi, with the azimuth of the pair; radial ones of wo; where those of wi begin, `(orders, 2)`.

    By m, cosine before sine (that of odd columns), then degree. Host arrays.
    """
    tables = pairs.basis.tables()
    orders = len(tables.start)
    parts = [(m, int(sine)) for m in range(orders) for sine in _parts(pairs, m)]
    of_i = recurrences(tables, parts)
    first = np.zeros((orders, 2), np.int32)
    first[tuple(np.transpose(parts))] = of_i.first
    return of_i, recurrences(tables, [(m, 0) for m in range(orders)]), first


def _both(pairs: IsotropicBasis, wi: Array, wo: Array) -> tuple[Array, Array]:
    """Functions of wi and of wo, `(rows, pairs)`, as in `_factors`."""
    of_i, of_o, _ = _factors(pairs)
    chart_i, chart_o = pairs.basis.chart(wi), pairs.basis.chart(wo)
    power = powers(*_difference_chart(chart_i, chart_o), len(of_o.first))
    return recurrence(of_i, chart_i.x, power), recurrence(of_o, chart_o.x)


def _rows(pairs: IsotropicBasis, wi: Array, wo: Array) -> Array:
    """N s^m [R_j(i) R_k(o) ± R_k(i) R_j(o)]."""
    n, (_, of_o, first), both = pairs.table(), _factors(pairs), _both(pairs, wi, wo)
    first_i, first_o = first[n.m, n.sine.astype(int)], of_o.first[n.m]
    places = (first_i + n.j, first_o + n.k), (first_i + n.k, first_o + n.j)
    return products(places, (n.norm, np.where(n.sine, -n.norm, n.norm)), *both).T


def _sums(pairs: IsotropicBasis, coefficients: Array, wi: Array, wo: Array) -> Array:
    """Σ_m s^m R_m(i)ᵀ A_m R_m(o) for every channel: a product with A_m for every m, then a sum over all R_m(i) s^m."""
    (_, rows_o, _), (of_i, of_o) = _factors(pairs), _both(pairs, wi, wo)
    channels, found, at = coefficients.shape[1], [], 0
    places, weights = _matrices(pairs, channels)
    padded = jnp.append(coefficients.reshape(-1), jnp.zeros((), coefficients.dtype))
    entries = padded[jnp.asarray(places)] * jnp.asarray(weights, coefficients.dtype)
    for (m, count), begin in zip(enumerate(pairs.basis.tables().counts), rows_o.first, strict=True):
        for _ in _parts(pairs, m):
            matrix = entries[at : at + channels * count**2].reshape(count * channels, count)
            found.append(matmul(matrix, of_o[begin : begin + count]))
            at += matrix.size
    terms = jnp.concatenate(found).reshape(len(of_i), channels, wi.shape[0])
    return inner(terms, of_i).T


@lru_cache
def _matrices(pairs: IsotropicBasis, channels: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the entries of all A_m are among the coefficients (one past the last: nowhere), and their weights.

    By m, cosines before sines, row, channel, column. Host arrays.
    """
    n, places, weights = pairs.table(), [], []
    for m, count in enumerate(pairs.basis.tables().counts):
        for sine in _parts(pairs, m):
            columns, weight = np.full((count, count), -1), np.zeros((count, count))
            (here,) = np.nonzero((n.m == m) & (n.sine == sine))
            j, k, norm = n.j[here], n.k[here], n.norm[here]
            columns[j, k] = columns[k, j] = here
            np.add.at(weight, (j, k), norm)
            np.add.at(weight, (k, j), -norm if sine else norm)
            place = columns[:, None] * channels + np.arange(channels)[:, None]
            places.append(np.where(columns[:, None] < 0, pairs.count * channels, place).ravel())
            weights.append(np.broadcast_to(weight[:, None], place.shape).ravel())
    return np.concatenate(places).astype(np.int32), np.concatenate(weights)


def _parts(pairs: IsotropicBasis, m: int) -> tuple[bool, ...]:
    """Cosines, and sines where there are some."""
    return (False,) if pairs.bilateral or m == 0 else (False, True)


def _written_out_sums(pairs: IsotropicBasis, coefficients: Array, wi: Array, wo: Array) -> Array:
    """Σ_m Σ_k R_k(o) Σ_j A_jk R_j(i) times cosine or sine."""
    n, basis = pairs.table(), pairs.basis
    tables = basis.tables()

    def of_channel(coefficients, wi, wo):
        chart_i, chart_o, one = basis.chart(wi), basis.chart(wo), _written_out.one_by_one(coefficients)

        def entries(m, sine):
            for column in np.flatnonzero((n.m == m) & (n.sine == sine)).tolist():
                j, k, value = int(n.j[column]), int(n.k[column]), one[column]
                yield j, k, value
                if j != k:
                    yield k, j, -value if sine else value

        def series(m):
            i, o = (_written_out.radial(tables, chart.x, m) for chart in (chart_i, chart_o))
            for sine in (False, True):
                yield _written_out.bilinear(i, o, entries(m, sine))

        return _written_out.by_azimuth(series, *_difference_chart(chart_i, chart_o), len(tables.start))

    # Twice where both indices are one: a matrix that is symmetric but for the sines holds that entry once.
    norm = jnp.asarray(n.norm * (1 + (n.j == n.k)), coefficients.dtype)
    block = partial(_written_out.by_channel, of_channel, norm[:, None] * coefficients)
    return blockwise(block, _written_out.POINTS, wi, wo)
