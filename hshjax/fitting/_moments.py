"""Normal equations of many samples from moments: for bases that are polynomials, and so are their products.

A product of two functions of an isotropic basis of order N lies in the span of that of order 2N. The Gram matrix of
any number of weighted samples therefore depends on nothing but the moments m_k = Σ w B_k(wi, wo) of the functions of
order 2N; samples at the nodes of an exact rule, weighted by v_q Σ_k m_k B_k(q), have the same moments, and the same
Gram matrix. Some thousand moments (order 8) are much less work than the products of all columns at every sample:

    moments: Σ_n w_n (Re s^m)_n P_a(x_i)_n P_b(x_o)_n for every m, matrix products over blocks of samples,

with Legendre polynomials P of the radial variables, from which those of every m follow on the host's side.
"""

import os
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._special import RadialTables, jacobi_matrix, powers, radial_rows, radial_tables
from hshjax._typing import Array, Float
from hshjax.bases import HSH, SHR, IsotropicBasis, Zernike
from hshjax.bases._base import AbstractBasis, matmul
from hshjax.bases._isotropic import _difference_chart
from hshjax.brdfs._linear import cosine_power
from hshjax.fitting._blocks import fold
from hshjax.fitting._norms import Norm
from hshjax.fitting._sample_blocks import regrouped
from hshjax.quadrature import PairRule, isotropic_pair_rule
from hshjax.samples import Samples

BLOCK = 4096
"""Samples a block."""

NODES = 512
"""Of the rule, a block: what is formed of them stays in the cache."""

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
"""That this process may use, where the system tells."""

ENOUGH = 4
"""Samples for every node of the rule, from which moments save work: the nodes cost as much as so many samples by QR."""


class Equations(NamedTuple):
    """BᵀWB, BᵀWf, and Σ w f² per channel, f the series of the norm."""

    gram: Float[Array, "modes modes"]
    right: Float[Array, "modes channels"]
    square: Float[Array, " channels"]


def has_moments(basis: object) -> TypeGuard[IsotropicBasis]:
    """Whether products of the functions lie in the span of twice the order."""
    return isinstance(basis, IsotropicBasis) and isinstance(basis.basis, HSH | SHR | Zernike)


def pay(basis: IsotropicBasis, samples: int) -> bool:
    """Whether so many samples are enough for moments to save work."""
    order = basis.basis.order  # `_rule` is of degree 4 order, and half of it where the basis is bilateral
    nodes = (2 * order + 1) ** 2 * (4 * order + 1) / (2 if basis.bilateral else 1)
    return samples > ENOUGH * nodes


def normal_equations(basis: IsotropicBasis, norm: Norm, samples: Samples) -> Equations:
    """Of the weighted least squares of `project`, for a basis that `has_moments`. Not under `jax.jit`: parts of the
    samples are summed at the same time, one a core.
    """
    rows = max(BLOCK, -(-samples.size // CORES))  # of all parts, so that one program serves them
    parts = [_moments(basis, norm, part) for part in regrouped([samples], rows)]
    return equations(basis, jnp.stack(parts), samples.channels)


def equations(basis: IsotropicBasis, sums: Float[Array, "parts sums"], channels: int) -> Equations:
    """From the sums of all parts: see `_moments`."""
    wi, wo, weight, *_ = _rule(twice_order(basis), jnp.float64)
    return _equations(basis, sums, channels, Samples.scattered(wi, wo, weight[:, None], weight))


def sums_size(basis: IsotropicBasis, channels: int) -> int:
    """How many there are."""
    return sum(_sizes(basis, channels))


@partial(jax.jit, static_argnums=(0, 1))
def _moments(basis: IsotropicBasis, norm: Norm, samples: Samples) -> Float[Array, " sums"]:
    """Σ w f² per channel, and the sums of Legendre polynomials: with w for twice the order, with w f for the order."""
    twice = twice_order(basis)
    once_parts, twice_parts = bands(basis), bands(twice)
    legendre = legendre_tables(twice.basis.radial_counts()[0])

    def visit(sums, wi, wo, value, weight):
        weight = weight * norm.fit_weight(wi, wo)
        series = cosine_power(wi, wo, norm.exponent)[:, None] * value
        chart_i, chart_o = basis.basis.chart(wi), basis.basis.chart(wo)
        azimuth = powers(*_difference_chart(chart_i, chart_o), twice.basis.order + 1)
        azimuth = azimuth[:1] if basis.bilateral else azimuth
        pi, po = (radial_rows(legendre, centred(basis.basis, chart.x))[0] for chart in (chart_i, chart_o))
        found = [jnp.sum(weight[:, None] * series**2, axis=0)]
        found += [_band_sums(band, azimuth, pi, po, weight[None]).ravel() for band in twice_parts]
        weighted = (weight[:, None] * series).T
        found += [_band_sums(band, azimuth, pi, po, weighted).ravel() for band in once_parts]
        return sums + jnp.concatenate(found)

    return fold(samples, BLOCK, jnp.zeros(sums_size(basis, samples.channels), samples.value.dtype), visit)


def _sizes(basis: IsotropicBasis, channels: int) -> list[int]:
    """Of the parts of the sums, in their order."""
    turns = 1 if basis.bilateral else 2
    sizes = [
        [turns * (band.stop - band.start) * band.degrees**2 for band in bands(b)] for b in (twice_order(basis), basis)
    ]
    return [channels, *sizes[0], *(channels * size for size in sizes[1])]


@partial(jax.jit, static_argnums=(0, 2))
def _equations(basis: IsotropicBasis, sums: Float[Array, "parts sums"], channels: int, rule: Samples) -> Equations:
    twice = twice_order(basis)
    edges = np.cumsum(_sizes(basis, channels))[:-1].tolist()
    square, *parts = jnp.split(jnp.sum(sums, axis=0), edges)
    of_twice = bands(twice)
    moments = _inner(twice, of_twice, parts[: len(of_twice)], 1)[:, 0]
    right = _inner(basis, bands(basis), parts[len(of_twice) :], channels)
    return Equations(_gram(basis, moments, rule), right, square)


class Band(NamedTuple):
    """Azimuthal orders from start to stop, and how many radial functions the first of them has."""

    start: int
    stop: int
    degrees: int


def bands(pairs: IsotropicBasis) -> list[Band]:
    """Two: the higher half of the orders has half as many radial functions."""
    counts = pairs.basis.radial_counts()
    half = (len(counts) + 1) // 2
    edges = sorted({0, half, len(counts)})
    return [Band(start, stop, counts[start]) for start, stop in pairwise(edges)]


def _band_sums(band: Band, azimuth: Array, pi: Array, po: Array, weight: Array) -> Array:
    """Σ w (s^m) P_a(i) P_b(o), `(turns, orders, a, weights, b)`: the weights, one or one a channel, go with b."""
    n = pi.shape[1]
    left = azimuth[:, band.start : band.stop, None] * pi[None, None, : band.degrees]
    right = weight[:, None] * po[None, : band.degrees]
    sums = matmul(left.reshape(-1, n), right.reshape(-1, n).T)
    return sums.reshape(*left.shape[:3], weight.shape[0], band.degrees)


def _inner(
    pairs: IsotropicBasis, split: list[Band], sums: list[Array], channels: int
) -> Float[Array, "modes channels"]:
    """Σ w B_k of every function, from the sums of Legendre polynomials."""
    n, to_radial = pairs.table(), _to_radial(pairs.basis)
    degrees = to_radial.shape[1]
    turns = 1 if pairs.bilateral else 2
    of_order = []
    for band, part in zip(split, sums, strict=True):
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


def _gram(basis: IsotropicBasis, moments: Float[Array, " twice"], rule: Samples) -> Float[Array, "modes modes"]:
    """BᵀWB: of the nodes of a rule, weighted such that they have the moments."""
    twice = twice_order(basis)

    def visit(gram, wi, wo, _, weight):
        density = twice.block_sums(moments[:, None], wi, wo)[:, 0]
        rows = basis(wi, wo)
        return gram + matmul(rows.T, (weight * density)[:, None] * rows)

    return fold(rule, NODES, jnp.zeros((basis.count, basis.count), moments.dtype), visit)


def _rule(pairs: IsotropicBasis, dtype) -> PairRule:
    """Exact for the product of three functions, two of an order and one of twice that, the order of `pairs`."""
    wi, wo, weight, degree, isotropic = isotropic_pair_rule(2 * pairs.basis.order, dtype=dtype)
    if pairs.bilateral:  # what is below the plane of incidence mirrors what is above
        side = np.asarray(wo[:, 1])
        above = side > -1e-6
        weight = weight * jnp.asarray(np.where(side > 1e-6, 2, 1), dtype)
        wi, wo, weight = wi[above], wo[above], weight[above]
    return PairRule(wi, wo, weight, degree, isotropic)


def twice_order(basis: IsotropicBasis) -> IsotropicBasis:
    return IsotropicBasis(_doubled(basis.basis), basis.bilateral)


def _column(values: np.ndarray, like: Array) -> Array:
    return jnp.asarray(values, like.dtype)[:, None]


def _doubled(basis: AbstractBasis) -> AbstractBasis:
    return type(basis)(2 * basis.order)  # pyright: ignore[reportCallIssue]


def centred(basis: AbstractBasis, x: Array) -> Array:
    """The radial variable on [-1, 1]: that of `SHR` is z."""
    return 2 * x - 1 if isinstance(basis, SHR) else x


@lru_cache
def legendre_tables(degrees: int) -> RadialTables:
    return radial_tables((degrees,), lambda m: np.sqrt(0.5), lambda m, n: jacobi_matrix(0, 0, n))


@lru_cache
def _to_radial(basis: AbstractBasis) -> np.ndarray:
    """Every radial polynomial in orthonormal Legendre polynomials, `(orders, degrees, degrees)`, by an exact rule."""
    degrees = basis.radial_counts()[0]
    x, weight = np.polynomial.legendre.leggauss(degrees)
    own = (x + 1) / 2 if isinstance(basis, SHR) else x
    radial, legendre = _host_rows(basis.tables(), own), _host_rows(legendre_tables(degrees), x)[0]
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
