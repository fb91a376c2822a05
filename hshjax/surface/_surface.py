"""What a camera sees of a shape."""

import equinox as eqx
import jax.numpy as jnp

from hshjax._fields import floating
from hshjax._typing import Array, Bool, Float


class Surface(eqx.Module):
    """Visible points of a surface, in the world.

    - `normal` `(*pixels, 3)`: unit; the zero vector where a pixel sees no surface.
    - `position` `(*pixels, 3)`: in the unit of the scene; finite, and without meaning where there is no surface.

    **Raises:** ValueError for shapes that differ or do not end in 3.
    """

    normal: Float[Array, "*pixels 3"] = eqx.field(converter=floating)
    position: Float[Array, "*pixels 3"] = eqx.field(converter=floating)

    def __check_init__(self):
        normal, position = self.normal.shape, self.position.shape
        if normal != position or normal[-1:] != (3,):
            raise ValueError(f"normal and position must have one shape (*pixels, 3), got {normal} and {position}")

    @property
    def mask(self) -> Bool[Array, "*pixels"]:
        """Where there is a surface."""
        return jnp.any(self.normal != 0, axis=-1)
