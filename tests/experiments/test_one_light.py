"""Single photographs for shape from shading: fewer pixels, a sphere's normals, lights and albedos that fit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.recipes._one_light import (
    angles_of,
    as_sphere,
    best_lambert,
    fitted_to_normals,
    learned,
    lights_at,
    only,
    thinned,
    with_fitted_lights,
)
from experiments.recipes._stereo_materials import material
from experiments.recipes._stereo_scenes import scenes
from experiments.recipes.shape_from_shading import outline_alone
from hshjax.io import read_photographs
from hshjax.lighting import DirectionalLight
from hshjax.photographs import Photographs
from hshjax.reflectance import reflect
from hshjax.stereo import angular_errors, solve_single_image
from tests.helpers import DTYPE


@pytest.fixture(scope="module")
def matte():
    (scene,) = scenes(["sphere/lambert"], size=30, lights=lights_at((10.0, 35.0), 40.0)).values()
    return scene


def test_angles_and_one_of_the_photographs(matte):
    np.testing.assert_allclose(angles_of(matte), [10, 35], atol=1e-3)
    second = only(matte, [1])
    np.testing.assert_array_equal(second.values[:, 0], matte.values[:, 1])
    np.testing.assert_allclose(angles_of(second), [35], atol=1e-3)


def test_fewer_pixels_keep_their_normals_and_values(matte):
    few = thinned(matte, 3)
    assert few.mask.shape == (10, 10)
    image, small = matte.image(matte.values[:, 0]), few.image(few.values[:, 0])
    np.testing.assert_array_equal(small, image[1::3, 1::3] * few.mask[..., None])
    assert few.truth.shape == (few.pixels, 3)


def test_the_normals_of_a_sphere_from_its_outline(matte):
    found = as_sphere(Photographs(matte.values, matte.mask, matte.lights)).truth
    inner = matte.truth[:, 2] > 0.3
    assert angular_errors(found, matte.truth)[inner].max() < 2.0


def test_lambert_and_lights_that_fit(matte):
    np.testing.assert_allclose(best_lambert(only(matte, [0])).albedo, [0.6, 0.5, 0.4], rtol=1e-4)
    wrong = jnp.asarray([[0.3, 0.0, 1.0], [0.0, 0.0, 1.0]], DTYPE)
    moved = Photographs(
        matte.values, matte.mask, jax.vmap(DirectionalLight)(wrong, jnp.ones(2, DTYPE)), None, matte.truth
    )
    found = with_fitted_lights(moved).lights.direction
    true = np.asarray(matte.lights.direction)
    assert angular_errors(np.asarray(found), true / np.linalg.norm(true, axis=1, keepdims=True)).max() < 0.1


def test_a_material_from_known_normals():
    """In the span of its columns, so that it predicts the photograph that was left out."""
    glossy = material("glossy:0.2").layers[0].brdf
    lights = lights_at((5.0, 15.0, 25.0, 35.0, 45.0), 40.0)
    (scene,) = scenes(["sphere/glossy:0.2"], size=24, lights=lights).values()
    brdf, stray = fitted_to_normals(scene, 2)
    lamp = jax.tree.map(lambda leaf: leaf[2], scene.lights)
    truth, view = jnp.asarray(scene.truth), jnp.asarray([0.0, 0.0, 1.0], DTYPE)
    found, true = (np.asarray(reflect(model, lamp, truth, view)) for model in (brdf, glossy))
    assert np.sqrt(np.mean((found - true) ** 2) / np.mean(true**2)) < 0.02
    assert np.max(np.abs(stray)) < 0.01


def test_the_outline_of_a_ball_alone(matte):
    assert angular_errors(outline_alone(matte.mask), matte.truth).mean() < 5.0


@pytest.mark.slow
def test_the_ball_of_diligent(data):
    """The BRDF that other photographs tell, without true normals, does better than Lambert's law at its best."""
    ball = thinned(read_photographs(data / "diligent/ballPNG"), 3)
    number = int(np.argmin(np.abs(angles_of(ball) - 40)))
    brdf, stray = learned(ball, number)
    photograph = only(ball, [number])
    values = (photograph.values - stray).astype(photograph.values.dtype)
    photograph = Photographs(values, photograph.mask, photograph.lights, None, photograph.truth)
    errors = [
        angular_errors(solve_single_image(photograph, given, starts=("smooth", "convex")).normals, ball.truth).mean()
        for given in (brdf, best_lambert(photograph))
    ]
    assert errors[0] < 2.0
    assert errors[1] > 1.7 * errors[0]
