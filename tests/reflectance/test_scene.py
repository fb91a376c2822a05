"""Scenes: images of surfaces under lights, one after another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.brdfs import GGX
from hshjax.camera import OrthographicCamera, PerspectiveCamera
from hshjax.lighting import DirectionalLight, HarmonicLight, Horizon, PointLight, ShadowedLight
from hshjax.reflectance import Scene, reflect, render
from hshjax.surface import height_field, sphere
from tests.helpers import DTYPE, assert_close, directions

UP, AXIS = jnp.asarray([0, 1.0, 0], DTYPE), jnp.asarray([0, 0, 1.0], DTYPE)
FAR = OrthographicCamera(AXIS, UP, resolution=(5, 4))
NEAR = PerspectiveCamera(4 * AXIS, 0 * AXIS, UP, field_of_view=jnp.asarray(0.6, DTYPE), resolution=(5, 4))
LAMPS = tuple(PointLight(jnp.asarray([x, 1, 3.0], DTYPE), jnp.asarray([9.0], DTYPE)) for x in (-1.0, 0.0, 1.0))
BRDF = GGX(jnp.ones(1, DTYPE), jnp.asarray(0.4, DTYPE))


@pytest.mark.parametrize("camera", [FAR, NEAR], ids=["far", "near"])
def test_an_image_a_light(camera):
    surface = sphere(camera)
    images = render(Scene(BRDF, LAMPS, surface, camera))
    assert images.shape == (3, 5, 4, 1)
    view = camera.view(surface.position)
    for image, light in zip(images, LAMPS, strict=True):
        assert_close(image, reflect(BRDF, light, surface.normal, view, positions=surface.position))
    assert_close(images[:, ~surface.mask], 0 * images[:, ~surface.mask])


def test_lights_of_several_kinds_and_channels():
    lights = [DirectionalLight(AXIS, jnp.ones(3, DTYPE)), LAMPS[0], HarmonicLight(jnp.ones((4, 1), DTYPE), degree=8)]
    images = render(Scene(BRDF, lights, sphere(FAR), FAR))
    assert images.shape == (3, 5, 4, 3)
    assert_close(images[1:2], render(Scene(BRDF, LAMPS[:1], sphere(FAR), AXIS)) * jnp.ones((1, 1, 1, 3), DTYPE))


def test_a_scene_is_differentiable():
    def total(height):
        camera = PerspectiveCamera(4 * AXIS, 0 * AXIS, UP, field_of_view=height, resolution=(5, 4))
        return jnp.sum(render(Scene(BRDF, LAMPS, sphere(camera), camera)))

    gradient = jax.jit(jax.grad(total))(jnp.asarray(0.6, DTYPE))
    assert jnp.isfinite(gradient)
    assert gradient != 0


def test_one_light_is_one_image():
    assert_close(render(Scene(BRDF, LAMPS[0], sphere(FAR), FAR)), render(Scene(BRDF, LAMPS[:1], sphere(FAR), FAR)))


def test_what_lights_share_is_held_once():
    """Memory of the program does not grow with lights behind one horizon; images are those of each by itself."""
    field = height_field(jnp.asarray(np.random.default_rng(0).normal(size=(24, 24)), DTYPE))
    horizon = Horizon.from_heights(field.position[..., 2], azimuths=64)
    lamps = [DirectionalLight(direction, 1.0) for direction in directions(3, 8)]

    def images(lamps, horizon):
        return render(Scene(BRDF, [ShadowedLight(lamp, horizon) for lamp in lamps], field, AXIS))

    def memory(lamps):
        return jax.jit(images).lower(lamps, horizon).compile().memory_analysis().temp_size_in_bytes

    assert memory(lamps) - memory(lamps[:1]) < horizon.slope.nbytes
    assert_close(images(lamps, horizon)[:2], jnp.concatenate([images(lamps[:1], horizon), images(lamps[1:2], horizon)]))
    assert_close(render(Scene(BRDF, [lamps[0]] * 2, field, AXIS))[1], render(Scene(BRDF, lamps[0], field, AXIS))[0])


@pytest.mark.parametrize("lights", [(), (AXIS,)], ids=["none", "a vector"])
def test_refusals(lights, unchecked):
    with pytest.raises(ValueError, match="light"):
        Scene(BRDF, lights, sphere(FAR), FAR)


def test_other_things_that_are_refused(unchecked):
    with pytest.raises(ValueError, match="pairs of directions, got a Surface"):
        Scene(sphere(FAR), LAMPS, sphere(FAR), FAR)
    with pytest.raises(ValueError, match="needs a Surface, got a GGX"):
        Scene(BRDF, LAMPS, BRDF, FAR)
    with pytest.raises(ValueError, match="an image becomes one by EnvironmentMap"):
        Scene(BRDF, [np.ones((4, 8, 3))], sphere(FAR), FAR)
    with pytest.raises(ValueError, match="comes of an EnvironmentMap"):
        HarmonicLight.from_environment(np.ones((4, 8, 3)), 1)


def test_a_camera_nearby_needs_positions(unchecked):
    with pytest.raises(ValueError, match="give their positions"):
        reflect(BRDF, DirectionalLight(AXIS, 1.0), sphere(FAR).normal, NEAR)
