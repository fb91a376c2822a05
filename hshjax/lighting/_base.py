"""Light as the reflectance equation asks for it: from where it comes to a point of a surface, and how much."""

import abc

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array, Float, Int


class Points(eqx.Module):
    """Points of a surface that are lit.

    - `frame`: rotation from the world to the local frame of each point, whose rows are tangent, bitangent, normal.
    - `position`: in the world, in the unit of the lights' positions; None where nobody has told.
    - `pixels`, `index`: shape of all that are shaded, and the number of each point among them, for lights that know
      something about every pixel.
    """

    frame: Float[Array, "n 3 3"]
    position: Float[Array, "n 3"] | None
    index: Int[Array, " n"]
    pixels: tuple[int, ...] = eqx.field(static=True)


class Incident(eqx.Module):
    """What arrives at points from some directions: the terms of a sum that stands for the integral over light.

    - `direction`: unit vectors towards the light, in the world.
    - `irradiance`: of a surface that faces that direction [W m^-2]: radiance times solid angle. No cosine.

    An axis `n` of length 1 says that it is the same at all points.
    """

    direction: Float[Array, "#n emitters 3"]
    irradiance: Float[Array, "#n emitters #channels"]


class AbstractLighting(eqx.Module):
    """Light that falls on surfaces: a sum over some directions at each point. `a + b` is both together.

    Every leaf is differentiable. Directions and positions are those of the world, as the normals are.
    """

    @property
    @abc.abstractmethod
    def emitters(self) -> int:
        """Number of directions from which it comes."""

    @property
    def needs_positions(self) -> bool:
        """Whether it depends on where a point is, not only on how it is turned."""
        return False

    def __check_init__(self):
        """ValueError for fields that do not describe one light."""

    @abc.abstractmethod
    def incident(self, points: Points) -> Incident:
        """The light at points, in the dtype of their frames."""

    def __add__(self, other: "AbstractLighting") -> "SumLighting":
        if not isinstance(other, AbstractLighting):
            return NotImplemented
        return SumLighting(self, other)


class SumLighting(AbstractLighting):
    """a + b; channels broadcast (one channel against many)."""

    a: AbstractLighting
    b: AbstractLighting

    def __check_init__(self):
        for part in (self.a, self.b):
            if not isinstance(part, AbstractLighting):
                raise ValueError(f"a sum of lights needs lights, got {part!r}")

    @property
    def emitters(self) -> int:
        return self.a.emitters + self.b.emitters

    @property
    def needs_positions(self) -> bool:
        return self.a.needs_positions or self.b.needs_positions

    def incident(self, points: Points) -> Incident:
        parts = [part.incident(points) for part in (self.a, self.b)]
        n = max(array.shape[0] for part in parts for array in (part.direction, part.irradiance))
        channels = max(part.irradiance.shape[2] for part in parts)
        direction = [jnp.broadcast_to(part.direction, (n, *part.direction.shape[1:])) for part in parts]
        irradiance = [jnp.broadcast_to(part.irradiance, (n, part.irradiance.shape[1], channels)) for part in parts]
        return Incident(jnp.concatenate(direction, axis=1), jnp.concatenate(irradiance, axis=1))


def check_vector(light: AbstractLighting, field: str) -> None:
    """ValueError unless a field has the shape (3,)."""
    shape = getattr(light, field).shape
    if shape != (3,):
        hint = "; many lights in one, as `jax.vmap` makes them, are taken apart by `jax.vmap`" if len(shape) > 1 else ""
        raise ValueError(f"{type(light).__name__} needs {field} of shape (3,), got {shape}{hint}")
