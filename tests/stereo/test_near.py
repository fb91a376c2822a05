"""Lights and cameras nearby, whole: known answers, laws, and what is refused."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax.stereo import (
    angular_errors,
    lambertian,
    predict,
    solve_calibrated,
    solve_semi_calibrated,
    solve_uncalibrated,
)  # fmt: skip
from tests.stereo.near import EYE, QUICK, ball, mean_error, places, rotation

CASES = [(4.0, None), (4.0, EYE), (None, EYE)]
NAMES = ["lights", "both", "camera"]


def as_far(photographs):
    """The same photographs, as if lights were far away; directions and irradiance are those at the mean depth."""
    towards = np.asarray(photographs.lights.position) - np.asarray(photographs.camera.centre)
    square = np.sum(towards**2, axis=1)
    lights = jax.vmap(hshjax.DirectionalLight)(
        jnp.asarray(towards), jnp.asarray(np.asarray(photographs.lights.intensity) / square)
    )
    return replace(photographs, lights=lights, camera=None)


SOLVED = [
    pytest.param(case, marks=[] if name == "both" else pytest.mark.slow)
    for case, name in zip(CASES, NAMES, strict=True)
]


@pytest.fixture(scope="module", params=SOLVED, ids=NAMES)
def solved(request):
    photographs = ball(*request.param)
    return request.param, photographs, solve_calibrated(photographs, **QUICK)


def test_normals_and_places_of_a_glossy_ball(solved):
    (_, eye), photographs, found = solved
    errors = angular_errors(found.normals, photographs.truth)
    assert np.median(errors) < 0.3
    assert np.mean(errors) < 1.5
    wrong = np.linalg.norm(found.positions - places(photographs, eye), axis=1)
    assert np.sqrt(np.mean(wrong**2)) < 0.02  # of a radius; a plane: 0.24
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1, rtol=1e-5)


def test_the_model_predicts_the_photographs(solved):
    _, photographs, found = solved
    bright = photographs.values > 0.1 * photographs.values.max()
    residual = (predict(found) - photographs.values)[bright]
    assert np.sqrt(np.mean(residual**2) / np.mean(photographs.values[bright] ** 2)) < 0.08


def test_lights_taken_as_far_away_are_wrong():
    photographs = ball(4.0)
    assert mean_error(solve_calibrated(as_far(photographs), **QUICK), photographs) > 5


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_lambert_by_least_squares(case):
    """Lights within 31 degrees of the view, and no pixel near the rim: nothing is in shadow, normals are exact."""
    photographs = ball(*case, brdf=hshjax.Lambert(0.5))
    found = lambertian(photographs, "least squares")
    inner = np.all(photographs.values > 0, axis=(1, 2))
    assert np.max(angular_errors(found.normals, photographs.truth)[inner]) < 0.3  # places are not quite exact
    np.testing.assert_allclose(found.albedo[inner], 0.5, rtol=2e-2)


def test_far_lights_are_the_limit():
    """Of lights at a growing distance, under a camera that tells places, or knows of none."""
    far = replace(ball(None), camera=None)
    expected = lambertian(far).normals
    apart = [
        np.nanmedian(angular_errors(lambertian(ball(distance)).normals, expected)) for distance in (30.0, 300.0, 3000.0)
    ]
    assert apart[1] < 0.3 * apart[0]
    assert apart[2] < 0.01
    found, expected = (solve_calibrated(photographs, **QUICK) for photographs in (ball(3000.0), far))
    assert np.median(angular_errors(found.normals, expected.normals)) < 0.2  # the tables are not the same
    assert mean_error(found, far) < mean_error(expected, far) + 0.5


@pytest.mark.slow
def test_the_world_may_be_turned():
    """The camera looks along +x, say: the frame of its axis has a pole at -z, and nobody's normals meet it."""
    world = rotation()
    for turn in (world, np.diag([1.0, -1, -1])):  # the second: from below
        one, two = (solve_calibrated(ball(4.0, EYE, world=turned), **QUICK) for turned in (None, turn))
        assert np.median(angular_errors(one.normals @ turn.T, two.normals)) < 0.1  # rounding may choose another basin
        assert np.median(np.abs(two.positions - one.positions @ turn.T)) < 2e-3


def test_a_camera_far_away_may_be_turned():
    """Lights far away, too: the world is that of the lights, not that of the camera."""
    world = rotation(1)
    one, two = (solve_calibrated(ball(None, world=turned), **QUICK) for turned in (None, world))
    assert one.positions is None
    assert np.median(angular_errors(one.normals @ world.T, two.normals)) < 0.1
    assert np.median(np.abs(predict(two) - predict(one))) < 2e-3 * np.max(predict(one))


@pytest.mark.slow
def test_the_unit_of_the_scene_does_not_matter():
    one, two = (solve_calibrated(ball(4.0, EYE, scale=scale), **QUICK) for scale in (1.0, 1000.0))
    assert np.median(angular_errors(one.normals, two.normals)) < 0.1
    assert np.median(np.abs(two.positions / 1000 - one.positions)) < 2e-3


def test_a_wrong_distance_is_felt_and_no_more():
    photographs = ball(4.0)
    aimed = np.asarray(photographs.camera.centre)[2]
    off = mean_error(solve_calibrated(ball(4.0, aim=aimed - 0.2), **QUICK), photographs)
    assert 0.5 < off < 3.5


def test_intensities_are_found():
    strength = np.exp(np.random.default_rng(0).normal(size=12) / 3)
    photographs = ball(4.0, strength=strength)
    found = solve_semi_calibrated(replace(photographs, lights=ball(4.0).lights), **QUICK)
    ratio = np.log(np.asarray(found.lights.intensity) / np.asarray(photographs.lights.intensity))
    assert np.std(ratio) < 0.03
    assert mean_error(found, photographs) < 1.5


def test_single_photographs_that_are_too_bright():
    photographs = ball(4.0)
    factor = np.ones(photographs.count, np.float32)
    factor[3] = 1.3
    found = solve_calibrated(replace(photographs, values=photographs.values * factor[:, None]), gains=0.03, **QUICK)
    ratio = np.asarray(found.lights.intensity / photographs.lights.intensity)
    np.testing.assert_allclose(ratio / np.median(ratio), factor, rtol=0.05)


def test_new_lights_nearby_and_far_away(solved):
    """Under a light far out, and under one in its direction at infinity."""
    _, _, found = solved
    towards, far = jnp.asarray([[0.3, 0.2, 1.0]]), 1e3
    near = jax.vmap(hshjax.PointLight)(far * towards, jnp.full(1, far**2 * jnp.sum(towards**2)))
    distant = jax.vmap(hshjax.DirectionalLight)(towards, jnp.ones(1))
    expected = predict(found, distant)
    np.testing.assert_allclose(predict(found, near), expected, rtol=0.02, atol=0.01 * expected.max())


def test_a_light_behind_the_object_is_no_harm():
    """It reaches a few pixels at the rim, or none."""
    photographs = ball(4.0)
    places_of = np.asarray(photographs.lights.position).copy()
    places_of[5] = [3.0, 0.0, -2.0]
    lights = jax.vmap(hshjax.PointLight)(jnp.asarray(places_of), photographs.lights.intensity)
    values = photographs.values.copy()
    values[:, 5] = 0
    found = solve_calibrated(replace(photographs, lights=lights, values=values), **QUICK)
    assert np.all(np.isfinite(found.positions))
    assert mean_error(found, photographs) < 1.0


def lit_from(photographs, index, place):
    positions = np.asarray(photographs.lights.position).copy()
    positions[index] = place
    return replace(
        photographs, lights=jax.vmap(hshjax.PointLight)(jnp.asarray(positions), photographs.lights.intensity)
    )


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: replace(p, camera=None), "need a camera that says where pixels are"),
        (lambda p: replace(p, camera=ball(4.0, size=8).camera), r"resolution of the mask, \(20, 20\)"),
        (lambda p: lit_from(p, 2, np.asarray(p.camera.centre)), r"lights \[3\] lie within the surface"),
        (lambda p: lit_from(p, 2, [np.nan, 0, 0]), r"lights \[3\] have no finite position"),
        (lambda p: lit_from(p, slice(None), [0.0, 0, 5]), "in a plane"),
        (lambda p: replace(p, lights=jax.tree.map(lambda x: 0 * x, p.lights)), "above 0"),
    ],
    ids=["no camera", "another resolution", "inside", "nowhere", "one place", "dark"],
)
@pytest.mark.parametrize("solve", [solve_calibrated, lambertian])
def test_what_says_nothing_of_places_is_refused(spoil, message, solve):
    with pytest.raises(ValueError, match=message):
        solve(spoil(ball(4.0)))


def test_directions_without_length_under_a_camera_nearby():
    photographs = ball(None, EYE)
    lights = jax.tree.map(lambda leaf: leaf.at[1].set(0.0) if leaf.ndim == 2 else leaf, photographs.lights)
    with pytest.raises(ValueError, match="finite and not zero"):
        solve_calibrated(replace(photographs, lights=lights))


def test_unknown_lights_want_a_camera_far_away():
    with pytest.raises(ValueError, match="camera far away"):
        solve_uncalibrated(ball(4.0, EYE))


def test_a_result_without_places_is_not_lit_from_nearby():
    found = solve_calibrated(replace(ball(None), camera=None), pixels=50, rounds=1, sweeps=0)
    with pytest.raises(ValueError, match="no positions"):
        predict(found, ball(4.0).lights)
