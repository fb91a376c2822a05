"""Normals as points of a disk, and a grid over it.

The stereographic chart p = n_x / (1 + n_z), q = n_y / (1 + n_z) takes the hemisphere that faces a camera at +z to the
unit disk. It keeps angles, and steps of a grid nowhere differ by more than a factor of two in angle.
"""

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.geometry import dot

RIM = 0.995
"""Largest radius that a normal is moved to, 0.3 degrees before the horizon of the camera."""

STRIDE = 6
"""Every so manieth node of a grid along each axis makes a coarse one: about 350 normals, 6 to 11 degrees apart."""


def to_chart(normals: Float[Array, "*batch 3"]) -> Float[Array, "*batch 2"]:
    """(p, q) of unit normals; those that face away from the camera are moved to the rim."""
    return within(normals[..., :2] / jnp.maximum(1 + normals[..., 2:], 1e-3))


def from_chart(pq: Float[Array, "*batch 2"]) -> Float[Array, "*batch 3"]:
    """Unit normals."""
    square = dot(pq, pq)[..., None]
    return jnp.concatenate([2 * pq, 1 - square], axis=-1) / (1 + square)


def within(pq: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
    """Points of the disk, those beyond the rim moved inwards to it."""
    radius = jnp.sqrt(dot(pq, pq))[..., None]
    return jnp.where(radius > RIM, pq * (RIM / jnp.maximum(radius, RIM)), pq)


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals `(size², 3)` at the nodes of a grid over [-1, 1]², and which of them lie in the disk. Host arrays.

    Nodes beyond the rim hold the normal at the rim: a table over them goes on as it ends, and cells that the rim cuts
    through are whole.
    """
    axis = np.linspace(-1, 1, size)
    pq = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    radius = np.linalg.norm(pq, axis=1, keepdims=True)
    pq = pq * np.minimum(1, RIM / np.maximum(radius, RIM))
    square = np.sum(pq * pq, axis=1, keepdims=True)
    return np.concatenate([2 * pq, 1 - square], axis=1) / (1 + square), radius[:, 0] <= 1


def coarse_nodes(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of every `STRIDE`th node of a grid that lies in the disk, the centre among them, and where they are."""
    normals, inside = grid(size)
    every = np.arange(size) % STRIDE == size // 2 % STRIDE
    chosen = np.flatnonzero(inside & np.outer(every, every).ravel())
    return chosen, normals[chosen, :2] / (1 + normals[chosen, 2:])
