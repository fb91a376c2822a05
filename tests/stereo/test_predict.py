"""Predictions of photographs: against the BRDF itself, by laws, and what they refuse."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import GGX, Lambert, LinearBRDF
from hshjax.geometry import frame
from hshjax.lighting import DirectionalLight, PointLight
from hshjax.stereo import Stereo, predict
from tests.helpers import directions

MATERIALS = 2


def lamps(directions, irradiance):
    return jax.vmap(DirectionalLight)(jnp.asarray(directions), jnp.asarray(irradiance))


def made(pixels=700, lights=5, channels=3, stray=0.0, seed=0):
    """A result with random normals, weights and lights; a BRDF of a series, Lambert's law and a highlight."""
    rng = np.random.default_rng(seed)
    basis = IsotropicBasis(HSH(1))
    series = LinearBRDF(basis, jnp.asarray(rng.normal(size=(basis.count, MATERIALS)) / 10, jnp.float32))
    brdf = series + Lambert(jnp.asarray([0.5, 0.2])) + GGX(jnp.asarray([0.0, 0.8]), jnp.asarray(0.3))
    nothing = np.zeros((pixels, lights), bool)
    return Stereo(
        normals=np.asarray(directions(seed, pixels, min_z=0.1), np.float32),
        weights=rng.uniform(0, 1, (pixels, MATERIALS, channels)).astype(np.float32), brdf=brdf,
        lights=lamps(directions(seed + 1, lights), rng.uniform(1, 3, (lights, channels))), stray=stray,
        deviation=np.zeros(pixels, np.float32), outliers=nothing, shadows=nothing, mask=np.ones((1, pixels), bool),
        history=(),
    )  # fmt: skip


def test_radiance_is_that_of_the_equation():
    """Pixel by pixel, the BRDF called in the frame of the normal; several tiles, the last one not full."""
    result = made(pixels=4700)
    found = predict(result)
    assert found.shape == (4700, 5, 3)
    assert found.dtype == np.float32
    towards, irradiance = np.asarray(result.lights.direction), np.asarray(result.lights.irradiance)
    shadows = 0
    for pixel in (0, 7, 4095, 4096, 4699):
        axes = np.asarray(frame(jnp.asarray(result.normals[pixel])))
        for light in range(5):
            wi, wo = axes @ towards[light], axes @ np.array([0, 0, 1], towards.dtype)
            expected = np.zeros(3)
            if wi[2] > 0:
                rho = np.asarray(result.brdf(jnp.asarray(wi), jnp.asarray(wo, wi.dtype)))
                expected = rho @ result.weights[pixel] * wi[2] * irradiance[light]
            shadows += wi[2] <= 0
            np.testing.assert_allclose(found[pixel, light], expected, rtol=2e-4, atol=2e-6)
    assert shadows  # otherwise the seed is a poor one


def test_other_lights_of_one_channel():
    result = made(pixels=40)
    grey = lamps(np.asarray(result.lights.direction)[:2], np.full(2, 2.0))
    white = predict(dataclasses.replace(result, lights=lamps(result.lights.direction, np.ones((5, 3)))))
    np.testing.assert_allclose(predict(result, grey), 2 * white[:, :2], rtol=1e-5, atol=1e-7)


def test_stray_light_is_its_share_of_the_whole_photograph():
    clean, hazy = made(), made(stray=0.1)
    photographs, extra = predict(hazy), predict(hazy) - predict(clean)
    np.testing.assert_allclose(extra, np.broadcast_to(0.1 * photographs.mean(axis=0), extra.shape), rtol=1e-3)
    np.testing.assert_array_equal(predict(hazy, stray=False), predict(clean))


@pytest.mark.parametrize(
    ("lights", "message"),
    [
        (jax.vmap(PointLight)(jnp.ones((2, 3)), jnp.ones(2)), "DirectionalLight"),
        (DirectionalLight((0.0, 0.0, 1.0), jnp.ones(())), "leading axis"),
        (lamps(np.ones((2, 3)), np.ones((2, 2))), "1 channel or 3"),
    ],
)
def test_other_lights_are_refused(lights, message):
    with pytest.raises(ValueError, match=message):
        predict(made(pixels=10), lights)
