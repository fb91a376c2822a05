"""Any BRDF as a series in products of two directions, for the closed form of Eq. 1, and what error that makes."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, PairFunction
from hshjax.bases import AbstractBasis, AbstractProductBasis, from_matrix, to_matrix
from hshjax.bases._base import matmul
from hshjax.brdfs._isotropy import is_isotropic
from hshjax.brdfs._linear import LinearBRDF, cosine_power
from hshjax.fitting._incidence import WAYS, Chart, Nodes, Way, exit_nodes, incidence_nodes, incident
from hshjax.fitting._misfit import ratio
from hshjax.fitting._norms import Norm, named_norm
from hshjax.fitting._result import Fit
from hshjax.geometry import direction
from hshjax.metrics import with_channels
from hshjax.quadrature import azimuth_nodes, polar_nodes

FIRST = 16
"""Degree of the first rule."""

EXITS, NODES = 8, (2 * FIRST) ** 2
"""Directions of exit and nodes of incidence in a block, of every rule: what looks at them is compiled once."""


HOPELESS = 10
"""Times the move of lobes: directions that move by more are given up."""


def to_series(
    brdf: PairFunction,
    basis: AbstractProductBasis,
    *,
    norm: str = "D",
    tolerance: float = 1e-3,
    max_degree: int = 128,
) -> Fit[LinearBRDF]:
    """The series over `basis` nearest to a BRDF that can be evaluated anywhere: coefficients by quadrature.

    What `project` says of samples, this says of a function: rules are refined until the coefficients stand still. At
    every degree two rules are tried, one in directions of incidence, which a smooth BRDF suits, and one that follows
    lobes of any width, highlights and those back to the light at once. (A lobe about anything else must be as wide as
    the nodes are apart, or no rule knows of it.) A model of `fit_compact`, an analytic BRDF or a table becomes what
    `reflect` integrates in closed form under a `HarmonicLight`. A highlight that the order cannot hold stays out:
    look at `relative`.

    **Arguments:**

    - `brdf`: values [sr^-1, no cosine] of pairs of directions, finite up to the horizon.
    - `basis`: an `IsotropicBasis`, `HelmholtzBasis` or `TensorBasis` of functions orthonormal on the hemisphere. Those
      that are reciprocal take the reciprocal part of a BRDF that is not.
    - `norm`: "A" ... "E": in which the series is nearest, and its error meant; see `NORMS`.
    - `tolerance`: the degree is doubled from 16 until the coefficients and the root of ∫∫ ρ² move by no more than
      this, relative to the norm of either, in every channel. Directions count only where lobes agree with them, to
      within this as well.
    - `max_degree`: d stands for d directions of exit (times azimuths, where the basis is not isotropic) x 2d x 2d
      of incidence; lobes take twice as many.

    Found in float64, in blocks of 8192 pairs; not under `jax.jit`. Time grows with the third power of the degree that
    it takes, with the fourth for an anisotropic BRDF.

    **Returns:** a `Fit`; `method` says which rule it was, "directions" or "lobes"; `quadrature_error` how far
    coefficients or root moved last, or how far those of directions are from those of lobes, if that is more; `samples`
    how many pairs the rule has. `residual` and `relative` are those of the series itself, on that rule.

    **Raises:** ValueError for a basis that is no product of functions orthonormal on the hemisphere; for an anisotropic
    BRDF and an isotropic basis; for values that are not finite; and where `max_degree` is not enough, with the figure
    that was reached.
    """
    chosen = named_norm(norm)
    if not isinstance(basis, AbstractProductBasis) or not basis.basis.hemispherical:
        raise ValueError(f"a series needs products of functions orthonormal on the hemisphere, got {basis}")
    if not tolerance > 0 or max_degree < 2 * FIRST:
        got = f"{tolerance:g} and {max_degree}"
        raise ValueError(f"tolerance must be > 0 and max_degree at least {2 * FIRST}, got {got}")
    with jax.enable_x64(True):
        isotropic = is_isotropic(brdf)
        if basis.isotropic and not isotropic:
            raise ValueError(f"{basis} is for isotropic BRDFs, and this one is not: take a HelmholtzBasis")
        way, degree, moments, quadrature_error = _settled(brdf, basis, chosen, isotropic, tolerance, max_degree)
        coefficients, condition = _solved(basis, chosen, moments.matrix)
        azimuths = _azimuths(basis, degree, isotropic)
        missed = _sums(brdf, basis, chosen, way, degree, azimuths, to_matrix(basis, coefficients))
        error, size = jnp.sqrt(missed.square), jnp.sqrt(moments.square)
        figures = coefficients, error, ratio(error, size), condition
    coefficients, error, relative, condition = (jnp.asarray(np.asarray(figure)) for figure in figures)
    return Fit(
        LinearBRDF(basis, coefficients, chosen.target),
        error,
        relative,
        condition,
        norm=norm,
        method=way,
        samples=len(WAYS[way]) * degree * azimuths * (2 * degree) ** 2,
        unknowns=basis.count,
        quadrature_error=quadrature_error,
    )


class Moments(NamedTuple):
    """∫∫ f h_a(wi) h_b(wo) under the fit's weight, and ∫∫ (ρ - ρ̂)² under the judge's: ρ̂ a series, or 0 at first."""

    matrix: Float[Array, "k k channels"]
    square: Float[Array, " channels"]


def _settled(
    brdf: PairFunction, basis: AbstractProductBasis, norm: Norm, isotropic: bool, tolerance: float, max_degree: int
) -> tuple[Way, int, Moments, float]:
    """The way that settles first, the degree at which it did, its moments, and their error as far as ways can tell."""
    degree = FIRST
    ways: list[Way] = list(WAYS)
    before: dict[Way, Moments] = {}
    none = jnp.zeros((basis.basis.count, basis.basis.count, 1))
    while True:
        azimuths = _azimuths(basis, degree, isotropic)
        found: dict[Way, Moments] = {}
        for way in ways:
            found[way] = _sums(brdf, basis, norm, way, degree, azimuths, none)
        if not all(bool(jnp.all(jnp.isfinite(part))) for moments in found.values() for part in moments):
            raise ValueError("a series needs a BRDF of finite values on the open hemisphere, got others")
        if before:
            errors = {way: _distance(basis, before[way], found[way]) for way in ways}
            if "directions" in ways and errors["directions"] > HOPELESS * errors["lobes"]:
                ways.remove("directions")
            if "directions" in ways:
                # Directions that miss a lobe stand still as well; lobes would tell.
                errors["directions"] = max(errors["directions"], _distance(basis, found["directions"], found["lobes"]))
            best = min(ways, key=lambda way: errors[way])
            if errors[best] <= tolerance:
                return best, degree, found[best], errors[best]
            if 2 * degree > max_degree:
                raise ValueError(
                    f"coefficients must settle to {tolerance:g} at degree {max_degree} or below, and are still off by "
                    f"{errors[best]:.2g} at {degree}: raise max_degree or tolerance"
                )
        before, degree = found, 2 * degree


def _azimuths(basis: AbstractProductBasis, degree: int, isotropic: bool) -> int:
    """Of wo: one is enough for an isotropic basis; what the basis can tell apart for an isotropic BRDF."""
    if basis.isotropic:
        return 1
    exact = 2 * basis.basis.order + 1
    return exact if isotropic else max(exact, 2 * degree)


def _distance(basis: AbstractProductBasis, a: Moments, b: Moments) -> float:
    """Between coefficients, and between roots of ∫∫ ρ²; relative to those of b, of the worst channel."""
    before, after = (from_matrix(basis, one.matrix) for one in (a, b))
    roots = jnp.sqrt(a.square), jnp.sqrt(b.square)
    moves = (
        ratio(jnp.linalg.norm(after - before, axis=0), jnp.linalg.norm(after, axis=0)),
        ratio(jnp.abs(roots[1] - roots[0]), roots[1]),
    )
    return float(jnp.max(jnp.stack(moves)))


def _lowest(norm: Norm) -> float:
    """The cosine above which a norm sees directions."""
    return float(np.cos(norm.max_theta)) if norm.max_theta < np.pi / 2 else 0.0


def _solved(basis: AbstractProductBasis, norm: Norm, moments: Array) -> tuple[Array, float]:
    """Coefficients from moments, and the condition number of what was solved for them.

    The Gram matrix of all products under the weight (z_i z_o)^fit is C x C, C that of the single functions under
    z^fit. It leaves reciprocal and isotropic functions among themselves: so C⁻¹ on either side, then the projection.
    """
    if norm.orthonormal:
        return from_matrix(basis, moments), 1.0
    single, low = basis.basis, _lowest(norm)
    z, weight = polar_nodes(2 * single.order + 2)
    phi = azimuth_nodes(2 * single.order)
    z, weight = low + (1 - low) * z, (1 - low) * weight
    rows = np.asarray(single(direction(jnp.arccos(jnp.asarray(z))[:, None], jnp.asarray(phi)[None])))
    gram = np.einsum("zpa,zpb,z->ab", rows, rows, weight * z**norm.fit * 2 * np.pi / phi.size, optimize=True)
    inverse = np.linalg.inv(gram)
    matrix = np.einsum("ac,cdk,db->abk", inverse, np.asarray(moments), inverse, optimize=True)
    return from_matrix(basis, jnp.asarray(matrix)), float(np.linalg.cond(gram))


def _sums(
    brdf: PairFunction, basis: AbstractProductBasis, norm: Norm, way: Way, degree: int, azimuths: int, matrix: Array
) -> Moments:
    """Sums over the pairs of a rule, in blocks of one size."""
    low = _lowest(norm)
    exits = exit_nodes(degree, azimuths, low)
    parts: list[tuple[Chart, Nodes]] = []
    for chart in WAYS[way]:
        nodes = incidence_nodes(chart, degree)
        for j in range(0, nodes.phi.size, NODES):
            parts.append((chart, Nodes(*(a[j : j + NODES] for a in nodes))))
    total = None
    for i in range(0, exits[0].size, EXITS):
        cosine, turn, weight = (np.resize(part[i : i + EXITS], EXITS) for part in exits)
        weight[exits[0].size - i :] = 0  # repeated directions do not count
        for chart, nodes in parts:
            wi, wo, solid_angle = incident(chart, cosine, turn, nodes, low)
            wi, wo, of_pairs = map(jnp.asarray, (wi, wo, weight[:, None] * solid_angle))
            part = _block(brdf, basis.basis, norm, wi, wo, of_pairs, matrix)
            total = part if total is None else jax.tree.map(jnp.add, total, part)
    assert total is not None  # there are directions of exit
    return total


@eqx.filter_jit
def _block(
    brdf: PairFunction,
    single: AbstractBasis,
    norm: Norm,
    wi: Float[Array, "exits nodes 3"],
    wo: Float[Array, "exits 3"],
    weight: Float[Array, "exits nodes"],
    matrix: Float[Array, "k k #channels"],
) -> Moments:
    rows, exit_rows = single(wi), single(wo)
    eyes = jnp.broadcast_to(wo[:, None], wi.shape)
    value = with_channels(brdf(wi.reshape(-1, 3), eyes.reshape(-1, 3)), 1).astype(wi.dtype)
    value = value.reshape(*weight.shape, -1)
    seen = weight * cosine_power(wi, eyes, norm.fit + norm.exponent)
    inner = jnp.einsum("onk,onc->okc", rows, seen[..., None] * value, precision="highest")
    moments = jnp.einsum("okc,ol->klc", inner, exit_rows, precision="highest")

    outer = jnp.einsum("klc,ol->okc", matrix, exit_rows, precision="highest")
    series = matmul(rows, outer) / cosine_power(wi, eyes, norm.exponent)[..., None]
    judged = weight * cosine_power(wi, eyes, norm.judge)
    return Moments(moments, jnp.sum(judged[..., None] * (value - series) ** 2, axis=(0, 1)))
