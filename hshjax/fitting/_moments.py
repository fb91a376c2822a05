"""Normal equations of many samples from moments: for bases that are polynomials, and so are their products.

A product of two functions of an isotropic basis of order N lies in the span of that of order 2N. The Gram matrix of
any number of weighted samples therefore depends on nothing but the moments m_k = Σ w B_k(wi, wo) of the functions of
order 2N; samples at the nodes of an exact rule, weighted by v_q Σ_k m_k B_k(q), have the same moments, and the same
Gram matrix. Some thousand moments (order 8) are much less work than the products of all columns at every sample:

    moments: Σ_n w_n (Re s^m)_n P_a(x_i)_n P_b(x_o)_n for every m, matrix products over blocks of samples,

with Legendre polynomials P of the radial variables, from which those of every m follow on the host's side.
"""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._special import RadialTables, jacobi_matrix, powers, radial_rows, radial_tables
from hshjax._typing import Array, Float
from hshjax.bases import HSH, SHR, IsotropicBasis, Zernike
from hshjax.bases._base import AbstractBasis, matmul
from hshjax.bases._isotropic import _difference_chart, _factors
from hshjax.brdfs._linear import cosine_power
from hshjax.fitting._blocks import fold
from hshjax.fitting._norms import Norm
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples

BLOCK = 1024
"""Samples a block: what is formed of them stays in the cache."""


class Equations(NamedTuple):
    """BᵀWB, BᵀWf, and Σ w f² per channel, f the series of the norm."""

    gram: Float[Array, "modes modes"]
    right: Float[Array, "modes channels"]
    square: Float[Array, " channels"]


def has_moments(basis: object) -> bool:
    """Whether products of the functions lie in the span of twice the order."""
    return isinstance(basis, IsotropicBasis) and isinstance(basis.basis, HSH | SHR | Zernike)


@partial(jax.jit, static_argnums=(0, 1))
def normal_equations(basis: IsotropicBasis, norm: Norm, samples: Samples) -> Equations:
    """Of the weighted least squares of `project`, for a basis that `has_moments`."""
    twice = IsotropicBasis(_doubled(basis.basis), basis.bilateral)
    channels, once_parts, twice_parts = samples.channels, _bands(basis), _bands(twice)
    degrees = twice.basis.radial_counts()[0]
    legendre = _legendre(degrees)

    def visit(sums, wi, wo, value, weight):
        weight = weight * norm.fit_weight(wi, wo)
        series = cosine_power(wi, wo, norm.exponent)[:, None] * value
        chart_i, chart_o = basis.basis.chart(wi), basis.basis.chart(wo)
        azimuth = powers(*_difference_chart(chart_i, chart_o), twice.basis.order + 1)
        azimuth = azimuth[:1] if basis.bilateral else azimuth
        pi, po = (radial_rows(legendre, _centred(basis.basis, chart.x))[0] for chart in (chart_i, chart_o))
        found = [jnp.sum(weight[:, None] * series**2, axis=0)]
        found += [_band_sums(band, azimuth, pi, po, weight[None]).ravel() for band in twice_parts]
        weighted = (weight[:, None] * series).T
        found += [_band_sums(band, azimuth, pi, po, weighted).ravel() for band in once_parts]
        return sums + jnp.concatenate(found)

    turns = 1 if basis.bilateral else 2
    sizes = [turns * (band.stop - band.start) * band.degrees**2 for band in twice_parts + once_parts]
    sizes[len(twice_parts) :] = [channels * size for size in sizes[len(twice_parts) :]]
    sums = fold(samples, BLOCK, jnp.zeros(channels + sum(sizes), samples.value.dtype), visit)
    square, *parts = jnp.split(sums, np.cumsum([channels, *sizes])[:-1].tolist())
    moments = _inner(twice, twice_parts, parts[: len(twice_parts)], 1)[:, 0]
    right = _inner(basis, once_parts, parts[len(twice_parts) :], channels)
    return Equations(_gram(basis, twice, moments), right, square)


class Band(NamedTuple):
    """Azimuthal orders from start to stop, and how many radial functions the first of them has."""

    start: int
    stop: int
    degrees: int


def _bands(pairs: IsotropicBasis) -> list[Band]:
    """Two: the higher half of the orders has half as many radial functions."""
    counts = pairs.basis.radial_counts()
    half = (len(counts) + 1) // 2
    edges = sorted({0, half, len(counts)})
    return [Band(start, stop, counts[start]) for start, stop in zip(edges, edges[1:], strict=False)]


def _band_sums(band: Band, azimuth: Array, pi: Array, po: Array, weight: Array) -> Array:
    """Σ w (s^m) P_a(i) P_b(o), `(turns, orders, a, weights, b)`: the weights, one or one a channel, go with b."""
    n = pi.shape[1]
    left = azimuth[:, band.start : band.stop, None] * pi[None, None, : band.degrees]
    right = weight[:, None] * po[None, : band.degrees]
    sums = matmul(left.reshape(-1, n), right.reshape(-1, n).T)
    return sums.reshape(*left.shape[:3], weight.shape[0], band.degrees)


def _inner(
    pairs: IsotropicBasis, bands: list[Band], sums: list[Array], channels: int
) -> Float[Array, "modes channels"]:
    """Σ w B_k of every function, from the sums of Legendre polynomials."""
    n, to_radial = pairs.table(), _to_radial(pairs.basis)
    degrees = to_radial.shape[1]
    turns = 1 if pairs.bilateral else 2
    of_order = []
    for band, part in zip(bands, sums, strict=True):
        part = part.reshape(turns, band.stop - band.start, band.degrees, channels, band.degrees)
        change = jnp.asarray(to_radial[band.start : band.stop, : band.degrees, : band.degrees], part.dtype)
        radial = jnp.einsum("mja,tmacb,mkb->mtjkc", change, part, change, precision="highest")
        pad = degrees - band.degrees
        of_order.append(jnp.pad(radial, ((0, 0), (0, 0), (0, pad), (0, pad), (0, 0))))
    table = jnp.concatenate(of_order)
    turn = n.sine.astype(np.int32)
    sign = np.where(n.sine, -1, 1)
    there, back = table[n.m, turn, n.j, n.k], table[n.m, turn, n.k, n.j]
    return _column(n.norm, table) * (there + _column(sign, table) * back)


def _gram(basis: IsotropicBasis, twice: IsotropicBasis, moments: Float[Array, " modes"]) -> Array:
    """BᵀWB on an exact rule, whose weights have the moments."""
    rule = isotropic_pair_rule(2 * twice.basis.order, dtype=moments.dtype)
    n = twice.table()
    ri, ro, azimuth = _factors(twice, rule.wi, rule.wo)
    part = jnp.asarray(n.norm, moments.dtype) * moments
    turn = n.sine.astype(np.int32)
    sign = jnp.asarray(np.where(n.sine, -1, 1), moments.dtype)
    matrix = jnp.zeros((2, *ri.shape[:2], ri.shape[1]), moments.dtype)
    matrix = matrix.at[turn, n.m, n.j, n.k].add(part).at[turn, n.m, n.k, n.j].add(sign * part)
    density = jnp.einsum("tmn,mjn,tmjn->n", azimuth, ri, jnp.einsum("tmjk,mkn->tmjn", matrix, ro, precision="highest"))
    rows = basis(rule.wi, rule.wo)
    return matmul(rows.T, (rule.weight * density)[:, None] * rows)


def _column(values: np.ndarray, like: Array) -> Array:
    return jnp.asarray(values, like.dtype)[:, None]


def _doubled(basis: AbstractBasis) -> AbstractBasis:
    return type(basis)(2 * basis.order)  # pyright: ignore[reportCallIssue]


def _centred(basis: AbstractBasis, x: Array) -> Array:
    """The radial variable on [-1, 1]: that of `SHR` is z."""
    return 2 * x - 1 if isinstance(basis, SHR) else x


@lru_cache
def _legendre(degrees: int) -> RadialTables:
    return radial_tables((degrees,), lambda m: np.sqrt(0.5), lambda m, n: jacobi_matrix(0, 0, n))


@lru_cache
def _to_radial(basis: AbstractBasis) -> np.ndarray:
    """Every radial polynomial in orthonormal Legendre polynomials, `(orders, degrees, degrees)`, by an exact rule."""
    degrees = basis.radial_counts()[0]
    x, weight = np.polynomial.legendre.leggauss(degrees)
    own = (x + 1) / 2 if isinstance(basis, SHR) else x
    radial, legendre = _host_rows(basis.tables(), own), _host_rows(_legendre(degrees), x)[0]
    return np.einsum("mjq,aq,q->mja", radial, legendre, weight)


def _host_rows(tables: RadialTables, x: np.ndarray) -> np.ndarray:
    """`radial_rows` in float64 whatever jax's configuration is."""
    orders, degrees = tables.slope.shape
    rows = np.zeros((orders, degrees, x.size))
    rows[:, 0] = tables.start[:, None]
    for j in range(1, degrees):
        before = rows[:, j - 2] if j > 1 else 0
        rows[:, j] = (tables.slope[:, j, None] * x + tables.shift[:, j, None]) * rows[:, j - 1]
        rows[:, j] -= tables.back[:, j, None] * before
        rows[tables.counts <= j, j] = 0
    return rows
