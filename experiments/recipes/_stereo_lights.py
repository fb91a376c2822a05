"""Lights for synthetic photometric stereo, `LAYOUTS`; one kind of light whose leaves have a leading axis."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hshjax import DirectionalLight, PointLight

HALF_ANGLE = 45.0
"""Between the view and the corners of a patch [degrees]."""


def directional(count: int, layout: str = "patch", spread: float = 0.0, seed: int = 0) -> DirectionalLight:
    """`count` lights of a layout of `LAYOUTS`, their irradiances of three channels.

    - `spread`: of the irradiances, as the standard deviation of their logarithm about that of π; channels of a light
      differ by a quarter of it. With 0 a white Lambert surface that faces a light has radiance 1.

    **Raises:** ValueError for no light, an unknown layout, a negative spread.
    """
    if count < 1:
        raise ValueError(f"there must be at least one light, got {count}")
    if layout not in LAYOUTS:
        raise ValueError(f"layout must be one of {', '.join(LAYOUTS)}, got {layout!r}")
    if spread < 0:
        raise ValueError(f"spread must not be negative, got {spread}")
    rng = np.random.default_rng([seed, 1])
    towards = LAYOUTS[layout](count, rng)
    logarithm = spread * (rng.normal(size=(count, 1)) + rng.normal(size=(count, 3)) / 4)
    return jax.vmap(DirectionalLight)(jnp.asarray(towards), jnp.asarray(np.pi * np.exp(logarithm)))


def nearby(lights: DirectionalLight, distance: float) -> PointLight:
    """Points in these directions at this distance from the origin, of the same irradiance there."""
    towards = lights.direction / jnp.linalg.norm(lights.direction, axis=1, keepdims=True)
    return jax.vmap(PointLight)(distance * towards, distance**2 * lights.irradiance)


def separate(lights: Any) -> list[Any]:
    """The lights one by one."""
    return [jax.tree.map(lambda leaf, k=k: leaf[k], lights) for k in range(len(jax.tree.leaves(lights)[0]))]


def patch(count: int, rng: np.random.Generator) -> np.ndarray:
    """Directions `(count, 3)` on a grid of 3 : 2 about the view, as on a frame in front of the object; each is moved at
    random by up to a fifth of a step. Rows are as equal as can be."""
    rows = max(1, round(np.sqrt(count / 1.5)))
    share = [count // rows + (row < count % rows) for row in range(rows)]
    x, y = (np.concatenate(axis) for axis in zip(*map(_row, share, _centred(rows)), strict=True))
    step = np.array([2 / max(share), 4 / 3 / rows])
    x, y = np.stack([x, y]) + step[:, None] * rng.uniform(-0.2, 0.2, (2, count))
    return _at(np.radians(HALF_ANGLE) * np.hypot(x, y) / np.hypot(1, 2 / 3), np.arctan2(y, x))


def dome(count: int, rng: np.random.Generator) -> np.ndarray:
    """Directions `(count, 3)` all over the hemisphere down to 80 degrees from the view, evenly along a spiral."""
    height = 1 - (np.arange(count) + rng.uniform(0.2, 0.8, count)) / count * (1 - np.cos(np.radians(80)))
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count) + rng.uniform(0, 2 * np.pi)
    return _at(np.arccos(height), turn)


LAYOUTS: dict[str, Callable[[int, np.random.Generator], np.ndarray]] = {"patch": patch, "dome": dome}


def _row(count: int, y: float) -> tuple[np.ndarray, np.ndarray]:
    return _centred(count), np.full(count, 2 / 3 * y)


def _centred(count: int) -> np.ndarray:
    """Centres of equal parts of [-1, 1]."""
    return (2 * np.arange(count) + 1 - count) / count


def _at(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Unit vectors at angles [radians] from +z, and about it."""
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
