"""Unknown intensities: a sphere whose lights are known, wrong brightness, and what is refused."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.io import read_photographs
from hshjax.lighting import DirectionalLight
from hshjax.stereo import solve_calibrated, solve_semi_calibrated
from hshjax.stereo._intensity import diffuse_maxima, light_colours, single_gains
from tests.stereo.unknown import darkened, lights, mean_error, sphere

QUICK = {"pixels": 600, "rounds": 6, "sweeps": 2}


def test_intensities_and_normals_of_a_glossy_sphere():
    scene = sphere()
    solved = solve_semi_calibrated(darkened(scene), **QUICK)
    ratio = np.log(np.asarray(solved.lights.irradiance) / np.asarray(scene.lights.irradiance))
    assert np.max(np.std(ratio, axis=0)) < 0.02  # of intensities from 0.5 to 2
    assert mean_error(solved, scene) < 1.0
    assert mean_error(solve_calibrated(darkened(scene), **QUICK), scene) > 3.0  # what wrong intensities do


def test_irradiance_is_not_looked_at():
    scene = sphere()
    first, second = (solve_semi_calibrated(given, **QUICK) for given in (darkened(scene), scene))
    np.testing.assert_array_equal(first.normals, second.normals)


def test_channels_have_mean_one():
    solved = solve_semi_calibrated(sphere(), **QUICK)
    level = np.mean(np.log(np.asarray(solved.lights.irradiance)), axis=0)
    np.testing.assert_allclose(level, level[0], atol=1e-5)


def test_single_photographs_that_are_too_bright():
    scene = sphere()
    factor = np.ones(scene.count)
    factor[[1, 4, 8, 13, 17, 20, 22]] = 1.3  # two would pass for outliers
    spoilt = replace(scene, values=scene.values * factor[:, None].astype(np.float32))
    trusting, doubting = (solve_calibrated(spoilt, gains=gains, **QUICK) for gains in (0.0, 0.03))
    found = np.asarray(doubting.lights.irradiance / scene.lights.irradiance)[:, 0]
    np.testing.assert_allclose(found / np.median(found), factor, rtol=0.03)
    assert mean_error(doubting, scene) < 0.7 * mean_error(trusting, scene)


def test_diffuse_maxima_of_a_flat_matrix():
    albedo, intensity = np.array([[1.0], [0.2], [3.0]]), np.array([0.5, 1, 2])
    np.testing.assert_allclose(diffuse_maxima(albedo * intensity), intensity, rtol=1e-12)


def test_single_gains_leave_what_is_linear_in_the_direction():
    directions, _ = lights()
    gains = 0.1 + directions @ [0.2, -0.3, 0.1]
    gains[5] += 0.25
    found = single_gains(gains, directions)
    assert found[5] == pytest.approx(0.25, abs=0.02)
    assert np.count_nonzero(found) == 1


def test_colours_of_lights_whatever_the_surface():
    rng = np.random.default_rng(0)
    surface, grey = rng.uniform(0.2, 1, (50, 1, 3)), rng.uniform(0.1, 1, (50, 7, 1))
    colour = rng.uniform(0.8, 1.25, (7, 3))
    found = np.log(light_colours(surface * grey * colour))
    # up to a brightness a light, which grey values take
    between = np.log(colour) - np.log(colour).mean(0)
    assert np.max(np.abs((found - between) - (found - between).mean(1, keepdims=True))) < 0.06


def test_a_black_photograph_is_refused():
    scene = sphere()
    values = scene.values.copy()
    values[:, 4] = 0
    with pytest.raises(ValueError, match=r"photographs \[5\] are black"):
        solve_semi_calibrated(replace(scene, values=values))


def test_lights_without_directions_are_refused():
    with pytest.raises(ValueError, match="known directions"):
        solve_semi_calibrated(replace(sphere(), lights=None))


def test_gains_that_cannot_be():
    with pytest.raises(ValueError, match="above 0"):
        solve_semi_calibrated(sphere(), gains=0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "limit"), [("ball", 1.65), ("cat", 4.32)])
def test_photographs_of_objects(data, name, limit):
    photographs = read_photographs(data / "diligent" / f"{name}PNG")
    ones = jax.vmap(DirectionalLight)(photographs.lights.direction, jnp.ones(photographs.count))
    solved = solve_semi_calibrated(replace(photographs, lights=ones))
    assert mean_error(solved, photographs) < limit
