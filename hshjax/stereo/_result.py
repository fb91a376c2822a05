"""What photometric stereo returns."""

import equinox as eqx
import numpy as np

from hshjax._typing import Array, Bool, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.camera import AbstractCamera
from hshjax.lighting import AbstractLighting
from hshjax.photographs import placed
from hshjax.stereo._history import Stage


class Stereo(eqx.Module):
    """Normals, reflectance and lights of an object, from photographs. Host arrays of the pixels of the mask.

    - `normals` `(pixels, 3)`: unit, in the world: where `camera` is None, x right, y up, z towards it.
    - `weights` `(pixels, materials, channels)`: how much of each material of `brdf` a pixel has; >= 0.
    - `brdf`: reciprocal, a channel for each material [sr^-1, up to a factor: the scale of photographs is arbitrary].
    - `lights`: as they were given, or as they were found.
    - `stray`: light that reaches all pixels alike, over the mean of the photograph.
    - `deviation` `(pixels,)`: standard deviation of the normal as its residuals predict it [radians]: confidence where
      it is small. It knows nothing of light from other parts of the object. Infinite where nothing is determined.
    - `outliers` `(pixels, lights)`: known values that fit neither shading nor shadow, and count for nothing.
      `shadows`: dark values, which were not looked at.
    - `mask` `(rows, columns)`. - `history`: the stages of the solution. - `camera`: that of the photographs.
    - `positions` `(pixels, 3)`: of the surface, in the world, where lights or camera are nearby; else None, and
      `height_from_normals(result.image(result.normals), result.mask, camera=result.camera)` tells heights.
    """

    normals: Float[np.ndarray, "pixels 3"]
    weights: Float[np.ndarray, "pixels materials channels"]
    brdf: AbstractBRDF
    lights: AbstractLighting
    stray: float
    deviation: Float[np.ndarray, " pixels"]
    outliers: Bool[np.ndarray, "pixels lights"]
    shadows: Bool[np.ndarray, "pixels lights"]
    mask: Bool[np.ndarray, "rows columns"]
    history: tuple[Stage, ...]
    camera: AbstractCamera | None = None
    positions: Float[np.ndarray, "pixels 3"] | None = None

    def image(self, values: Float[np.ndarray, "pixels ..."]) -> Float[np.ndarray, "rows columns ..."]:
        """Values of the pixels in their places, 0 elsewhere."""
        return placed(values, self.mask)


def angular_errors(
    a: Float[Array | np.ndarray, "*n 3"], b: Float[Array | np.ndarray, "*n 3"]
) -> Float[np.ndarray, " *n"]:
    """Angles between unit vectors [degrees]; NaN where one is. Exact for small angles, where the arccosine is not."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    return np.degrees(2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))
