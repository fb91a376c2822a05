"""Normal equations of a table over half and difference angles from moments, line by line of φ_d.

Along a line of nodes, θ_h and θ_d fixed, z_i and z_o are c ∓ s cos φ_d with c = cos θ_h cos θ_d, s = sin θ_h sin θ_d.
What a reciprocal, bilateral function asks of the two,

    P_a(x_i) P_b(x_o) + P_b(x_i) P_a(x_o)        (x linear in z),

is a polynomial in y = cos² φ_d, of degree (a + b) / 2 at most. So few Chebyshev nodes in y, as many as there are
degrees, carry the sums of a line whatever the values are: at each azimuthal order the samples give each node a weight,

    Σ_φ w g p(y_φ) = Σ_q p(y_q) W_q,    W_q = Σ_φ w g ℓ_q(y_φ),    ℓ_q the cardinal polynomials,

and products of radial polynomials are formed at those nodes only, between the horizon and φ_d = π/2.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._special import powers, radial_rows
from hshjax._typing import Array, Float, Int
from hshjax.bases import IsotropicBasis
from hshjax.bases._base import matmul
from hshjax.bases._isotropic import _difference_chart
from hshjax.brdfs import HalfVectorTable
from hshjax.brdfs._cells import GRAZING
from hshjax.brdfs._half_vector_table import folded_azimuth, solid_angles
from hshjax.brdfs._linear import cosine_power
from hshjax.fitting._checks import Counts
from hshjax.fitting._moments import (
    CORES,
    Equations,
    bands,
    centred,
    equations,
    legendre_tables,
    sums_size,
    twice_order,
)
from hshjax.fitting._norms import Norm
from hshjax.geometry import tilted

Nodes = Any
"""An array: of the host, and inside of what is compiled one of jax."""


class Across(NamedTuple):
    """Of the nodes along θ_d, `(d,)`, and φ_d, `(f,)`: sines and cosines; which two of φ_d are one sample, with their
    arcs `(2, f)`."""

    cos_d: Nodes
    sin_d: Nodes
    cos_f: Nodes
    sin_f: Nodes
    first: Nodes
    second: Nodes
    arcs: Nodes


class Slices(NamedTuple):
    """Of every θ_h: cosine and sine `(h,)`, solid angles over the arcs `(h, d)`, values `(h, d, φ, channels)`, and
    which are measured `(h, d, φ)`."""

    cos_h: Nodes
    sin_h: Nodes
    solid: Nodes
    values: Nodes
    measured: Nodes | None


def table_equations(basis: IsotropicBasis, norm: Norm, table: HalfVectorTable) -> tuple[Equations, Counts]:
    """Those of `normal_equations` for `table.node_samples(folded=True)`, and the counts of these, in float64.

    `basis` is bilateral and `has_moments`. Slices of θ_h are summed at the same time, one part a core.
    """
    theta_h, theta_d, phi_d = (np.asarray(axis, np.float64) for axis in (table.theta_h, table.theta_d, table.phi_d))
    half, arcs = solid_angles(theta_h, theta_d, phi_d)
    pairs = folded_azimuth(phi_d, arcs)
    kept = phi_d[pairs.first]
    across = Across(np.cos(theta_d), np.sin(theta_d), np.cos(kept), np.sin(kept), *pairs)
    values = np.asarray(table.values, np.float64)
    measured = None if table.measured is None else np.asarray(table.measured)
    whole = Slices(np.cos(theta_h), np.sin(theta_h), half, values, measured)
    parts = []
    for some in np.array_split(np.arange(theta_h.size), min(CORES, theta_h.size)):
        part = jax.tree.map(lambda axis, a=some[0], b=some[-1] + 1: axis[a:b], whole)
        parts.append(_sums(basis, norm, part, across))
    sums, counts, total = zip(*parts, strict=True)
    used, inside = np.sum(np.asarray(counts), axis=0)
    found = Counts(int(used), int(used), int(inside), float(np.sum(np.asarray(total))))
    return equations(basis, jnp.stack(sums), values.shape[3]), found


@partial(jax.jit, static_argnums=(0, 1))
def _sums(
    basis: IsotropicBasis, norm: Norm, slices: Slices, across: Across
) -> tuple[Float[Array, " sums"], Int[Array, "2"], Float[Array, ""]]:
    """What `equations` takes; how many nodes are used and seen by the norm; their weights' sum."""
    channels = slices.values.shape[3]

    def visit(state, one: Slices):
        return jax.tree.map(jnp.add, state, _slice_sums(basis, norm, one, across)), None

    dtype = slices.values.dtype
    empty = jnp.zeros(sums_size(basis, channels), dtype), jnp.zeros(2, int), jnp.zeros((), dtype)
    return jax.lax.scan(visit, empty, slices)[0]


def _slice_sums(basis: IsotropicBasis, norm: Norm, one: Slices, across: Across):
    """The same of the lines of one θ_h."""
    twice = twice_order(basis)
    channels = one.values.shape[2]
    shape = across.cos_d.size, across.cos_f.size  # (d, f)

    # Two nodes are one sample: weights add, values are their weighted mean.
    share, value = jnp.zeros(shape, one.values.dtype), jnp.zeros((*shape, channels), one.values.dtype)
    for index, arc in zip((across.first, across.second), across.arcs, strict=True):
        there = jnp.broadcast_to(arc[None] > 0, shape)
        if one.measured is not None:
            there = there & one.measured[:, index]
        share = share + jnp.where(there, arc[None], 0)
        value = value + jnp.where(there[..., None], arc[None, :, None] * one.values[:, index], 0)

    cos_d, sin_d, cos_f, sin_f = across.cos_d[:, None], across.sin_d[:, None], across.cos_f[None], across.sin_f[None]
    x, y, z = sin_d * cos_f, sin_d * sin_f, jnp.broadcast_to(cos_d, shape)
    wi, wo = (
        jnp.stack(tilted(one.cos_h, one.sin_h, sign * x, sign * y, z), axis=-1).reshape(-1, 3) for sign in (1, -1)
    )
    used = (jnp.minimum(wi[:, 2], wo[:, 2]) > GRAZING) & (share.ravel() > 0)
    full = jnp.where(used, (one.solid[:, None] * share).ravel(), 0)
    weight = full * norm.fit_weight(wi, wo)
    mean = jnp.where(used[:, None], value.reshape(-1, channels) / jnp.where(used, share.ravel(), 1)[:, None], 0)
    series = jnp.where(used[:, None], cosine_power(wi, wo, norm.exponent)[:, None] * mean, 0)
    weighted = (weight[:, None] * series).T

    orders, once_orders = twice.basis.order + 1, basis.basis.order + 1
    azimuth = powers(*_difference_chart(basis.basis.chart(wi), basis.basis.chart(wo)), orders)[0]
    azimuth = jnp.where(used[None], azimuth, 0)
    left = jnp.concatenate(
        [azimuth * weight[None], (azimuth[:once_orders, None] * weighted[None]).reshape(-1, weight.size)]
    )

    degrees, once_degrees = (pairs.basis.radial_counts()[0] for pairs in (twice, basis))
    reach = _reach(one.cos_h * across.cos_d, one.sin_h * across.sin_d)
    chebyshev = _chebyshev(across.cos_f[None] ** 2 / reach[:, None], degrees)  # (degrees, d, f)
    spectra = jnp.einsum("odf,kdf->odk", left.reshape(-1, *shape), chebyshev, precision="highest")
    of_twice = _band_sums(twice, one, across, reach, spectra[:orders, None])
    series_spectra = spectra[orders:, :, :once_degrees].reshape(once_orders, channels, shape[0], once_degrees)
    of_once = _band_sums(basis, one, across, reach, series_spectra)
    square = jnp.sum(weighted * series.T, axis=1)
    counts = jnp.stack([jnp.sum(used), jnp.sum(weight > 0)])
    return jnp.concatenate([square, *of_twice, *of_once]), counts, jnp.sum(full)


def _reach(c: Float[Array, " d"], s: Float[Array, " d"]) -> Float[Array, " d"]:
    """The largest y = cos² φ_d with both directions above the horizon."""
    cut = s > c
    return jnp.where(cut, c / jnp.where(cut, s, 1), 1) ** 2


def _chebyshev(y: Float[Array, "d f"], degrees: int) -> Float[Array, "degrees d f"]:
    """T_k(2y - 1), y relative to the reach of its line; what lies beyond has no weight, and gets that of the end."""
    x = 2 * jnp.minimum(y, 1) - 1
    rows = [jnp.ones_like(x), x]
    for _ in range(2, degrees):
        rows.append(2 * x * rows[-1] - rows[-2])
    return jnp.stack(rows[:degrees])


def _band_sums(
    pairs: IsotropicBasis,
    one: Slices,
    across: Across,
    reach: Float[Array, " d"],
    spectra: Float[Array, "orders weights d degrees"],
) -> list[Float[Array, " sums"]]:
    """Sums of products of Legendre polynomials, band by band, from sums of Chebyshev polynomials along each line."""
    degrees = spectra.shape[3]
    angle = (np.arange(degrees) + 0.5) * np.pi / degrees
    # Of cardinal polynomials in Chebyshev's.
    cardinal = np.cos(np.arange(degrees)[:, None] * angle) * np.where(np.arange(degrees) == 0, 1, 2)[:, None] / degrees
    at_nodes = matmul(spectra, jnp.asarray(cardinal, spectra.dtype))
    at_nodes = at_nodes.reshape(*spectra.shape[:2], -1)  # (orders, weights, d x nodes)

    turn = jnp.sqrt(reach[:, None] * (1 + jnp.asarray(np.cos(angle), reach.dtype))[None] / 2)  # cos φ_d
    mean, swing = (one.cos_h * across.cos_d)[:, None], (one.sin_h * across.sin_d)[:, None] * turn
    tables = legendre_tables(degrees)
    pi, po = (radial_rows(tables, _centred_radial(pairs, z.ravel()))[0] for z in (mean - swing, mean + swing))
    products = pi[:, None] * po[None]
    sums = []
    for band in bands(pairs):
        left = at_nodes[band.start : band.stop]
        right = products[: band.degrees, : band.degrees].reshape(-1, products.shape[2])
        found = matmul(left.reshape(-1, left.shape[2]), right.T)
        found = found.reshape(*left.shape[:2], band.degrees, band.degrees)
        sums.append(jnp.swapaxes(found, 1, 2).ravel())  # (orders, a, weights, b)
    return sums


def _centred_radial(pairs: IsotropicBasis, z: Float[Array, " n"]) -> Float[Array, " n"]:
    """The radial variable of cos θ, on [-1, 1]: linear in z."""
    zero = jnp.zeros_like(z)
    return centred(pairs.basis, pairs.basis.chart(jnp.stack([zero, zero, z], axis=1)).x)
