"""Small scenes for photometric stereo with unknown lights."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from hshjax.brdfs import GGX, Lambert
from hshjax.lighting import DirectionalLight
from hshjax.photographs import Photographs
from hshjax.reflectance import reflect
from hshjax.stereo import angular_errors


def lights(count=24, seed=0):
    """Unit directions, spread evenly over z > 0.55, and intensities from 0.5 to 2."""
    z = np.linspace(0.97, 0.55, count)
    phi = 2.399963 * np.arange(count)
    rim = np.sqrt(1 - z**2)
    intensity = np.exp(np.random.default_rng(seed).uniform(-0.7, 0.7, count))
    return np.stack([rim * np.cos(phi), rim * np.sin(phi), z], 1), intensity


@functools.cache
def sphere(size=48, roughness=0.25, radius=0.9):
    """A sphere of two glossy colours, with lights of very unequal intensity, as they truly are."""
    x = (np.arange(size) - (size - 1) / 2) / (size / 2)
    x, y = np.meshgrid(x, -x)
    mask = x**2 + y**2 < radius**2
    normals = np.stack([x, y, np.sqrt(np.maximum(radius**2 - x**2 - y**2, 0))], -1)[mask] / radius
    albedo = np.where(normals[:, :1] * normals[:, 1:2] > 0, [[0.7, 0.5, 0.3]], [[0.3, 0.45, 0.6]])
    directions, intensity = lights()
    colours = intensity[:, None] * np.array([1.0, 0.9, 0.8])
    lamps = jax.vmap(DirectionalLight)(jnp.asarray(directions), jnp.asarray(colours))
    view = jnp.asarray([0.0, 0.0, 1.0])

    def shaded(brdf):
        return np.asarray(jax.vmap(lambda lamp: reflect(brdf, lamp, jnp.asarray(normals), view))(lamps))

    shading = [shaded(brdf) for brdf in (Lambert(jnp.ones(())), GGX(jnp.ones(()), jnp.asarray(roughness)))]
    values = np.moveaxis(shading[0] * albedo[None] + 0.08 * shading[1], 0, 1)
    return Photographs(np.asarray(values, np.float32), mask, lamps, None, normals)


def darkened(photographs):
    """With irradiance that is all wrong, NaN it could not be."""
    wrong = jax.vmap(DirectionalLight)(photographs.lights.direction, jnp.ones(photographs.count))
    return replace(photographs, lights=wrong)


def mean_error(solved, photographs):
    """Of normals [degrees]."""
    return float(np.mean(angular_errors(solved.normals, photographs.truth)))
