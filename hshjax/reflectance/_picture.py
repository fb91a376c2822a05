"""A picture of a material on a shape: what one would see of it under one light, or in a furnace."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, PairFunction
from hshjax.camera import AbstractCamera
from hshjax.lighting import AbstractLighting, EnvironmentMap, HarmonicLight
from hshjax.reflectance._monte_carlo import monte_carlo
from hshjax.reflectance._parts import as_series, lights_of
from hshjax.reflectance._reflect import reflect
from hshjax.surface import Surface

PIXELS = 4096
"""Of a block: so often is progress told."""


class Picture(NamedTuple):
    """Host arrays `(rows, columns, channels)` [W m^-2 sr^-1], NaN where there is no surface.

    - `radiance`. - `deviation`: its standard deviation; None where the picture is no estimate.
    """

    radiance: np.ndarray
    deviation: np.ndarray | None


def picture(
    brdf: PairFunction,
    light: AbstractLighting,
    surface: Surface,
    camera: AbstractCamera,
    *,
    samples: int = 256,
    key: Array | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Picture:
    """A surface `(rows, columns)` of one material, as `camera` sees it.

    Lights from one direction, and a `HarmonicLight` on a series, are exact (`reflect`). Light from all around on other
    BRDFs is estimated by `monte_carlo` from `samples` directions a pixel, drawn with `key` (None: of seed 0).
    `progress(done, total)` is called after each block of pixels.

    **Raises:** ValueError as these functions do.
    """
    normals = np.asarray(surface.normal)
    mask = np.any(normals != 0, axis=-1)
    if normals.ndim != 3 or not mask.any():
        raise ValueError(f"a picture needs a surface over (rows, columns) with points in it, got {normals.shape[:-1]}")
    seen, places = normals[mask], np.asarray(surface.position)[mask]
    key = jax.random.key(0) if key is None else key
    around = [isinstance(one, EnvironmentMap | HarmonicLight) for one in lights_of(light)]
    closed = as_series(brdf) is not None and not any(isinstance(one, EnvironmentMap) for one in lights_of(light))
    drawn = any(around) and not closed
    if drawn and not all(around):
        raise ValueError("a light from one direction and one from all around: make a picture of each, and add them")
    block = min(PIXELS, len(seen))
    blocks = -(-len(seen) // block)
    found = []
    for k in range(blocks):
        # The last block is filled up with pixels of the first: one compiled program for all.
        index = np.arange(k * block, (k + 1) * block) % len(seen)
        normal, position = jnp.asarray(seen[index]), jnp.asarray(places[index])
        if drawn:
            own = jax.random.fold_in(key, k)
            one = monte_carlo(brdf, light, normal, camera, key=own, samples=samples, positions=position)
            found.append((np.asarray(one.radiance), np.sqrt(np.asarray(one.variance))))
        else:
            found.append((np.asarray(reflect(brdf, light, normal, camera, positions=position)),))
        if progress is not None:
            progress(k + 1, blocks)
    images = []
    for part in zip(*found, strict=True):
        values = np.concatenate(part)[: len(seen)]
        image = np.full((*mask.shape, values.shape[1]), np.nan)
        image[mask] = values
        images.append(image)
    return Picture(images[0], images[1] if drawn else None)


def furnace(radiance: float = 1.0) -> HarmonicLight:
    """The same radiance [W m^-2 sr^-1] from everywhere: at radiance 1, a surface shows its directional albedo."""
    return HarmonicLight(jnp.full((1, 1), radiance * np.sqrt(4 * np.pi)))
