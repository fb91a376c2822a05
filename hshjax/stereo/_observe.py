"""What photometric stereo looks at: grey values relative to the light's irradiance and to the pixel's brightness."""

from collections.abc import Iterator
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, Int
from hshjax.camera import OrthographicCamera, PerspectiveCamera
from hshjax.lighting import DirectionalLight, PointLight
from hshjax.photographs import LUMA, Photographs
from hshjax.stereo._chart import from_chart
from hshjax.stereo._geometry import AbstractGeometry, Far
from hshjax.stereo._highlit import below_highlights
from hshjax.stereo._known import check_channels
from hshjax.stereo._learn import Pixels
from hshjax.stereo._near import Near
from hshjax.stereo._strength import brighter, strengths, unit_directions
from hshjax.stereo._tiles import filled, slices, tile_length
from hshjax.stereo._trust import brightness

TILE = 8192
"""Pixels that are looked at together: memory is that of a tile, whatever the size of the photographs."""

PLANE = 1e-3
"""Least singular value of the directions of lights."""

SOME = 64
"""Pixels that stand for all where it is looked at."""


class Observations:
    """Grey values of photographs under known lights, tile by tile.

    - `directed`: False where directions of lights stand for nothing.
    - `geometry`: from where pixels are lit and seen; None: of photographs as they are, pixels nearby on a plane.
    - `brightness` `(pixels, 1)`. - `seen` `(pixels,)`: whether any value above 0 is known.
    - `mean` `(lights, channels)`: of photographs, over all pixels where they are known.

    **Raises:** ValueError for lights that are unknown, or nearby without a camera that knows where pixels are, fewer
    than three photographs, directions that span no space, and photographs of which nothing is known.
    """

    def __init__(self, photographs: Photographs, *, directed: bool = True, geometry: AbstractGeometry | None = None):
        self.photographs = photographs
        self.geometry = geometry_of(photographs) if geometry is None else geometry
        if directed:
            _check_space(self.geometry, photographs.pixels)
        count = photographs.pixels
        self.brightness = np.empty((count, 1), np.float32)
        self.seen = np.empty(count, bool)
        total = np.zeros((photographs.count, photographs.channels))
        known = np.zeros_like(total)
        for part in self.slices():
            shades = np.asarray(self.filled(grey(self.colour(part))))  # one length: one program
            level = brightness(shades)
            if directed:
                level = below_highlights(shades, level, self.towards(part))
            size = part.stop - part.start
            self.brightness[part] = level[:size]
            self.seen[part] = np.any(shades[:size] > 0, axis=1)
            values = photographs.values[part]
            total += np.nansum(values, axis=0, dtype=float)
            known += np.sum(~np.isnan(values), axis=0)
        if not np.all(known):
            blind = (np.flatnonzero(~np.all(known, axis=1)) + 1).tolist()
            raise ValueError(f"nothing is known of any pixel in photographs {blind}: leave them out")
        self.mean = total / known

    @property
    def lights(self) -> DirectionalLight | PointLight:
        """As they are now."""
        lights = self.photographs.lights
        assert isinstance(lights, DirectionalLight | PointLight)  # else there was no geometry
        return lights

    def brighter(self, factors: Float[np.ndarray, " lights"]) -> "Observations":
        """Of the same photographs, under lights whose irradiance is multiplied."""
        photographs = replace(self.photographs, lights=brighter(self.lights, factors))
        return Observations(photographs, geometry=geometry_of(photographs, self.geometry.positions))

    def moved(self, pq: Float[np.ndarray, "pixels 2"]) -> "Observations":
        """Of the same photographs, pixels on the surface of these normals: the same where all is far away."""
        if self.geometry.positions is None:
            return self
        return self.surfaced(self.geometry.world(np.asarray(from_chart(jnp.asarray(pq))), slice(None)))

    def surfaced(self, normals: Float[np.ndarray, "pixels 3"]) -> "Observations":
        """The same of normals in the world; (0, 0, 0) where there is none."""
        moved = self.geometry.moved(normals)
        return self if moved is self.geometry else Observations(self.photographs, geometry=moved)

    def some(self, count: int, random: np.random.Generator) -> Int[np.ndarray, " n"]:
        """Numbers of `count` pixels at most that are `seen`, to learn from: one of which nothing is known leaves no
        residual, and would count among those that fit best."""
        return np.sort(random.permutation(np.flatnonzero(self.seen))[:count])

    @property
    def steps(self) -> int:
        """Number of tiles."""
        return len(list(self.slices()))

    def slices(self) -> Iterator[slice]:
        """Which pixels the tiles are of."""
        return slices(self.photographs.pixels, TILE)

    def tiles(self) -> Iterator[tuple[slice, Pixels]]:
        """All pixels, tile by tile. The last tile is filled up with pixels of which nothing is known."""
        for part in self.slices():
            pixels = self.pixels(part)
            yield part, Pixels(*(self.filled(array) for array in pixels))

    def filled(self, array: Array | np.ndarray) -> Array:
        """An array `(pixels of a tile, ...)`, filled up with zeros to the length that all tiles have."""
        return filled(array, tile_length(self.photographs.pixels, TILE))

    def pixels(self, part: slice | np.ndarray) -> Pixels:
        """Some pixels."""
        values = grey(self.colour(part)) / self.brightness[part]
        known = np.isfinite(values)
        filled = jnp.asarray(np.where(known, values, 0), jnp.float32)
        stray = jnp.asarray(grey(self.stray(part)) / self.brightness[part], jnp.float32)
        return Pixels(filled, jnp.asarray(known, jnp.float32), stray)

    def colour(self, part: slice | np.ndarray) -> Float[np.ndarray, "n lights channels"]:
        """Radiance of unit irradiance in all channels."""
        return np.asarray(self.photographs.values[part] / self.geometry.irradiance(part), np.float32)

    def stray(self, part: slice | np.ndarray) -> Float[np.ndarray, "... lights channels"]:
        """`mean` as if it were light of the photograph's lamp, at unit irradiance: of all pixels, or of each."""
        return np.asarray(self.mean / self.geometry.irradiance(part), np.float32)

    def towards(self, part: slice) -> Float[Array, "... lights 3"]:
        """Unit vectors to the lights, in frames of the pixels of a tile: `(lights, 3)` for all, or for each."""
        towards = self.geometry.towards(part)
        return towards if towards.ndim == 2 else self.filled(towards)


def grey(values: Float[np.ndarray, "*batch channels"]) -> Float[np.ndarray, "*batch"]:
    """One channel: by `LUMA` of three, else the mean. What is unknown in one channel is unknown."""
    channels = values.shape[-1]
    return values @ np.asarray(LUMA if channels == 3 else [1 / channels] * channels, np.float32)


def geometry_of(photographs: Photographs, positions: Float[np.ndarray, "pixels 3"] | None = None) -> AbstractGeometry:
    """From where pixels are lit and seen. `positions`: of pixels, where that depends on them; None: on a plane."""
    lights, camera = photographs.lights, photographs.camera
    if not isinstance(lights, DirectionalLight | PointLight):
        kind = "none" if lights is None else type(lights).__name__
        raise ValueError(f"photographs need known lights, DirectionalLight or PointLight, got {kind}")
    if photographs.count < 3:
        raise ValueError(f"fewer than three photographs do not determine normals, got {photographs.count}")
    strength = strengths(lights)
    if not np.all(np.isfinite(strength) & (strength > 0)):
        raise ValueError("the irradiance of every light must be above 0: leave out photographs without light")
    check_channels("lights", strength.shape[1], photographs.channels)
    if isinstance(lights, DirectionalLight):
        unit_directions(lights)  # raises, whatever the camera is
        if camera is None or not camera.needs_positions:
            return Far(lights, camera)
    if not isinstance(camera, OrthographicCamera | PerspectiveCamera):
        kind = "none" if camera is None else type(camera).__name__
        raise ValueError(
            "lights nearby need a camera that says where pixels are, an OrthographicCamera with the height of the "
            f"image or a PerspectiveCamera, got {kind}"
        )
    if camera.resolution != photographs.mask.shape:
        raise ValueError(f"the camera must have the resolution of the mask, {photographs.mask.shape}, got {camera}")
    return Near(lights, camera, photographs.mask, positions)


def _check_space(geometry: AbstractGeometry, pixels: int) -> None:
    """ValueError where lights lie in a plane, as seen from each of some pixels."""
    some = geometry.towards(slice(None, None, -(-pixels // SOME)))
    if np.max(np.linalg.svd(np.asarray(some, float), compute_uv=False)[..., -1]) < PLANE:
        raise ValueError("the directions of the lights lie in a plane: normals are not determined")
