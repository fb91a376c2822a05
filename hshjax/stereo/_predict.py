"""Photographs as a result of photometric stereo would have them, under its lights or others."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.camera import AbstractCamera
from hshjax.lighting import AbstractLighting, DirectionalLight, PointLight
from hshjax.reflectance import reflect
from hshjax.stereo._result import Stereo
from hshjax.stereo._strength import Lights, strengths, with_strengths
from hshjax.stereo._tiles import filled, slices, tile_length

TILE = 4096
"""Pixels that are looked at together."""


def predict(
    stereo: Stereo, lights: AbstractLighting | None = None, *, stray: bool = True
) -> Float[np.ndarray, "pixels lights channels"]:
    """Radiance of the pixels under each light by itself: Eq. 1 for their materials and normals. Float32, on the host.

    - `lights`: `DirectionalLight` whose leaves have a leading axis, or `PointLight` where `stereo` has positions; None:
      those of `stereo`.
    - `stray`: whether light that strays is added, `stereo.stray` times the mean of the photograph over all pixels.

    Attached shadows are there, cast ones and light from other parts of the object are not.

    **Raises:** ValueError for lights of another kind, or whose channels do not fit those of the weights.
    """
    lights = stereo.lights if lights is None else lights
    count, _, channels = stereo.weights.shape
    unit, strength = _checked(lights, channels, stereo.positions is not None)
    length = tile_length(count, TILE)
    radiance = np.empty((count, len(strength), channels), np.float32)
    for part in slices(count, length):
        normals, weights = (filled(array[part], length) for array in (stereo.normals, stereo.weights))
        positions = None if stereo.positions is None else filled(stereo.positions[part].astype(np.float32), length)
        tile = _tile(stereo.brdf, unit, stereo.camera, normals, weights, positions)
        radiance[part] = np.asarray(tile)[: part.stop - part.start] * strength
    if stray and stereo.stray:
        # The mean of a photograph holds the light that strays, too.
        radiance += stereo.stray / (1 - stereo.stray) * radiance.mean(axis=0, dtype=float).astype(np.float32)
    return radiance


@eqx.filter_jit
def _tile(
    brdf: AbstractBRDF, lights: Any, camera: AbstractCamera | None, normals: Float[Array, "n 3"],
    weights: Float[Array, "n materials channels"], positions: Float[Array, "n 3"] | None,
) -> Float[Array, "n lights channels"]:  # fmt: skip
    view = jnp.asarray([0, 0, 1], normals.dtype) if camera is None else camera.view(positions).astype(normals.dtype)

    def under(light):
        shading = reflect(brdf, light, normals, view, positions=positions)
        return jnp.einsum("nk,nkc->nc", shading, weights, precision="highest")

    return jnp.moveaxis(jax.lax.map(under, lights), 0, 1)


def _checked(lights: AbstractLighting, channels: int, placed: bool) -> tuple[Lights, np.ndarray]:
    """Lights of unit strength, and their strength `(lights, 1 or channels)`, float32."""
    if isinstance(lights, PointLight) and not placed:
        raise ValueError("lights must be DirectionalLight: a result of lights and camera far away has no positions")
    if not isinstance(lights, DirectionalLight | PointLight) or jax.tree.leaves(lights)[0].ndim != 2:
        raise ValueError(f"lights must be DirectionalLight or PointLight with a leading axis, got {lights}")
    strength = strengths(lights).astype(np.float32)
    if strength.shape[1] not in (1, channels):
        raise ValueError(f"lights must have 1 channel or {channels}, as the weights have, got {strength.shape[1]}")
    return with_strengths(lights, np.ones((len(strength), 1))), strength
