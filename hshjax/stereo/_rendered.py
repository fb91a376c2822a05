"""Shading by Eq. 1 itself, where tables would not do: differentiable in the BRDF and in the lights."""

import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.lighting import DirectionalLight
from hshjax.reflectance import reflect
from hshjax.stereo._chart import from_chart
from hshjax.stereo._shading import AbstractShading


class Rendered(AbstractShading):
    """Shading by `hshjax.reflect`, the channels of an isotropic BRDF being its columns.

    - `directions` `(lights, 3)`: towards the lights, of any length. - `gains` `(lights,)`: their irradiance.
    """

    brdf: AbstractBRDF
    directions: Float[Array, "lights 3"]
    gains: Float[Array, " lights"]

    @property
    def columns(self) -> int:
        pair = jax.ShapeDtypeStruct((1, 3), self.directions.dtype)
        return jax.eval_shape(self.brdf, pair, pair).shape[-1]

    def of(self, towards: Float[Array, "lights 3"]) -> "Rendered":
        """Itself: lights and view are the same for all pixels."""
        return self

    def at(self, pq: Float[Array, "n 2"]) -> Float[Array, "n columns lights"]:
        normals, view = from_chart(pq), jnp.asarray([0, 0, 1], pq.dtype)

        @jax.checkpoint  # light by light, in reverse as well: memory is that of what is returned
        def under(light):
            return reflect(self.brdf, DirectionalLight(*light), normals, view)

        return jnp.moveaxis(jax.lax.map(under, (self.directions, self.gains)), 0, 2)

    def with_slope(
        self, pq: Float[Array, "n 2"]
    ) -> tuple[Float[Array, "n columns lights"], Float[Array, "n 2 columns lights"]]:
        def along(axis):
            tangent = jnp.broadcast_to(jnp.eye(2, dtype=pq.dtype)[axis], pq.shape)
            return jax.jvp(self.at, (pq,), (tangent,))

        (value, along_p), (_, along_q) = along(0), along(1)
        return value, jnp.stack([along_p, along_q], axis=1)
