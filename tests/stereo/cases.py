"""Small scenes with known answers."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import hshjax
from hshjax.photographs import Photographs


def directions(count=12, tilt=0.6, seed=0):
    """Unit vectors around the view, float32."""
    rng = np.random.default_rng(seed)
    radius, angle = tilt * np.sqrt((np.arange(count) + 0.5) / count), 2.4 * np.arange(count)
    slopes = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1) * rng.uniform(0.9, 1.1, (count, 1))
    vectors = np.concatenate([slopes, np.ones((count, 1))], axis=1)
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def ball(brdf=None, size=20, lights=12, noise=0.0, irradiance=1.0, tilt=0.6) -> Photographs:
    """A sphere that fills the image, its true normals with it; attached shadows only."""
    brdf = hshjax.Lambert(0.6) + hshjax.GGX(0.08, 0.35) if brdf is None else brdf
    camera = hshjax.OrthographicCamera((0.0, 0, 1), (0.0, 1, 0), height=2.05, resolution=(size, size))
    normal = hshjax.sphere(camera).normal
    mask = np.asarray(jnp.any(normal != 0, axis=-1))
    normals, vectors = normal[mask].astype(jnp.float32), jnp.asarray(directions(lights, tilt))
    strength = jnp.broadcast_to(jnp.asarray(irradiance, jnp.float32), (lights,))
    many = jax.vmap(hshjax.DirectionalLight)(vectors, strength)
    view = jnp.asarray([0, 0, 1], jnp.float32)
    values = jax.vmap(lambda light: hshjax.reflect(brdf, light, normals, view))(many)
    values = np.moveaxis(np.asarray(values, np.float32), 0, 1)
    values = values + noise * np.random.default_rng(1).normal(size=values.shape).astype(np.float32)
    return Photographs(values, mask, many, None, np.asarray(normals))


def changed(photographs: Photographs, values: np.ndarray) -> Photographs:
    """The same photographs with other values."""
    return eqx.tree_at(lambda p: p.values, photographs, values)
