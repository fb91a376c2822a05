"""Checks of what a solver is told of material and albedo: all say what was expected, and what was got."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Float
from hshjax.brdfs import AbstractBRDF
from hshjax.stereo._chart import grid
from hshjax.stereo._slope_shading import slope_shading

TURNED = 1e-3
"""Of the largest value, by which a BRDF may change when both directions turn about the normal."""


def check_channels(what: str, got: int, channels: int) -> None:
    """**Raises:** ValueError unless there is one channel, or as many as photographs have."""
    if got not in (1, channels):
        raise ValueError(f"{what} must have 1 channel or {channels}, as photographs have, got {got}")


def known_albedo(albedo: Any, pixels: int, channels: int) -> Float[np.ndarray, "pixels channels"]:
    """Factors of a BRDF from `(pixels,)`, `(pixels, 1)` or `(pixels, channels)`; None: 1.

    **Raises:** ValueError for another shape, and values that are negative or not finite.
    """
    if albedo is None:
        return np.ones((pixels, channels))
    given = np.asarray(albedo, float)
    if given.shape not in ((pixels,), (pixels, 1), (pixels, channels)):
        raise ValueError(f"albedo must be ({pixels},) or ({pixels}, {channels}), got {given.shape}")
    if not np.all(np.isfinite(given) & (given >= 0)):
        raise ValueError("albedo must be finite and not negative")
    return np.broadcast_to(given.reshape(pixels, -1), (pixels, channels))


def check_brdf(brdf: AbstractBRDF, directions: Float[np.ndarray, "lights 3"], channels: int) -> None:
    """Looks at a BRDF from +z, under lights from unit `directions`, for normals all around.

    **Raises:** ValueError for one of other channels, not finite, black or not isotropic.
    """
    nodes, inside = grid(17)
    slopes = -nodes[inside, :2] / nodes[inside, 2:]
    values = slope_shading(brdf, directions, slopes).value
    check_channels("the BRDF", values.shape[2], channels)
    if not np.all(np.isfinite(values)):
        raise ValueError("the BRDF is not finite for all normals that face the camera and the light")
    if not values.max() > 0:
        raise ValueError("the BRDF reflects nothing of the light towards the camera")
    # Turned about the normal by one radian.
    cosine, sine = np.cos(1), np.sin(1)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    up = nodes[inside & (nodes[:, 2] > 0.3)]
    wi, wo = up, np.roll(up, 7, axis=0)
    first, second = (np.asarray(brdf(*(jnp.asarray(w @ m) for w in (wi, wo)))) for m in (np.eye(3), turn))
    if np.max(np.abs(first - second)) > TURNED * np.max(np.abs(first)):
        raise ValueError("the BRDF must be isotropic: it changes when both directions turn about the normal")
