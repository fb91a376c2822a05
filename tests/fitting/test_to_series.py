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
    assert found.quadrature_error < 1e-12
    # In norm E what reaches beyond 80 degrees is left to rounding, by the condition number.
    assert_close(found.model.coefficients, coefficients, tolerance=1e-8 if X64 else 2e-5)
    assert float(found.relative.max()) < 1e-8


@pytest.mark.slow
def test_lambert():
    found = to_series(Lambert(np.array([0.5, 0.2])), ISOTROPIC, norm="C")
    expected = np.zeros((ISOTROPIC.count, 2))
    expected[0] = 2 * np.array([0.5, 0.2])  # the first function is 1 / 2π
    assert_close(found.model.coefficients, expected)


@pytest.mark.skipif(not X64, reason="a dense sum in float64")
@pytest.mark.parametrize("norm", ["D", slow_unless(False, "A")])
def test_a_compact_model_against_a_dense_sum(norm):
    """The same least squares on an isotropic rule of high degree, which a lobe of some degrees needs."""
    model = compact(0.05, 1.0)
    found = to_series(model, ISOTROPIC, norm=norm, tolerance=1e-6)
    dense = project(
        ISOTROPIC, Samples.from_function(model, isotropic_pair_rule(100)), norm=norm, reciprocity=False
    )  # fmt: skip
    assert found.method == "half vectors"
    assert_close(found.model.coefficients, dense.model.coefficients, tolerance=3e-5)
    assert_close(found.relative, dense.relative, tolerance=3e-5)


@pytest.mark.skipif(not X64, reason="narrow lobes in float64")
def test_a_lobe_of_half_a_degree():
    """∫∫ g B over nodes of half vectors at each eye: a rule of its own, ten times as many nodes."""
    model = GGX(0.3, 0.01)
    found = to_series(model, ISOTROPIC, tolerance=1e-5)
    assert found.quadrature_error < 1e-5
    total, square = 0.0, 0.0
    for z, weight in zip(*polar_nodes(80, sqrt=True), strict=True):
        wi, wo, lit = furnace_rule(np.arccos(z), (160, 96))
        wi, wo = jnp.asarray(wi), jnp.broadcast_to(jnp.asarray(wo), wi.shape)
        g = np.asarray(model(wi, wo))[:, 0] * z
        total = total + 2 * np.pi * weight * (lit * g) @ np.asarray(ISOTROPIC(wi, wo))
        square += 2 * np.pi * weight * (lit * g**2) @ np.asarray(wi[:, 2])
    scale = np.abs(total).max()
    assert_close(found.model.coefficients[:, 0] / scale, total / scale, tolerance=1e-4)
    assert_close(found.relative[0], np.sqrt(1 - np.sum(total**2) / square), tolerance=1e-4)


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
    with pytest.raises(ValueError, match=r"settle to 1e-09 at degree 32 or below, and still move by .* at 32: raise"):
        to_series(GGX(0.3, 0.1), ISOTROPIC, tolerance=1e-9, max_degree=32)
