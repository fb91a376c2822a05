"""BRDFs as series: exact where they are such, against dense sums where they are not; the error told is the error."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import (
    HSH,
    SHR,
    HalfVectorBasis,
    HelmholtzBasis,
    IsotropicBasis,
    LogWarp,
    SphericalHarmonics,
    TensorBasis,
    Zernike,
)
from hshjax.brdfs import GGX, Lambert, LinearBRDF, LogLinearBRDF, Ward
from hshjax.fitting import NORMS, project, relative_error, to_series
from hshjax.fitting._furnace import furnace_rule
from hshjax.lighting import HarmonicLight
from hshjax.quadrature import isotropic_pair_rule, polar_nodes
from hshjax.reflectance import reflect
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, slow_unless

ISOTROPIC = IsotropicBasis(HSH(2))


def random(basis, channels=2):
    return jnp.asarray(np.random.default_rng(0).normal(size=(basis.count, channels)), DTYPE)


def compact(alpha, gloss):
    """A log-linear model: about 1/π · exp(-gloss · u) beside a base of a tenth."""
    basis = HalfVectorBasis(((0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 2, 0), (1, 2, 2)), LogWarp(jnp.asarray(alpha, DTYPE)))
    return LogLinearBRDF(basis, [jnp.asarray([-1.0, -gloss, 0.1, 0.05, 0.02], DTYPE), jnp.asarray([0.1], DTYPE)])


@pytest.mark.parametrize(
    ("basis", "norm"),
    [
        slow_unless(norm == "A", ISOTROPIC, norm, id=f"isotropic, {norm}") for norm in NORMS
    ]
    + [
        slow_unless(False, IsotropicBasis(SHR(2), bilateral=False), "B", id="not bilateral"),
        slow_unless(False, IsotropicBasis(Zernike(3)), "E", id="Zernike"),
        slow_unless(False, HelmholtzBasis(HSH(1)), "A", id="Helmholtz"),
        slow_unless(False, TensorBasis(Zernike(2)), "D", id="not reciprocal"),
    ],
)  # fmt: skip
def test_a_series_comes_back(basis, norm):
    coefficients = random(basis)
    found = to_series(LinearBRDF(basis, coefficients, NORMS[norm].target), basis, norm=norm)
    assert found.model.coefficients.dtype == DTYPE
    assert found.method == "directions"
    assert found.quadrature_error <= 1e-3  # of the rule that follows lobes, where they disagree
    # In norm E what reaches beyond 80 degrees is left to rounding, by the condition number.
    assert_close(found.model.coefficients, coefficients, tolerance=1e-8 if X64 else 2e-5)
    assert float(found.relative.max()) < 1e-8


@pytest.mark.slow
def test_lambert():
    found = to_series(Lambert(np.array([0.5, 0.2])), ISOTROPIC, norm="C")
    expected = np.zeros((ISOTROPIC.count, 2))
    expected[0] = 2 * np.array([0.5, 0.2])  # the first function is 1 / 2π
    assert_close(found.model.coefficients, expected)


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="a dense sum in float64")
@pytest.mark.parametrize("norm", ["D", slow_unless(False, "A")])
def test_a_compact_model_against_a_dense_sum(norm):
    """The same least squares on an isotropic rule of high degree, which a lobe of some degrees needs."""
    model = compact(0.05, 1.0)
    found = to_series(model, ISOTROPIC, norm=norm, tolerance=1e-6)
    dense = project(
        ISOTROPIC, Samples.from_function(model, isotropic_pair_rule(100)), norm=norm, reciprocity=False
    )  # fmt: skip
    assert found.method == "lobes"
    # Where ρ itself is fitted, grazing pairs count more; the dense sum is off by 3e-4 there.
    assert_close(found.model.coefficients, dense.model.coefficients, tolerance=3e-5 if norm == "D" else 5e-4)
    assert_close(found.relative, dense.relative, tolerance=3e-5)


def retro(peak, width):
    """A lobe about wi = wo that falls to 1/e of its peak at `width` [radians]."""
    return lambda wi, wo: peak * jnp.exp(-jnp.sum((wi - wo) ** 2, axis=-1, keepdims=True) / width**2)


def about(angle, nodes=(160, 96)):
    """Light for an eye at some polar angle, as `furnace_rule` has it, on nodes that are dense about the eye."""
    t, weight = np.polynomial.legendre.leggauss(nodes[0])
    t, weight = (t + 1) / 2, weight / 2
    gamma, psi = (
        np.repeat(np.pi * t**4, nodes[1]),
        np.tile(2 * np.pi * (np.arange(nodes[1]) + 0.5) / nodes[1], nodes[0]),
    )
    frame = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
    wi = np.stack([np.sin(gamma) * np.cos(psi), np.sin(gamma) * np.sin(psi), np.cos(gamma)], axis=-1) @ frame
    solid_angle = np.repeat(4 * np.pi * t**3 * weight, nodes[1]) * np.sin(gamma) * 2 * np.pi / nodes[1]
    lit = wi[:, 2] > 0
    return np.where(lit[:, None], wi, [0, 0, 1]), frame[2], np.where(lit, solid_angle * wi[:, 2], 0)


def summed(*parts):
    """∫∫ z_i z_o ρ B and ∫∫ (z_i z_o)² ρ σ of parts (ρ, σ, rule), over ten times as many nodes as it takes."""
    total, square = 0.0, 0.0
    for brdf, other, rule in parts:
        for z, weight in zip(*polar_nodes(80, sqrt=True), strict=True):
            wi, wo, lit = rule(np.arccos(z))
            wi, wo = jnp.asarray(wi), jnp.broadcast_to(jnp.asarray(wo), wi.shape)
            value = np.asarray(brdf(wi, wo))[:, 0] * z
            total = total + 2 * np.pi * weight * (lit * value) @ np.asarray(ISOTROPIC(wi, wo))
            square += 2 * np.pi * weight * (lit * value) @ np.asarray(other(wi, wo)[:, 0] * z * wi[:, 2])
    return total, square


def assert_summed(found, total, square, tolerance=1e-4):
    scale = np.abs(total).max()
    assert found.method == "lobes"
    assert_close(found.model.coefficients[:, 0] / scale, total / scale, tolerance=tolerance)
    assert_close(found.relative[0], np.sqrt(1 - np.sum(total**2) / square), tolerance=tolerance)


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="narrow lobes in float64")
def test_a_lobe_of_half_a_degree():
    """∫∫ g B over nodes of half vectors at each eye."""
    model = GGX(0.3, 0.01)
    found = to_series(model, ISOTROPIC, tolerance=1e-5)
    assert found.quadrature_error < 1e-5
    assert_summed(found, *summed((model, model, lambda angle: furnace_rule(angle, (160, 96)))))


@pytest.mark.skipif(not X64, reason="narrow lobes in float64")
@pytest.mark.parametrize(
    ("width", "roughness"), [(0.02, 0.01), slow_unless(False, 0.05, 0.005), slow_unless(False, 0.005, 0.1)]
)
@pytest.mark.slow
def test_a_highlight_and_a_lobe_back_to_the_light(width, roughness):
    """Each on nodes of its own. Their product counts on those about the eye: the lobe is what ends it."""
    highlight, back = GGX(0.3, roughness), retro(0.2 / width**2, width)
    found = to_series(lambda wi, wo: highlight(wi, wo) + back(wi, wo), ISOTROPIC)
    expected = summed(
        (highlight, highlight, lambda angle: furnace_rule(angle, (160, 96))),
        (back, lambda wi, wo: back(wi, wo) + 2 * highlight(wi, wo), about),
    )
    assert_summed(found, *expected, tolerance=1e-3)


@pytest.mark.parametrize("width", [0.003, slow_unless(False, 0.0005)])
def test_a_lobe_back_to_the_light_in_closed_form(width):
    """Narrow ones see a basis at wi = wo alone: π peak width² ∫ z² B(w, w) dω."""
    base, back = Lambert(0.1 * np.pi), retro(500.0, width)
    found = to_series(lambda wi, wo: base(wi, wo) + back(wi, wo), ISOTROPIC)
    z, weight = (jnp.asarray(part, DTYPE) for part in polar_nodes(40, sqrt=True))
    w = jnp.stack([jnp.sqrt(1 - z**2), 0 * z, z], axis=-1)
    lobe = 500 * np.pi * width**2 * 2 * np.pi * np.asarray((weight * z**2) @ ISOTROPIC(w, w))
    dull = project(ISOTROPIC, Samples.from_function(base, isotropic_pair_rule(20)), reciprocity=False)
    # Of the next term, width² ∇² B / 4, and of the horizon less than that is left.
    assert_close(found.model.coefficients[:, 0] - dull.model.coefficients[:, 0], lobe, tolerance=1e-3 * lobe.max())
    assert found.method == "lobes"
    assert float(found.relative[0]) > 0.5


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="narrow lobes in float64")
def test_a_compact_model_of_a_retro_reflector():
    """As `fit_compact` makes them, a warp of either angle: tens of times brighter within a degree of the light."""
    basis = HalfVectorBasis(
        ((0, 0, 0), (0, 2, 0), (0, 4, 0), (1, 0, 0)), LogWarp(jnp.asarray(0.3)), LogWarp(jnp.asarray(1e-4))
    )
    model = LogLinearBRDF(basis, [jnp.asarray([-1.0, -1.2, 0.2, -0.1])])
    values = np.asarray(model(jnp.asarray([[0.0, 0, 1], [0, 0, 1]]), jnp.asarray([[0.0, 0, 1], [0.6, 0, 0.8]])))
    assert values[0] > 20 * values[1]
    assert_summed(to_series(model, ISOTROPIC), *summed((model, model, about)), tolerance=1e-3)


def test_directions_count_only_where_lobes_agree(unchecked):
    """A highlight of 1e-5 radians: directions stand still without it, while lobes still look for its height."""

    def brdf(wi, wo):
        h = wi + wo
        return 0.1 + 5e3 * jnp.exp(-jnp.sum(h[:, :2] ** 2, axis=1, keepdims=True) / (1e-5 * h[:, 2:]) ** 2)

    with pytest.raises(ValueError, match="at degree 32 or below, and are still off by"):
        to_series(brdf, ISOTROPIC, max_degree=32)


@pytest.mark.slow
def test_the_error_that_is_reported_is_the_error():
    """Against samples on a rule in directions that was not looked at."""
    model, basis = compact(1.0, 0.3), IsotropicBasis(HSH(4))
    found = to_series(model, basis)
    rule = isotropic_pair_rule(70)
    assert 0.001 < float(found.relative.max()) < 0.5
    judged = relative_error(found.model, Samples.from_function(model, rule))
    assert_close(found.relative, judged, tolerance=1e-3)


@pytest.mark.skipif(not X64, reason="figures, not dtypes")
def test_radiance_is_that_of_the_model_itself():
    """In closed form, against the sum over the light of the compact model: off by no more than the series is."""
    model = compact(1.0, 0.3)
    found = to_series(model, IsotropicBasis(HSH(4)))
    rng = np.random.default_rng(0)
    light = jnp.asarray(np.r_[5.0, rng.normal(size=24)][:, None])
    normals = rng.normal(size=(30, 3))
    normals = jnp.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    eye = normals + jnp.asarray(0.8 * rng.normal(size=(30, 3)))
    eye /= jnp.linalg.norm(eye, axis=1, keepdims=True)
    seen = np.sum(np.asarray(normals) * np.asarray(eye), axis=1) > 0.2
    normals, eye = normals[seen], eye[seen]
    series = reflect(found.model, HarmonicLight(light), normals, eye)
    summed = reflect(model, HarmonicLight(light, degree=48), normals, eye)
    error = float(jnp.linalg.norm(series - summed) / jnp.linalg.norm(summed))
    assert float(found.relative.max()) < 0.05
    assert error < 2 * float(found.relative.max())


@pytest.mark.slow
def test_an_anisotropic_model():
    basis = HelmholtzBasis(HSH(2))
    found = to_series(Ward(0.3, 0.5, 0.3), basis)
    swapped = to_series(Ward(0.3, 0.3, 0.5), basis)
    assert_close(found.relative, swapped.relative, tolerance=1e-2)
    assert float(jnp.abs(found.model.coefficients - swapped.model.coefficients).max()) > 1e-3


def test_what_is_refused(unchecked):
    with pytest.raises(ValueError, match="products of functions orthonormal on the hemisphere"):
        to_series(Lambert(0.5), HalfVectorBasis(4))
    with pytest.raises(ValueError, match="products of functions orthonormal on the hemisphere"):
        to_series(Lambert(0.5), IsotropicBasis(SphericalHarmonics(2)))
    with pytest.raises(ValueError, match="take a HelmholtzBasis"):
        to_series(Ward(0.5, 0.3, 0.1), ISOTROPIC)
    with pytest.raises(ValueError, match=r"max_degree at least 32, got 0\.001 and 16"):
        to_series(Lambert(0.5), ISOTROPIC, max_degree=16)
    with pytest.raises(ValueError, match="finite values"):
        to_series(lambda wi, wo: jnp.where(wi[:, 2:] < 0.5, jnp.nan, 1.0), ISOTROPIC)
    with pytest.raises(
        ValueError, match=r"settle to 1e-09 at degree 32 or below, and are still off by .* at 32: raise"
    ):
        to_series(GGX(0.3, 0.1), ISOTROPIC, tolerance=1e-9, max_degree=32)
