"""Normals, reflectance and intensities under lights of known directions."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Float
from hshjax.lighting import DirectionalLight, PointLight
from hshjax.photographs import Photographs
from hshjax.stereo._calibrated import solve_calibrated
from hshjax.stereo._intensity import band_gains, diffuse_maxima, light_colours
from hshjax.stereo._observe import Observations, geometry_of, grey
from hshjax.stereo._result import Stereo
from hshjax.stereo._strength import brighter, with_strengths

SOME = 5000
"""Pixels that intensities are begun from."""


def solve_semi_calibrated(photographs: Photographs, *, gains: float = 0.3, seed: int = 0, **options: Any) -> Stereo:
    """Normals, reflectance and intensities from photographs under lights whose directions or places alone are known.

    The irradiance or intensity of `photographs.lights` is not looked at. They begin as what lights make of the pixels
    that face them (`diffuse_maxima`), then as what Lambert's law on middle ranks leaves (`band_gains`); they are
    learned with the BRDF, see `solve_calibrated`, whose `options` are these. Those of channels are medians of what
    channels have of grey.

    - `lights` of the result: irradiance `(channels,)` each. The whole has no scale, and the channels none between
      them: their geometric means over lights are equal. So the light is white on average, and weights of materials
      hold its colour.
    - `gains`: standard deviation of logarithms of intensities about their beginning.

    **Raises:** ValueError as `solve_calibrated`, and for photographs that are black.
    """
    if gains <= 0:
        raise ValueError(f"gains must be above 0, got {gains}: where irradiance is known, take solve_calibrated")
    return solve_calibrated(with_intensities(photographs, seed), gains=gains, seed=seed, **options)


def with_intensities(photographs: Photographs, seed: int) -> Photographs:
    """The same under lights in the same places, of irradiance or intensity as a start has it."""
    lights = photographs.lights
    if not isinstance(lights, DirectionalLight | PointLight):
        kind = "none" if lights is None else type(lights).__name__
        raise ValueError(f"photographs need lights of known directions, DirectionalLight or PointLight, got {kind}")
    even = replace(photographs, lights=with_strengths(lights, np.ones((photographs.count, 1))))
    some = np.sort(np.random.default_rng([seed, 1]).permutation(photographs.pixels)[:SOME])
    values = np.asarray(photographs.values[some], np.float32) / geometry_of(even).irradiance(some)
    observations = Observations(replace(even, lights=with_strengths(lights, intensities(values))))
    gains = band_gains(observations.pixels(some), observations.geometry.towards(some))
    return replace(observations.photographs, lights=brighter(observations.lights, np.exp(gains)))


def intensities(values: Float[np.ndarray, "pixels lights channels"]) -> Float[np.ndarray, "lights channels"]:
    """Irradiance of lights, whatever their directions, of what some pixels show.

    **Raises:** ValueError for photographs that are black, in which no channel of one of these pixels is above 0.
    """
    shown = values > 0  # false of NaN
    black = ~np.all(np.any(shown, axis=0), axis=1)
    if np.any(black):
        raise ValueError(f"photographs {(np.flatnonzero(black) + 1).tolist()} are black: leave them out")
    values = values[np.all(np.any(shown, axis=1), axis=1)]
    colours = light_colours(values)
    return colours * diffuse_maxima(grey(values / colours.astype(np.float32)))[:, None]


def under(photographs: Photographs, directions: np.ndarray, irradiance: np.ndarray) -> Photographs:
    """The same under lights of these directions `(lights, 3)` and irradiance `(lights, channels)`."""
    lights = jax.vmap(DirectionalLight)(jnp.asarray(directions, jnp.float32), jnp.asarray(irradiance, jnp.float32))
    return replace(photographs, lights=lights)
