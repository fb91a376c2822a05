"""What stands in the way of light, pixel by pixel."""

import abc

import equinox as eqx

from hshjax._fields import floating
from hshjax._typing import Array, Float
from hshjax.brdfs._base import in_dtype
from hshjax.lighting._base import AbstractLighting, Incident, Points


class AbstractShadedLight(AbstractLighting):
    """A light of which each point sees a part."""

    light: eqx.AbstractVar[AbstractLighting]

    @property
    def emitters(self) -> int:
        return self.light.emitters

    @property
    def needs_positions(self) -> bool:
        return self.light.needs_positions

    @abc.abstractmethod
    def visible_from(self, points: Points, incident: Incident) -> Float[Array, "n emitters"]:
        """Share of each emitter that reaches each point; ValueError for points of other pixels than are known."""

    def incident(self, points: Points) -> Incident:
        incident = self.light.incident(points)
        visible = self.visible_from(points, incident)
        return Incident(incident.direction, incident.irradiance * visible[:, :, None])


class MaskedLight(AbstractShadedLight):
    """A light of which each pixel sees a given part.

    `visible` `(*pixels, emitters)`, in [0, 1]: the share of each emitter that reaches each pixel; its leading axes are
    those of the normals that are lit. One emitter for a `DirectionalLight` or `PointLight`, the pixels of an
    `EnvironmentMap` row by row, those of a sum one after another.

    **Raises:** ValueError where the last axis is not that of the light's emitters; in `reflect`, for other pixels.
    """

    light: AbstractLighting
    visible: Float[Array, "*pixels emitters"] = eqx.field(converter=floating)

    def __check_init__(self):
        if self.visible.ndim < 1 or self.visible.shape[-1] != self.light.emitters:
            expected = f"(*pixels, {self.light.emitters})"
            raise ValueError(f"visible must have shape {expected}, one for each emitter, got {self.visible.shape}")

    def visible_from(self, points: Points, incident: Incident) -> Float[Array, "n emitters"]:
        if self.visible.shape[:-1] != points.pixels:
            expected = (*points.pixels, self.emitters)
            raise ValueError(f"visible must have shape {expected} for these normals, got {self.visible.shape}")
        return in_dtype(self, points.frame.dtype).visible.reshape(-1, self.emitters)[points.index]
