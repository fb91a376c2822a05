"""Lights of photographs: directions, and strength: irradiance of those far away, radiant intensity of those nearby."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Float
from hshjax.lighting import DirectionalLight, PointLight

Lights = DirectionalLight | PointLight
"""Many, whose leaves have a leading axis."""


def unit_directions(lights: DirectionalLight) -> Float[np.ndarray, "lights 3"]:
    """Towards the lights, in the world.

    **Raises:** ValueError for directions that are zero or not finite.
    """
    directions = np.asarray(lights.direction, float)
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    if not np.all(np.isfinite(length) & (length > 0)):
        raise ValueError("directions of lights must be finite and not zero")
    return directions / length


def strengths(lights: Lights) -> Float[np.ndarray, "lights channels"]:
    """Irradiance or intensity, of one channel or all."""
    given = np.asarray(getattr(lights, _name(lights)))
    return given.reshape(len(given), -1)


def with_strengths(lights: Lights, values: Float[np.ndarray, "lights channels"]) -> Lights:
    """The same lights, of another irradiance or intensity, in its dtype."""
    name = _name(lights)
    given = getattr(lights, name)
    shape = given.shape if given.size == values.size else values.shape
    return eqx.tree_at(lambda kind: getattr(kind, name), lights, jnp.asarray(values, given.dtype).reshape(shape))


def brighter(lights: Lights, factors: Float[np.ndarray, " lights"]) -> Lights:
    """The same lights, each so many times as strong."""
    return with_strengths(lights, strengths(lights) * factors[:, None])


def _name(lights: Lights) -> str:
    return "irradiance" if isinstance(lights, DirectionalLight) else "intensity"
