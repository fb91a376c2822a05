"""From where pixels are lit and seen: the same for all where lights and camera are far away, else for each its own.

Every pixel has a frame whose +z is the direction to the camera; its normal is a point of the chart in that frame.
"""

import abc
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, Int
from hshjax.brdfs import AbstractBRDF
from hshjax.camera import AbstractCamera
from hshjax.lighting import DirectionalLight
from hshjax.stereo._axes import camera_axes
from hshjax.stereo._shading import AbstractShadingTables, shading_table
from hshjax.stereo._strength import strengths, unit_directions

Part = slice | np.ndarray
"""Which pixels: some in a row, or by number."""


class AbstractGeometry(abc.ABC):
    """Directions and strength of light at pixels.

    - `starts`: how often positions are found anew from normals by Lambert's law. - `again`: how often materials are
      learned again, positions found anew before.
    """

    starts: int
    again: int

    @property
    @abc.abstractmethod
    def positions(self) -> Float[np.ndarray, "pixels 3"] | None:
        """In the world; None where lights and camera are far away."""

    @abc.abstractmethod
    def towards(self, part: Part) -> Float[Array, "... lights 3"]:
        """Unit vectors to the lights in frames of pixels, float32: `(lights, 3)` for all, or `(n, lights, 3)`."""

    @abc.abstractmethod
    def irradiance(self, part: Part) -> Float[np.ndarray, "... lights channels"]:
        """Of a surface that faces the lights, of one channel or all, float32: `(lights, ·)` or `(n, lights, ·)`."""

    @abc.abstractmethod
    def tables(self, brdfs: Sequence[AbstractBRDF]) -> AbstractShadingTables:
        """Shading by these lights."""

    @abc.abstractmethod
    def world(self, local: Float[np.ndarray, "n 3"], part: Part) -> Float[np.ndarray, "n 3"]:
        """Vectors in frames of pixels, taken to the world."""

    @abc.abstractmethod
    def local(self, world: Float[np.ndarray, "n 3"], part: Part) -> Float[np.ndarray, "n 3"]:
        """Vectors in the world, taken to frames of pixels."""

    @abc.abstractmethod
    def carried(
        self, pq: Float[np.ndarray, "pixels 2"], number: Int[np.ndarray, "n k"], part: Part
    ) -> Float[np.ndarray, "n k 2"]:
        """Normals of other pixels, by their numbers, in the charts of these."""

    @abc.abstractmethod
    def moved(self, normals: Float[np.ndarray, "pixels 3"]) -> "AbstractGeometry":
        """With pixels on the surface of these normals, which are those of the world."""


class Far(AbstractGeometry):
    """Lights and camera far away.

    **Raises:** ValueError for directions that are zero or not finite.
    """

    starts, again = 0, 0

    def __init__(self, lights: DirectionalLight, camera: AbstractCamera | None):
        self._axes = camera_axes(camera)
        self._directions = jnp.asarray(unit_directions(lights) @ self._axes.T, jnp.float32)
        self._irradiance = strengths(lights).astype(np.float32)

    @property
    def positions(self):
        return None

    def towards(self, part):
        return self._directions

    def irradiance(self, part):
        return self._irradiance

    def tables(self, brdfs):
        return shading_table(brdfs, self._directions)

    def world(self, local, part):
        return local @ self._axes.astype(local.dtype)

    def local(self, world, part):
        return world @ self._axes.T.astype(world.dtype)

    def carried(self, pq, number, part):
        return pq[number]

    def moved(self, normals):
        return self
