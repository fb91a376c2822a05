"""What callers say of points, checked and flattened."""

from typing import NamedTuple

import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.camera import AbstractCamera
from hshjax.geometry import as_directions, normalized
from hshjax.lighting import AbstractLighting
from hshjax.reflectance._parts import lights_of


class Given(NamedTuple):
    """Normals, directions to the eye and positions (or None) of `pixels` points, `(n, 3)` each in one dtype.

    Normals and directions are of unit length, but for points without a surface: all is 0 there. `eye` `(3,)` is the one
    direction towards an eye far away, or None.
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
    for light in lights_of(lighting):
        light.__check_init__()  # again: what `jax.vmap` has made is many lights in one
    if positions is None and lighting.needs_positions:
        raise ValueError("this light depends on where the points are: give their positions")
    (normals,) = as_directions(normals)
    shape = normals.shape
    surface = jnp.any(normals != 0, axis=-1, keepdims=True)

    def flat(name, array):
        array = jnp.asarray(array)
        if array.shape not in (shape, (3,)):
            raise ValueError(f"{name} must have shape (3,) or that of the normals, {shape}, got {array.shape}")
        # What is said of points without a surface counts nowhere, not even as the factor of a derivative.
        return jnp.where(surface, array, jnp.zeros_like(array)).reshape(-1, 3)

    known = [] if positions is None else [flat("positions", positions)]
    if isinstance(view, AbstractCamera):
        view = view.view(known[0].reshape(shape) if known and view.needs_positions else None)
    normals, view, *known = as_directions(normals, view, *known)
    view = normalized(view)
    eye = view if view.ndim == 1 else None
    return Given(shape[:-1], eye, normalized(normals).reshape(-1, 3), flat("view", view), *(known or [None]))
