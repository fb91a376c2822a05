"""Photometric stereo under known lights, whole: known answers, invariance, hostile input, real photographs."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax.io import load_model, read_photographs, save_model
from hshjax.stereo import angular_errors, solve_calibrated
from tests.stereo.cases import ball, changed

QUICK = {"pixels": 200, "rounds": 6, "sweeps": 2}


@pytest.fixture(scope="module")
def glossy():
    photographs = ball()
    return photographs, solve_calibrated(photographs, **QUICK)


def test_a_glossy_ball(glossy):
    photographs, found = glossy
    errors = angular_errors(found.normals, photographs.truth)
    assert np.mean(errors) < 1.0  # band and Lambert alone: more than 2
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1, rtol=1e-5)
    assert found.weights.shape == (photographs.pixels, 2, 1)
    assert np.all(found.weights >= 0)
    assert found.stray < 0.01
    assert found.mask is photographs.mask


def test_the_model_predicts_the_photographs(glossy):
    """Through Eq. 1, pixel by pixel, with the BRDF that is returned."""
    photographs, found = glossy
    view = jnp.asarray([0, 0, 1], jnp.float32)
    radiance = jax.vmap(lambda light: hshjax.reflect(found.brdf, light, jnp.asarray(found.normals), view))(found.lights)
    predicted = np.einsum("lnk,nkc->nlc", np.asarray(radiance), found.weights)
    bright = photographs.values > 0.05
    residual = (predicted - photographs.values)[bright]
    assert np.sqrt(np.mean(residual**2) / np.mean(photographs.values[bright] ** 2)) < 0.05


def test_the_model_is_reciprocal_and_can_be_kept(glossy, tmp_path):
    _, found = glossy
    rng = np.random.default_rng(0)
    wi, wo = (hshjax.direction(*jnp.asarray(rng.uniform([[0], [0]], [[1.4], [6.2]], (2, 50)))) for _ in range(2))
    np.testing.assert_allclose(found.brdf(wi, wo), found.brdf(wo, wi), rtol=1e-4, atol=1e-6)
    save_model(tmp_path / "m.hshjax", found.brdf)
    np.testing.assert_array_equal(load_model(tmp_path / "m.hshjax")(wi, wo), found.brdf(wi, wo))


def test_stages_are_told(glossy):
    _, found = glossy
    assert [stage.name for stage in found.history] == ["start", "learn", "normals", "neighbours", "reflectance"]
    assert all(stage.seconds > 0 for stage in found.history)


def test_progress_is_told():
    told = []
    solve_calibrated(ball(), pixels=200, rounds=1, sweeps=1, progress=lambda *step: told.append(step))
    assert told == [(name, 1, 1) for name in ("start", "learn", "normals", "neighbours", "reflectance")]


def test_the_same_seed_gives_the_same():
    a, b = (solve_calibrated(ball(), pixels=200, rounds=2, sweeps=1) for _ in range(2))
    np.testing.assert_array_equal(a.normals, b.normals)
    np.testing.assert_array_equal(a.weights, b.weights)


def test_exposure_does_not_matter():
    """Photographs twice as bright have twice the weights, and lights twice as bright half of them."""
    base = ball()
    settings = {"pixels": 200, "rounds": 2, "sweeps": 1}
    one, two = solve_calibrated(base, **settings), solve_calibrated(changed(base, 2 * base.values), **settings)
    np.testing.assert_allclose(two.normals, one.normals, atol=1e-5)
    np.testing.assert_allclose(two.weights, 2 * one.weights, rtol=1e-4, atol=1e-6)
    bright = eqx.tree_at(lambda p: p.lights.irradiance, base, 2 * base.lights.irradiance)
    np.testing.assert_allclose(solve_calibrated(bright, **settings).weights, one.weights / 2, rtol=1e-4, atol=1e-6)


def test_colours_have_weights_of_their_own():
    brdf = hshjax.Lambert(jnp.asarray([0.6, 0.3, 0.1])) + hshjax.GGX(jnp.full(3, 0.05), 0.4)
    found = solve_calibrated(ball(brdf), pixels=200, rounds=4, sweeps=1)
    body = np.median(found.weights[:, 0], axis=0)
    np.testing.assert_allclose(body / body[0], [1, 0.5, 1 / 6], atol=0.1)


def test_unknown_values_do_not_count():
    photographs = ball()
    values = photographs.values.copy()
    values[::3, 2] = np.nan
    values[7] = np.nan  # a pixel of which nothing is known
    found = solve_calibrated(changed(photographs, values), pixels=200, rounds=3, sweeps=1)
    errors = angular_errors(found.normals, photographs.truth)
    assert np.all(np.isfinite(found.normals))
    assert np.all(np.isfinite(found.weights))
    assert np.median(errors) < 2
    assert np.isinf(found.deviation[7])
    assert np.all(found.weights[7] == 0)
    assert not found.outliers[7].any()
    assert not found.shadows[7].any()


def test_outliers_are_found():
    photographs = ball()
    values = photographs.values.copy()
    rng = np.random.default_rng(2)
    spoiled = rng.uniform(size=values.shape[:2]) < 0.04
    values[spoiled] *= 2.5
    found = solve_calibrated(changed(photographs, values), pixels=200, rounds=4, sweeps=1)
    lit = spoiled & ~found.shadows
    assert np.mean(found.outliers[lit]) > 0.7
    assert np.mean(found.outliers[~spoiled]) < 0.1
    assert np.median(angular_errors(found.normals, photographs.truth)) < 2


def test_stray_light_is_taken_off():
    photographs = ball()
    spoiled = changed(photographs, photographs.values + 0.05 * np.mean(photographs.values, axis=0))
    settings = {"pixels": 200, "rounds": 6, "sweeps": 1}
    found = solve_calibrated(spoiled, **settings)
    assert 0.02 < found.stray < 0.08
    assert solve_calibrated(spoiled, stray=False, **settings).stray == 0


def test_noise_is_predicted():
    """Deviations are those of the errors, for a surface that the model can hold, away from the rim."""
    photographs = ball(hshjax.Lambert(0.6), noise=0.004)
    found = solve_calibrated(photographs, pixels=200, rounds=2, sweeps=0)
    inner = photographs.truth[:, 2] > 0.6
    errors = np.radians(angular_errors(found.normals, photographs.truth))[inner]
    ratio = np.sqrt(np.mean(errors**2) / 2) / np.median(found.deviation[inner])
    assert 0.6 < ratio < 1.7


@pytest.mark.parametrize("materials", [1, 3])
def test_other_numbers_of_materials(materials):
    photographs = ball()
    found = solve_calibrated(photographs, materials=materials, pixels=200, rounds=2, sweeps=0)
    assert found.weights.shape[1] == materials
    assert np.median(angular_errors(found.normals, photographs.truth)) < 4


@pytest.mark.parametrize(
    "columns",
    [(hshjax.IsotropicBasis(hshjax.Zernike(4)),), (hshjax.HalfVectorBasis(12, hshjax.bases.LogWarp(0.05)),)],
    ids=["Zernike", "half-vector"],
)
def test_other_columns(columns):
    photographs = ball()
    found = solve_calibrated(photographs, columns=columns, pixels=200, rounds=2, sweeps=0)
    assert np.median(angular_errors(found.normals, photographs.truth)) < 5


def lit_by(photographs, directions):
    return eqx.tree_at(lambda p: p.lights.direction, photographs, jnp.asarray(directions, jnp.float32))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: eqx.tree_at(lambda q: q.lights, p, None), "known lights, .* got none"),
        (lambda p: lit_by(p, np.tile([[0, 0, 1.0]], (6, 1))), "in a plane"),
        (lambda p: lit_by(p, np.zeros((6, 3))), "finite and not zero"),
        (lambda p: eqx.tree_at(lambda q: q.lights.irradiance, p, jnp.zeros(6)), "irradiance .* above 0"),
        (lambda p: eqx.tree_at(lambda q: q.lights.irradiance, p, jnp.ones((6, 2))), "1 channel or 1, .* got 2"),
        (lambda p: changed(p, np.where(np.arange(6)[:, None] == 2, np.nan, p.values)), r"photographs \[3\]"),
    ],
    ids=["no lights", "one direction", "zero vectors", "no irradiance", "other channels", "a blind photograph"],
)
def test_what_determines_nothing_is_refused(spoil, message):
    with pytest.raises(ValueError, match=message):
        solve_calibrated(spoil(ball(size=12, lights=6)))


def test_two_photographs_are_refused():
    with pytest.raises(ValueError, match=r"fewer than three photographs .* got 2"):
        solve_calibrated(ball(size=12, lights=2))


@pytest.mark.parametrize(
    "argument", [{"materials": 0}, {"materials": 9}, {"pixels": 0}, {"rounds": -1}, {"sweeps": -1}]
)
def test_arguments_out_of_range_are_refused(argument):
    (name,) = argument
    with pytest.raises(ValueError, match=name):
        solve_calibrated(ball(size=12, lights=6), **argument)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "goal"), [("ball", 1.6), ("cat", 4.1), ("reading", 10.0)])
def test_diligent(data, name, goal):
    """Mean angular errors that were asked for, all with the same parameters."""
    photographs = read_photographs(data / "diligent" / f"{name}PNG")
    found = solve_calibrated(photographs)
    assert np.nanmean(angular_errors(found.normals, photographs.truth)) <= goal
