"""Photographs as a result of photometric stereo would have them, under its lights or others."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.lighting import AbstractLighting, DirectionalLight
from hshjax.reflectance import reflect
from hshjax.stereo._result import Stereo

TILE, STEP = 4096, 512
"""Pixels that are looked at together; the tile of a small object has a multiple of `STEP`, so that objects of like size
share programs."""


def predict(
    stereo: Stereo, lights: AbstractLighting | None = None, *, stray: bool = True
) -> Float[np.ndarray, "pixels lights channels"]:
    """Radiance of the pixels under each light by itself: Eq. 1 for their materials and normals. Float32, on the host.

    - `lights`: `DirectionalLight` whose leaves have a leading axis; None: those of `stereo`.
    - `stray`: whether light that strays is added, `stereo.stray` times the mean of the photograph over all pixels.

    Attached shadows are there, cast ones and light from other parts of the object are not.

    **Raises:** ValueError for lights of another kind, or whose channels do not fit those of the weights.
    """
    lights = stereo.lights if lights is None else lights
    count, _, channels = stereo.weights.shape
    direction, irradiance = _checked(lights, channels)
    length = min(TILE, -(-count // STEP) * STEP)
    radiance = np.empty((count, len(direction), channels), np.float32)
    for begin in range(0, count, length):
        part = slice(begin, min(begin + length, count))
        normals, weights = (_filled(array[part], length) for array in (stereo.normals, stereo.weights))
        tile = _tile(stereo.brdf, direction, normals, weights)
        radiance[part] = np.asarray(tile)[: part.stop - part.start] * irradiance
    if stray and stereo.stray:
        # The mean of a photograph holds the light that strays, too.
        radiance += stereo.stray / (1 - stereo.stray) * radiance.mean(axis=0, dtype=float).astype(np.float32)
    return radiance


@eqx.filter_jit
def _tile(
    brdf: AbstractBRDF, direction: Float[Array, "lights 3"], normals: Float[Array, "n 3"],
    weights: Float[Array, "n materials channels"],
) -> Float[Array, "n lights channels"]:  # fmt: skip
    view = jnp.asarray([0, 0, 1], normals.dtype)

    def under(towards):
        shading = reflect(brdf, DirectionalLight(towards, jnp.ones((), normals.dtype)), normals, view)
        return jnp.einsum("nk,nkc->nc", shading, weights, precision="highest")

    return jnp.moveaxis(jax.lax.map(under, direction), 0, 1)


def _checked(lights: AbstractLighting, channels: int) -> tuple[Array, np.ndarray]:
    """Directions `(lights, 3)` and irradiance `(lights, 1 or channels)`, float32."""
    if not isinstance(lights, DirectionalLight) or lights.direction.ndim != 2:
        raise ValueError(f"lights must be DirectionalLight with a leading axis, got {lights}")
    direction = np.asarray(lights.direction, np.float32)
    irradiance = np.asarray(lights.irradiance, np.float32).reshape(len(direction), -1)
    if irradiance.shape[1] not in (1, channels):
        raise ValueError(f"lights must have 1 channel or {channels}, as the weights have, got {irradiance.shape[1]}")
    return jnp.asarray(direction), irradiance


def _filled(array: np.ndarray, length: int) -> Array:
    return jnp.asarray(np.pad(array, ((0, length - len(array)), *((0, 0),) * (array.ndim - 1))))
