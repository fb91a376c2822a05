"""Formulas for renderers against the library's own evaluation, and the lobe that renderers sample by."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax import bases
from hshjax.brdfs import SquaredBRDF
from hshjax.io._formula import formula, terms
from hshjax.io._proposal import NODES, POINTS, _lobe, _reflected_normals, fitted_proposal
from tests.helpers import DTYPE, X64, directions
from tests.io.renderers import OnNumpy, coefficients, half_vector, linear, models

MODELS = models()

RINGS = 240


@pytest.mark.parametrize("name", MODELS)
def test_terms_are_the_functions_of_the_basis(name):
    basis = MODELS[name].basis
    wi, wo = directions(0, 40, min_z=1e-4), directions(1, 40, min_z=1e-4)
    rows, seen = np.zeros((40, basis.count)), []
    for number, norm, value in terms(basis, tuple(np.asarray(wi, float).T), tuple(np.asarray(wo, float).T), OnNumpy()):
        rows[:, number] = norm * value
        seen.append(number)
    assert sorted(seen) == list(range(basis.count))
    # The logarithm of a warp is a series here, cut at 1e-10; functions of degree 10 multiply errors of coordinates.
    np.testing.assert_allclose(rows, basis(wi, wo), rtol=0, atol=1e-8 if X64 else 2e-4)


@pytest.mark.parametrize(
    "warp",
    [bases.LogWarp(np.asarray(alpha, DTYPE)) for alpha in (1e-6, 1e-2, 1.0, 9.0)]
    + [bases.RationalWarp(np.asarray(1e-3, DTYPE)), bases.RootWarp(), bases.IdentityWarp()],
    ids=str,
)
def test_warps_where_directions_mirror_each_other_and_beyond(warp):
    basis = half_vector(12, warp, warp)
    theta = np.r_[0, np.geomspace(1e-5, 1.5, 40)]
    wi = hshjax.direction(jnp.asarray(theta, DTYPE), jnp.asarray(0, DTYPE))
    for phi in (0.0, 1.0, np.pi):
        wo = hshjax.direction(jnp.asarray(theta, DTYPE), jnp.asarray(phi, DTYPE))
        pair = (tuple(np.asarray(w).T) for w in (wi, wo))
        found = {t: norm * value for t, norm, value in terms(basis, *pair, OnNumpy())}
        for t, column in enumerate(np.asarray(basis(wi, wo)).T):
            np.testing.assert_allclose(found[t], column, rtol=0, atol=1e-8 if X64 else 1e-3)


def test_logarithms_of_components_become_those_of_channels():
    model = MODELS["compact"]
    found = formula(model)
    wi, wo = directions(2, 50, min_z=0.05), directions(3, 50, min_z=0.05)
    series = np.asarray(model.basis(wi, wo), float) @ found.coefficients
    np.testing.assert_allclose(
        np.exp(np.clip(series, found.low, found.high)), model(wi, wo), rtol=1e-9 if X64 else 1e-4
    )


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (hshjax.Lambert(0.5), "got Lambert"),
        (SquaredBRDF(bases.HelmholtzBasis(bases.HSH(0)), jnp.ones((1, 1, 1))), "got SquaredBRDF"),
        (linear(bases.HelmholtzBasis(bases.SphericalHarmonics(1))), "over HSH, Zernike or SHR"),
        (linear(bases.AnisotropicHalfVectorBasis(4)), "got AnisotropicHalfVectorBasis"),
        (
            hshjax.LinearBRDF(bases.HelmholtzBasis(bases.HSH(0)), jnp.full((1, 1), jnp.nan)),
            "coefficients of LinearBRDF are not all finite",
        ),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_model_without_a_formula_is_refused(model, message):
    with pytest.raises(ValueError, match=message):
        formula(model)


def integral(values):
    """Over the hemisphere, of values on the points of `grid`."""
    weight, columns = np.polynomial.legendre.leggauss(RINGS)[1] / 2, values.shape[1]
    return (values * weight[:, None]).sum() * 2 * np.pi / columns


def grid():
    z = (np.polynomial.legendre.leggauss(RINGS)[0] + 1) / 2
    phi = (np.arange(RINGS) + 0.5) / RINGS * 2 * np.pi
    rim = np.sqrt(1 - z**2)[:, None]
    return np.stack([rim * np.cos(phi), rim * np.sin(phi), np.broadcast_to(z[:, None], (RINGS, RINGS))], -1)


@pytest.mark.parametrize(("alpha", "cosine"), [(0.2, 0.2), (0.2, 1.0), (0.5, 0.2), (0.5, 0.7), (1.0, 0.2)])
def test_the_lobe_integrates_to_one_and_its_points_follow_it(alpha, cosine):
    wi = np.array([np.sqrt(1 - cosine**2), 0, cosine])
    w = grid()
    density = _lobe(wi, w, alpha)
    assert integral(density) == pytest.approx(1, abs=2e-3)  # the fold has an edge that the rule does not know
    points = _reflected_normals(wi[None, None], alpha)[0]
    for axis in range(3):
        # Means of evenly spread points err by some 1 / POINTS, times the height of what jumps at the fold.
        assert points[:, axis].mean() == pytest.approx(integral(density * w[..., axis]), abs=15 / POINTS)


def test_what_is_sampled_is_fitted_to_the_model():
    diffuse, glossy = fitted_proposal(hshjax.Lambert(0.5)), fitted_proposal(hshjax.GGX(1.0, 0.1))
    assert np.all(diffuse.share == 0)
    assert glossy.alpha == pytest.approx(0.1, rel=0.15)  # the step between candidates is 26 %
    assert np.all(glossy.share == 0.9)
    both = fitted_proposal(hshjax.Lambert(0.5) + hshjax.GGX(0.2, 0.1))
    assert np.all((both.share > 0.1) & (both.share < 0.6))
    assert both.negative == 0
    assert both.smallest > 0.5 / np.pi * 0.99


def test_black_and_negative_models_have_a_proposal():
    basis = bases.HelmholtzBasis(bases.HSH(1))
    black = hshjax.LinearBRDF(basis, jnp.zeros((basis.count, 1), DTYPE))
    assert np.all(fitted_proposal(black).share == 0)
    assert fitted_proposal(black).negative == 0
    negative = eqx.tree_at(lambda m: m.coefficients, black, -jnp.asarray(coefficients(basis, 1)))
    found = fitted_proposal(negative)
    assert found.negative > 0.9
    assert found.smallest < 0
    assert found.share.shape == NODES.shape
