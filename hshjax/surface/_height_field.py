"""A surface given as heights over a grid, each node of which is a pixel."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hshjax._fields import floating
from hshjax._typing import Array, Bool, Float
from hshjax.geometry import normalized
from hshjax.surface._surface import Surface


def height_field(
    heights: Float[Array | np.ndarray, "rows columns"], *, spacing: Any = 1.0, mask: Any = None
) -> Surface:
    """The surface z = height over a grid `(rows, columns)`, x to the right and y up: row 0 has the largest y.

    - `spacing`: between neighbours, in the unit of the heights. The grid is centred about x = y = 0, as are the pixels
      of `OrthographicCamera((0, 0, 1), (0, 1, 0), height=rows * spacing, resolution=(rows, columns))`.
    - `mask` `(rows, columns)`: where there is a surface; None: everywhere. Heights outside still count as neighbours of
      those inside.

    Normals are of second order: by central differences, one-sided along the border. Differentiable in heights and
    spacing.

    **Raises:** ValueError for fewer than 3 rows or columns, heights that are not finite, and other shapes.
    """
    heights = floating(heights)
    if heights.ndim != 2 or min(heights.shape) < 3:
        raise ValueError(f"heights must have shape (rows, columns), at least 3 of each, got {heights.shape}")
    if not isinstance(heights, Tracer) and not np.all(np.isfinite(heights)):
        count = int(np.sum(~np.isfinite(heights)))
        raise ValueError(f"heights must be finite, {count} are not: fill in what the mask leaves out")
    spacing = floating(spacing).astype(heights.dtype)
    if spacing.shape != ():
        raise ValueError(f"spacing must be a scalar, got shape {spacing.shape}")
    if not isinstance(spacing, Tracer) and not spacing > 0:
        raise ValueError(f"spacing must be positive, got {spacing}")
    if mask is not None:
        mask = jnp.asarray(mask, bool)
        if mask.shape != heights.shape:
            raise ValueError(f"mask must have the shape of the heights, {heights.shape}, got {mask.shape}")
    return _height_field(heights, spacing, mask)


@eqx.filter_jit
def _height_field(
    heights: Float[Array, "rows columns"], spacing: Float[Array, ""], mask: Bool[Array, "rows columns"] | None
) -> Surface:
    rows, columns = heights.shape
    x = spacing * jnp.asarray(np.arange(columns) - (columns - 1) / 2, heights.dtype)
    y = spacing * jnp.asarray((rows - 1) / 2 - np.arange(rows), heights.dtype)
    position = jnp.stack([*jnp.meshgrid(x, y), heights], axis=-1)
    right, down = _differences(heights.T).T / spacing, _differences(heights) / spacing
    normal = normalized(jnp.stack([-right, down, jnp.ones_like(heights)], axis=-1))
    if mask is not None:
        normal = jnp.where(mask[..., None], normal, 0)
    return Surface(normal, position)


def _differences(values: Float[Array, "n m"]) -> Float[Array, "n m"]:
    """Derivative along the first axis, of second order, at unit spacing."""
    inner = (values[2:] - values[:-2]) / 2
    first = (-3 * values[:1] + 4 * values[1:2] - values[2:3]) / 2
    last = (3 * values[-1:] - 4 * values[-2:-1] + values[-3:-2]) / 2
    return jnp.concatenate([first, inner, last])
