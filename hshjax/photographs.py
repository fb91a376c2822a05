"""Photographs: the one data type that readers of images and photometric stereo share."""

import equinox as eqx
import jax
import numpy as np

from hshjax.camera import AbstractCamera
from hshjax.lighting import AbstractLighting

LUMA = (0.299, 0.587, 0.114)
"""Weights of R, G and B in grey. Source: ITU-R BT.601-7, section 2.5.1."""


class Photographs(eqx.Module):
    """Photographs of one object by a camera that stands still, each under one light. Host arrays.

    - `values` `(pixels, lights, channels)`: radiance in some unit, linear in light, of the pixels of the mask row by
      row. NaN says that nothing is known: a saturated value, a broken pixel. May be mapped from a file.
    - `mask` `(rows, columns)`, bool: which pixels see the object.
    - `lights`: one kind of light whose leaves have a leading axis, as of `jax.vmap(DirectionalLight)(directions, e)`,
      in the world of the camera. None where nothing is known of them.
    - `camera`: None for one far away, in whose world x is right, y up and z TOWARDS it.
    - `truth` `(pixels, 3)`: unit normals known otherwise, for comparison only; None, or NaN where they are not.
    - `notes`: what was done to the data on the way here, in sentences.

    **Raises:** ValueError for shapes that do not fit one another, and for an empty mask.
    """

    values: np.ndarray
    mask: np.ndarray
    lights: AbstractLighting | None = None
    camera: AbstractCamera | None = None
    truth: np.ndarray | None = None
    notes: tuple[str, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        if self.mask.ndim != 2 or self.mask.dtype != bool:
            raise ValueError(f"mask must be (rows, columns) of bool, got {self.mask.shape} of {self.mask.dtype}")
        pixels = int(self.mask.sum())
        if pixels == 0:
            raise ValueError("the mask is empty: no pixel sees the object")
        if self.values.ndim != 3 or self.values.shape[0] != pixels or 0 in self.values.shape:
            raise ValueError(
                f"values must be (pixels, lights, channels) of the {pixels} pixels of the mask, got {self.values.shape}"
            )
        if self.lights is not None:
            numbers = {leaf.shape[0] if leaf.ndim else 0 for leaf in jax.tree.leaves(self.lights)}
            if numbers != {self.count}:
                raise ValueError(f"{self.count} photographs need as many lights, got {sorted(numbers)}")
        if self.truth is not None and self.truth.shape != (pixels, 3):
            raise ValueError(f"true normals must be ({pixels}, 3), as the mask has pixels, got {self.truth.shape}")

    @property
    def pixels(self) -> int:
        """Number of pixels in the mask."""
        return self.values.shape[0]

    @property
    def count(self) -> int:
        """Number of photographs."""
        return self.values.shape[1]

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.values.shape[2]

    def image(self, values: np.ndarray, background: float = 0.0) -> np.ndarray:
        """Values `(pixels, *rest)` in their places: `(rows, columns, *rest)`."""
        return placed(values, self.mask, background)


def placed(values: np.ndarray, mask: np.ndarray, background: float = 0.0) -> np.ndarray:
    """Values `(pixels, *rest)` in the places of a mask, row by row: `(rows, columns, *rest)`."""
    image = np.full((*mask.shape, *values.shape[1:]), background, values.dtype)
    image[mask] = values
    return image


def numbers(mask: np.ndarray) -> np.ndarray:
    """Which one each pixel of a mask is, row by row; -1 outside: `(rows, columns)`."""
    return np.where(mask, np.cumsum(mask).reshape(mask.shape) - 1, -1)
