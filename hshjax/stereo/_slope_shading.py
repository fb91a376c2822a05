"""Radiance of pixels of given slopes by Eq. 1, and how it changes with them."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.lighting import DirectionalLight
from hshjax.reflectance import reflect
from hshjax.stereo._tiles import filled, slices

SMALL, TILE = 512, 4096
"""Pixels that are looked at together: two programs serve all sizes."""


class Shading(NamedTuple):
    """Radiance of unit irradiance `(pixels, lights, channels)` [sr^-1], and its derivatives in the two slopes."""

    value: Float[np.ndarray, "pixels lights channels"]
    along_x: Float[np.ndarray, "pixels lights channels"]
    along_y: Float[np.ndarray, "pixels lights channels"]


def slope_shading(
    brdf: AbstractBRDF, directions: Float[np.ndarray, "lights 3"], slopes: Float[np.ndarray, "pixels 2"]
) -> Shading:
    """Attached shadows are black, and do not change with slopes. In jax's default float; returned in float64."""
    count = len(slopes)
    length = SMALL if count <= SMALL else TILE
    tiles = []
    for part in slices(count, length):
        found = _tile(brdf, jnp.asarray(directions), filled(slopes[part], length))
        tiles.append([np.moveaxis(np.asarray(array, float), 0, 1)[: part.stop - part.start] for array in found])
    return Shading(*(np.concatenate(parts) for parts in zip(*tiles, strict=True)))


def normals_of(slopes: Float[np.ndarray, "pixels 2"]) -> Float[np.ndarray, "pixels 3"]:
    """Unit normals (-∂z/∂x, -∂z/∂y, 1) / length."""
    vectors = np.concatenate([-slopes, np.ones((len(slopes), 1))], axis=1)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@eqx.filter_jit
def _tile(
    brdf: AbstractBRDF, directions: Float[Array, "lights 3"], slopes: Float[Array, "n 2"]
) -> tuple[Float[Array, "lights n channels"], Float[Array, "lights n channels"], Float[Array, "lights n channels"]]:
    view = jnp.asarray([0, 0, 1], slopes.dtype)
    along = [jnp.zeros_like(slopes).at[:, axis].set(1) for axis in (0, 1)]

    def under(direction):
        light = DirectionalLight(direction, jnp.ones((), slopes.dtype))

        def radiance(slopes):
            vectors = jnp.concatenate([-slopes, jnp.ones_like(slopes[:, :1])], axis=1)
            return reflect(brdf, light, vectors, view)

        value, along_x = jax.jvp(radiance, (slopes,), (along[0],))
        return value, along_x, jax.jvp(radiance, (slopes,), (along[1],))[1]

    return jax.lax.map(under, directions)
