"""Unknown lights: a sphere, which hand it has, each part of the start, and what is refused."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax.brdfs import GGX, Lambert
from hshjax.io import read_photographs
from hshjax.lighting import DirectionalLight
from hshjax.photographs import Photographs
from hshjax.reflectance import reflect
from hshjax.stereo import angular_errors, solve_uncalibrated
from hshjax.stereo._contour import contour, turn
from hshjax.stereo._factor import factored, unit_lengths
from hshjax.stereo._learn import Pixels
from hshjax.stereo._turned import tangents, turn_slopes
from tests.helpers import directions as random_directions
from tests.stereo.unknown import lights, mean_error, sphere

QUICK = {"pixels": 600, "turns": 6, "rounds": 6, "sweeps": 2}


def light_error(solved, scene):
    truth = np.asarray(scene.lights.direction)
    return float(np.mean(angular_errors(np.asarray(solved.lights.direction), truth)))


def test_lights_and_normals_of_a_glossy_sphere():
    scene = sphere()
    solved = solve_uncalibrated(replace(scene, lights=None, truth=None), **QUICK)
    assert light_error(solved, scene) < 4.0
    assert mean_error(solved, scene) < 4.0  # hollow, left-handed or turned, it would be tens of degrees
    names = [stage.name for stage in solved.history]
    assert names == ["factors", "lights", "start", "learn", "normals", "neighbours", "reflectance"]


def test_equal_intensities_are_a_better_start_where_they_are():
    scene = sphere()
    even = replace(scene, values=(scene.values / np.asarray(scene.lights.irradiance)).astype(np.float32), lights=None)
    assert light_error(solve_uncalibrated(even, equal=True, **QUICK), scene) < 2.0


@pytest.mark.slow
def test_lights_that_are_given_are_not_looked_at():
    scene = sphere()
    quick = QUICK | {"turns": 1, "rounds": 1, "sweeps": 0}
    first, second = (solve_uncalibrated(given, **quick) for given in (scene, replace(scene, lights=None)))
    np.testing.assert_array_equal(first.normals, second.normals)
    camera = hshjax.OrthographicCamera((1.0, 0, 0), (0.0, 0, 1), height=2.0, resolution=scene.mask.shape)
    axes = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], np.float32)  # right, up, towards
    turned = solve_uncalibrated(replace(scene, camera=camera), **quick)
    assert turned.camera is camera
    np.testing.assert_allclose(turned.normals, first.normals @ axes, atol=1e-6)
    np.testing.assert_allclose(turned.lights.direction, first.lights.direction @ axes, atol=1e-6)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_turn_is_found_with_its_reflection(sign):
    scene = sphere()
    wrong, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    wrong *= sign
    found = turn(scene.truth @ wrong.T, scene.mask)
    assert np.mean(angular_errors(scene.truth @ (found @ wrong).T, scene.truth)) < 1.5


def test_outward_directions_of_a_disc():
    scene = sphere()
    pixels, outward = contour(scene.mask)
    radial = scene.truth[pixels, :2] / np.linalg.norm(scene.truth[pixels, :2], axis=1, keepdims=True)
    assert np.min(np.sum(outward * radial, axis=1)) > 0.97


def test_factors_of_lamberts_law():
    """Of normals and lights without shadows, up to an orthogonal matrix."""
    truth, _ = lights()
    normals = np.asarray(random_directions(0, 300, min_z=0.9), float)
    values = jnp.asarray(normals @ truth.T, jnp.float32)
    found, forced = factored(Pixels(values, jnp.ones_like(values), values))
    assert not forced
    left, _, right = np.linalg.svd(found.T @ truth)
    errors = angular_errors(found @ left @ right, truth)
    assert np.mean(errors) < 0.1  # it begins with singular vectors, which are exact, and goes on with middle ranks
    assert np.max(errors) < 0.5


def test_unit_lengths_undo_a_map():
    truth, _ = lights()
    twisted = truth @ np.array([[1.3, 0.2, 0], [0, 0.7, 0.1], [0.3, 0, 1.1]])
    matrix, forced = unit_lengths(twisted)
    assert not forced
    np.testing.assert_allclose(np.linalg.norm(twisted @ matrix, axis=1), 1, atol=1e-6)


def test_lengths_that_no_matrix_has_are_met_by_one_that_is_near():
    """Lengths grow so fast with z that the square that fits best is negative along it."""
    truth, _ = lights()
    vectors = truth / np.sqrt(truth**2 @ np.array([20.0, 20.0, -1.0]))[:, None]
    matrix, forced = unit_lengths(vectors)
    assert forced
    values = np.linalg.eigvalsh(matrix) ** 2
    np.testing.assert_allclose(values[0] / values[-1], 0.2, rtol=1e-6)
    assert np.all(np.linalg.norm(vectors @ matrix, axis=1) > 0.9)


def test_lights_four_times_over_are_refused():
    truth, _ = lights(4)
    again = np.repeat(truth, 4, axis=0) + 1e-4 * np.random.default_rng(0).normal(size=(16, 3))
    with pytest.raises(ValueError, match="directions of the lights are not determined"):
        unit_lengths(again)


def test_lights_on_a_cone_are_refused():
    phi = np.linspace(0, 6, 12)
    cone = np.stack([0.5 * np.cos(phi), 0.5 * np.sin(phi), np.full(12, 3**0.5 / 2)], 1)
    with pytest.raises(ValueError, match="cone"):
        unit_lengths(cone)


def test_slopes_of_turns_are_differences():
    towards, _ = lights(4)
    across = tangents(towards)
    np.testing.assert_allclose(np.einsum("jka,ja->jk", across, towards), 0, atol=1e-12)
    normals, weights = random_directions(3, 20, min_z=0.8), jnp.ones((20, 1))
    brdf = Lambert(jnp.ones(())) + GGX(jnp.ones(()), jnp.asarray(0.4))
    weights = weights.astype(normals.dtype)
    found = turn_slopes(brdf, weights, normals, jnp.asarray(towards, normals.dtype), jnp.asarray(across, normals.dtype))
    step, view = 1e-3, jnp.asarray([0, 0, 1], normals.dtype)
    for j in range(4):
        for k in range(2):
            ends = [
                reflect(brdf, DirectionalLight(jnp.asarray(towards[j] + s * across[j, k], normals.dtype),
                        jnp.ones((), normals.dtype)), normals, view)[:, 0] for s in (step, -step)
            ]  # fmt: skip
            np.testing.assert_allclose(found[:, k, j], (ends[0] - ends[1]) / (2 * step), atol=3e-3)


def test_few_photographs_are_refused():
    scene = sphere()
    with pytest.raises(ValueError, match="at least 8 photographs, got 7"):
        solve_uncalibrated(replace(scene, values=scene.values[:, :7], lights=None))


def test_a_mask_without_a_contour_is_refused():
    scene = Photographs(np.ones((100, 9, 1), np.float32), np.ones((10, 10), bool))
    with pytest.raises(ValueError, match="contour of the mask has 0 pixels"):
        solve_uncalibrated(scene)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "limit"), [("ball", 2.5), ("cat", 5.5)])
def test_photographs_of_objects(data, name, limit):
    photographs = read_photographs(data / "diligent" / f"{name}PNG")
    solved = solve_uncalibrated(replace(photographs, lights=None, truth=None))
    assert mean_error(solved, photographs) < limit
    assert light_error(solved, photographs) < 4.0
