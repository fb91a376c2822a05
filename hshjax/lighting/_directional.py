"""Light from one direction: the sun, a lamp that is far away."""

import equinox as eqx
import jax.numpy as jnp

from hshjax._fields import bounded, floating
from hshjax._typing import Array, Float, Real
from hshjax.brdfs._base import in_dtype
from hshjax.brdfs._parameters import check_parameters
from hshjax.geometry import normalized
from hshjax.lighting._base import AbstractLighting, Incident, Points, check_vector


class DirectionalLight(AbstractLighting):
    """Parallel light.

    - `direction` `(3,)`: towards the light, in the world. Its length does not count, so that a fit may move it freely.
    - `irradiance`, a scalar or `(channels,)`: of a surface that faces the light [W m^-2].

    `jax.vmap(DirectionalLight)(directions, irradiances)` holds many, for `jax.vmap` over images under a light each.

    **Raises:** ValueError for other shapes.
    """

    direction: Float[Array, " 3"] = eqx.field(converter=floating)
    irradiance: Real = bounded(0.0, float("inf"))

    def __check_init__(self):
        check_vector(self, "direction")
        check_parameters(self, spectra=("irradiance",))

    @property
    def emitters(self) -> int:
        return 1

    def incident(self, points: Points) -> Incident:
        light = in_dtype(self, points.frame.dtype)
        return Incident(normalized(light.direction)[None, None], jnp.reshape(light.irradiance, (1, 1, -1)))
