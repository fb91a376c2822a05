"""How bright lights are: the irradiance of those far away, the radiant intensity of those nearby."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Float
from hshjax.lighting import DirectionalLight, PointLight

Lights = DirectionalLight | PointLight
"""Many, whose leaves have a leading axis."""


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


def _name(lights: Lights) -> str:
    return "irradiance" if isinstance(lights, DirectionalLight) else "intensity"
