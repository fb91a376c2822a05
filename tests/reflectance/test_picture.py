"""Pictures of a material on a shape: against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax import surface
from hshjax.brdfs import GGX, Lambert
from hshjax.camera import OrthographicCamera
from hshjax.lighting import DirectionalLight, EnvironmentMap
from hshjax.metrics import albedo
from hshjax.reflectance import furnace, picture
from hshjax.surface import Surface

UP, RIGHT = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def ball():
    camera = OrthographicCamera(jnp.asarray([0.0, 0.0, 1.0]), jnp.asarray(UP), resolution=(24, 24))
    return surface.sphere(camera), camera


def test_lambert_in_a_furnace_is_its_albedo(ball):
    seen, camera = ball
    found = picture(Lambert([0.5, 0.2]), furnace(), seen, camera)
    inside = np.asarray(seen.mask)
    assert found.deviation is None
    assert np.all(np.isnan(found.radiance[~inside]))
    np.testing.assert_allclose(found.radiance[inside], np.tile([0.5, 0.2], (inside.sum(), 1)), rtol=1e-4)


def test_a_light_from_one_direction(ball):
    seen, camera = ball
    told = []
    light = DirectionalLight(jnp.asarray(RIGHT), jnp.asarray(2.0))
    found = picture(Lambert([0.5]), light, seen, camera, progress=lambda done, total: told.append((done, total)))
    normals = np.asarray(seen.normal)[np.asarray(seen.mask)]
    expected = 0.5 / np.pi * 2 * np.maximum(normals[:, 0], 0)
    np.testing.assert_allclose(found.radiance[np.asarray(seen.mask)][:, 0], expected, rtol=1e-4, atol=1e-6)
    assert told == [(1, 1)]


@pytest.mark.slow
def test_what_is_estimated_is_within_its_deviation(ball):
    seen, camera = ball
    brdf, inside = GGX([1.0], 0.3), np.asarray(seen.mask)
    lights = furnace(), EnvironmentMap(jnp.ones((16, 32, 1)), up="y")
    normals = np.asarray(seen.normal)[inside]
    wo = jnp.asarray(np.stack([np.sqrt(1 - normals[:, 2] ** 2), np.zeros(len(normals)), normals[:, 2]], axis=1))
    exact = np.asarray(albedo(brdf, wo))[:, 0]
    for light in lights:
        found = picture(brdf, light, seen, camera, samples=512, key=jax.random.key(1))
        error = (found.radiance[inside][:, 0] - exact) / found.deviation[inside][:, 0]
        assert np.mean(np.abs(error) < 2) > 0.9  # 95 % of a normal distribution
        assert np.mean(found.deviation[inside]) < 0.05


def test_what_cannot_be_seen(ball):
    seen, camera = ball
    empty = Surface(jnp.zeros((4, 4, 3)), jnp.zeros((4, 4, 3)))
    with pytest.raises(ValueError, match="points in it"):
        picture(Lambert([0.5]), furnace(), empty, camera)
    both = DirectionalLight(jnp.asarray(RIGHT), jnp.asarray(1.0)) + furnace()
    with pytest.raises(ValueError, match="a picture of each"):
        picture(GGX([1.0], 0.3), both, seen, camera)
