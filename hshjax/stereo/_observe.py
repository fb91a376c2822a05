"""What photometric stereo looks at: grey values relative to the light's irradiance and to the pixel's brightness."""

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, Int
from hshjax.lighting import DirectionalLight
from hshjax.photographs import LUMA, Photographs
from hshjax.stereo._highlit import below_highlights
from hshjax.stereo._learn import Pixels
from hshjax.stereo._trust import brightness

TILE = 8192
"""Pixels that are looked at together: memory is that of a tile, whatever the size of the photographs."""

STEP = 512
"""Lengths of the tile of a small object are multiples of this: objects of like size share programs."""

PLANE = 1e-3
"""Least singular value of the directions of lights."""


class Observations:
    """Grey values of photographs under known lights far away, tile by tile.

    - `directed`: False where directions of lights stand for nothing.
    - `lights`; their `directions` `(lights, 3)`: unit, float32. - `brightness` `(pixels, 1)`.
    - `seen` `(pixels,)`: whether any value above 0 is known.
    - `mean` `(lights, channels)`: radiance of unit irradiance, of all pixels where it is known.

    **Raises:** ValueError for lights that are unknown or near, a camera nearby, fewer than three photographs,
    directions that span no space, and photographs of which nothing is known.
    """

    def __init__(self, photographs: Photographs, *, directed: bool = True):
        self.photographs = photographs
        self.lights, directions, self._irradiance = _lights(photographs, directed)
        self.directions = jnp.asarray(directions, jnp.float32)
        count = photographs.pixels
        self.brightness = np.empty((count, 1), np.float32)
        self.seen = np.empty(count, bool)
        total = np.zeros((photographs.count, photographs.channels))
        known = np.zeros_like(total)
        for part in self.slices():
            values = self.colour(part)
            shades = grey(values)
            level = brightness(shades)
            self.brightness[part] = below_highlights(shades, level, self.directions) if directed else level
            self.seen[part] = np.any(shades > 0, axis=1)
            total += np.nansum(values, axis=0, dtype=float)
            known += np.sum(~np.isnan(values), axis=0)
        if not np.all(known):
            blind = (np.flatnonzero(~np.all(known, axis=1)) + 1).tolist()
            raise ValueError(f"nothing is known of any pixel in photographs {blind}: leave them out")
        self.mean = (total / known).astype(np.float32)

    def brighter(self, factors: Float[np.ndarray, " lights"]) -> "Observations":
        """Of the same photographs, under lights whose irradiance is multiplied."""
        given = jnp.asarray(factors, self.lights.irradiance.dtype)
        scaled = jax.vmap(lambda light, factor: replace(light, irradiance=light.irradiance * factor))
        return Observations(replace(self.photographs, lights=scaled(self.lights, given)))

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
        for begin in range(0, self.photographs.pixels, TILE):
            yield slice(begin, min(begin + TILE, self.photographs.pixels))

    def tiles(self) -> Iterator[tuple[slice, Pixels]]:
        """All pixels, tile by tile. The last tile is filled up with pixels of which nothing is known."""
        for part in self.slices():
            pixels = self.pixels(part)
            yield part, Pixels(*(self.filled(array) for array in pixels))

    def filled(self, array: Array | np.ndarray) -> Array:
        """An array `(pixels of a tile, ...)`, filled up with zeros to the length that all tiles have."""
        length = min(TILE, -(-self.photographs.pixels // STEP) * STEP)
        return jnp.pad(jnp.asarray(array), ((0, length - len(array)), *((0, 0),) * (array.ndim - 1)))

    def pixels(self, part: slice | np.ndarray) -> Pixels:
        """Some pixels."""
        values = grey(self.colour(part)) / self.brightness[part]
        known = np.isfinite(values)
        filled = jnp.asarray(np.where(known, values, 0), jnp.float32)
        stray = jnp.asarray(grey(self.mean) / self.brightness[part], jnp.float32)
        return Pixels(filled, jnp.asarray(known, jnp.float32), stray)

    def colour(self, part: slice | np.ndarray) -> Float[np.ndarray, "n lights channels"]:
        """Radiance of unit irradiance in all channels."""
        return np.asarray(self.photographs.values[part] / self._irradiance, np.float32)


def grey(values: Float[np.ndarray, "*batch channels"]) -> Float[np.ndarray, "*batch"]:
    """One channel: by `LUMA` of three, else the mean. What is unknown in one channel is unknown."""
    channels = values.shape[-1]
    return values @ np.asarray(LUMA if channels == 3 else [1 / channels] * channels, np.float32)


def _lights(photographs: Photographs, directed: bool) -> tuple[DirectionalLight, np.ndarray, np.ndarray]:
    """The lights, unit directions `(lights, 3)` and irradiance `(lights, 1 or channels)`, float32."""
    lights = photographs.lights
    if not isinstance(lights, DirectionalLight):
        kind = "none" if lights is None else type(lights).__name__
        raise ValueError(f"photographs need known lights far away (DirectionalLight), got {kind}")
    if photographs.camera is not None and photographs.camera.needs_positions:
        raise ValueError("the camera must be far away, got one that sees points from different directions")
    if photographs.count < 3:
        raise ValueError(f"fewer than three photographs do not determine normals, got {photographs.count}")
    directions = np.asarray(lights.direction, float)
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    if not np.all(np.isfinite(length) & (length > 0)):
        raise ValueError("directions of lights must be finite and not zero")
    directions = directions / length
    if directed and np.linalg.svd(directions, compute_uv=False)[-1] < PLANE:
        raise ValueError("the directions of the lights lie in a plane: normals are not determined")
    irradiance = np.asarray(lights.irradiance, np.float32).reshape(photographs.count, -1)
    if not np.all(np.isfinite(irradiance) & (irradiance > 0)):
        raise ValueError("the irradiance of every light must be above 0: leave out photographs without light")
    return lights, directions, irradiance
