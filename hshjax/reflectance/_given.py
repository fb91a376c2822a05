"""What callers say of points, checked and flattened."""

from typing import NamedTuple

import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.camera import AbstractCamera
from hshjax.geometry import as_directions
from hshjax.lighting import AbstractLighting


class Given(NamedTuple):
    """Normals, directions to the eye and positions (or None) of `pixels` points, `(n, 3)` each in one dtype.

    `eye` `(3,)` is the one direction towards an eye far away, or None.
    """

    pixels: tuple[int, ...]
    eye: Float[Array, " 3"] | None
    normals: Float[Array, "n 3"]
    view: Float[Array, "n 3"]
    positions: Float[Array, "n 3"] | None


def given(
    lighting: AbstractLighting,
    normals: Float[Array, "*batch 3"],
    view: Float[Array, "... 3"] | AbstractCamera,
    positions: Float[Array, "... 3"] | None,
) -> Given:
    """**Raises:** ValueError for a light or camera that needs positions and gets none, and shapes that do not fit."""
    if positions is None and lighting.needs_positions:
        raise ValueError("this light depends on where the points are: give their positions")
    if isinstance(view, AbstractCamera):
        view = view.view(positions if view.needs_positions else None)
    normals, view = as_directions(normals, view)
    if positions is not None:
        normals, view, positions = as_directions(normals, view, positions)
    for name, array in (("view", view), ("positions", positions)):
        if array is not None and array.shape not in (normals.shape, (3,)):
            raise ValueError(f"{name} must have shape (3,) or that of the normals, {normals.shape}, got {array.shape}")

    def flat(array):
        return jnp.broadcast_to(array, normals.shape).reshape(-1, 3)

    eye = view if view.ndim == 1 else None
    return Given(normals.shape[:-1], eye, flat(normals), flat(view), None if positions is None else flat(positions))
