"""Light from a point nearby: a bulb, a light-emitting diode of a capture dome."""

import equinox as eqx
import jax.numpy as jnp

from hshjax._fields import bounded, floating
from hshjax._typing import Array, Float, Real
from hshjax.brdfs._base import in_dtype
from hshjax.brdfs._parameters import check_parameters
from hshjax.geometry import dot, normalized
from hshjax.lighting._base import AbstractLighting, Incident, Points, check_vector


class PointLight(AbstractLighting):
    """Light from a point, the same in all directions: its irradiance falls with the square of the distance.

    - `position` `(3,)`: in the world, in the unit of the points' positions.
    A point where the light itself is, is not lit by it: from there it has no direction.

    - `intensity`, a scalar or `(channels,)`: radiant intensity [W sr^-1], if that unit is the metre.

    **Raises:** ValueError for other shapes; where points have no positions.
    """

    position: Float[Array, " 3"] = eqx.field(converter=floating)
    intensity: Real = bounded(0.0, float("inf"))

    def __check_init__(self):
        check_vector(self, "position")
        check_parameters(self, spectra=("intensity",))

    @property
    def emitters(self) -> int:
        return 1

    @property
    def needs_positions(self) -> bool:
        return True

    def incident(self, points: Points) -> Incident:
        if points.position is None:
            raise ValueError("a PointLight needs the positions of the points that it lights")
        light = in_dtype(self, points.frame.dtype)
        away = light.position[None] - points.position
        square = dot(away, away)[:, None, None]
        apart = square != 0
        irradiance = jnp.reshape(light.intensity, (1, 1, -1)) / jnp.where(apart, square, 1)
        return Incident(normalized(away)[:, None], jnp.where(apart, irradiance, 0))
