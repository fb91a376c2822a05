"""Cast shadows of a height field: how high its horizon is, all around every pixel."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hshjax._fields import floating
from hshjax._typing import Array, Float, Int
from hshjax.brdfs._base import in_dtype
from hshjax.lighting._base import AbstractLighting, Incident, Points
from hshjax.lighting._shadow import AbstractShadedLight

NOTHING = -1e3
"""Slope towards where nothing stands, the border of the field: 0.06 degrees from straight down, and finite."""


class Horizon(eqx.Module):
    """The horizon around each pixel, over which light must come.

    `slope` `(*pixels, azimuths)`: tangent of the elevation of the highest obstacle, negative where all lies lower, in
    equispaced azimuths from +x towards +y. Linear in azimuth between them.

    Called with directions in the world, `(n, emitters, 3)`, and numbers of pixels, `(n,)`, it says which share of an
    emitter there a pixel sees, `(n, emitters)`: 0 or 1. Its derivative is 0: shadows have sharp borders.

    **Raises:** ValueError for fewer than 3 azimuths.
    """

    slope: Float[Array, "*pixels azimuths"] = eqx.field(converter=floating)

    def __check_init__(self):
        if self.slope.ndim < 1 or self.slope.shape[-1] < 3:
            raise ValueError(f"slope must have shape (*pixels, azimuths), at least 3 azimuths, got {self.slope.shape}")

    @property
    def pixels(self) -> tuple[int, ...]:
        """Shape of what is shaded."""
        return self.slope.shape[:-1]

    def __call__(self, w: Float[Array, "#n emitters 3"], index: Int[Array, " n"]) -> Float[Array, "n emitters"]:
        azimuths = self.slope.shape[-1]
        slope = jax.lax.stop_gradient(self.slope.astype(w.dtype)).reshape(-1, azimuths)
        w = jax.lax.stop_gradient(w)
        turn = jnp.mod(jnp.arctan2(w[..., 1], w[..., 0]) / (2 * np.pi) * azimuths, azimuths)
        left = jnp.floor(turn)
        part, left = turn - left, left.astype(int) % azimuths
        row = index[:, None]
        height = (1 - part) * slope[row, left] + part * slope[row, (left + 1) % azimuths]
        return (w[..., 2] >= height * jnp.hypot(w[..., 0], w[..., 1])).astype(w.dtype)

    @classmethod
    def from_heights(
        cls, heights: Float[Array | np.ndarray, "rows columns"], *, spacing: Any = 1.0, azimuths: int = 64
    ) -> "Horizon":
        """The horizon of the surface z = height over a grid `(rows, columns)`, x to the right and y up as for
        `hshjax.surface.height_field`.

        Looks at all crossings of a ray with the lines of the grid, between whose nodes heights are linear. Beyond the
        border is nothing. Time grows with pixels, azimuths, and rows plus columns; memory with pixels times azimuths.
        Heights count as constant: what is visible has no derivative by them, nor has this.

        **Raises:** ValueError for other shapes, heights that are not finite, a spacing that is not positive, and for
        fewer than 3 azimuths.
        """
        heights = floating(heights)
        spacing = floating(spacing).astype(heights.dtype)
        if heights.ndim != 2 or 0 in heights.shape:
            raise ValueError(f"heights must have shape (rows, columns), got {heights.shape}")
        if azimuths < 3:
            raise ValueError(f"azimuths must be >= 3, got {azimuths}")
        if spacing.shape != () or not (isinstance(spacing, Tracer) or spacing > 0):
            raise ValueError(f"spacing must be a positive scalar, got {spacing}")
        if not isinstance(heights, Tracer) and not np.all(np.isfinite(heights)):
            raise ValueError(f"heights must be finite, {np.sum(~np.isfinite(heights))} are not")
        crossings = _crossings(heights.shape, azimuths)
        heights, spacing = jax.lax.stop_gradient((heights, spacing))
        return cls(_slopes(heights / spacing, *map(jnp.asarray, crossings)))


class ShadowedLight(AbstractShadedLight):
    """A light that a horizon hides from some pixels: `Horizon` asked for every emitter.

    An emitter is hidden or not as if it were infinitely far away: a lamp nearby has to lie beyond whatever stands in
    its direction. What is visible is piecewise constant, and counts as constant in derivatives: they are exact, but do
    not know that borders of shadows move.

    **Raises:** in `reflect`, ValueError for other pixels than those of the horizon.
    """

    light: AbstractLighting
    horizon: Horizon

    def visible_from(self, points: Points, incident: Incident) -> Float[Array, "n emitters"]:
        if self.horizon.pixels != points.pixels:
            raise ValueError(f"a horizon of pixels {self.horizon.pixels} cannot shade normals {(*points.pixels, 3)}")
        return in_dtype(self.horizon, points.frame.dtype)(incident.direction, points.index)


def _crossings(shape: tuple[int, ...], azimuths: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where rays from a node cross the lines of the grid, azimuth by azimuth, in no order. Host arrays.

    - `nodes` `(azimuths, crossings, 2, 2)`: offsets in rows and columns of the two nodes that a crossing is between.
    - `measures` `(azimuths, crossings, 2)`: the part of the way from the first to the second, and 1 / distance.
    - `counts` `(azimuths,)`: how many there are; the rest is filling.
    """
    nodes, measures = [], []
    for angle in 2 * np.pi * np.arange(azimuths) / azimuths:
        step = np.array([-np.sin(angle), np.cos(angle)])  # rows run down
        step[np.abs(step) < 1e-12] = 0
        found = []
        for axis, other in ((0, 1), (1, 0)):
            if step[axis] == 0:
                continue
            k = np.arange(1, shape[axis])
            distance = k / np.abs(step[axis])
            across = distance * step[other]
            nearest = np.rint(across)
            at_node = np.abs(across - nearest) < 1e-9  # but for rounding, which must not look beyond the border
            first = np.where(at_node, nearest, np.floor(across))
            second = np.where(at_node, nearest, first + 1)
            line = k * np.sign(step[axis])
            pairs = [np.stack([line, end] if axis == 0 else [end, line], -1) for end in (first, second)]
            part = np.where(at_node, 0, across - first)
            kept = np.maximum(np.abs(first), np.abs(second)) < shape[other]
            if axis == 1 and step[0] != 0:
                kept &= ~at_node  # rows have found them
            found.append((np.stack(pairs, 1)[kept], np.stack([part, 1 / distance], -1)[kept]))
        nodes.append(np.concatenate([pair for pair, _ in found]))
        measures.append(np.concatenate([measure for _, measure in found]))
    counts = np.array([len(measure) for measure in measures])
    length = max(1, counts.max())

    def filled(tables):
        return np.stack([np.pad(t, [(0, length - len(t)), *[(0, 0)] * (t.ndim - 1)]) for t in tables])

    return filled(nodes).astype(np.int32), filled(measures), counts


@jax.jit
def _slopes(
    heights: Float[Array, "rows columns"],
    nodes: Int[Array, "azimuths crossings 2 2"],
    measures: Float[Array, "azimuths crossings 2"],
    counts: Int[Array, " azimuths"],
) -> Float[Array, "rows columns azimuths"]:
    """The largest slope up to a crossing, azimuth by azimuth; heights in steps of the grid."""
    rows, columns = heights.shape
    # Whole pictures are shifted and compared; -inf comes in from beyond the border.
    wide = jnp.pad(heights, ((rows - 1,) * 2, (columns - 1,) * 2), constant_values=-jnp.inf)

    def shifted(node):
        return jax.lax.dynamic_slice(wide, (rows - 1 + node[0], columns - 1 + node[1]), heights.shape)

    def one_azimuth(crossings):
        nodes, measures, count = crossings

        def look(k, slope):
            (first, second), (part, nearness) = (shifted(node) for node in nodes[k]), measures[k]
            there = jnp.where(part == 0, first, (1 - part) * first + part * second)
            return jnp.maximum(slope, (there - heights) * nearness)

        return jax.lax.fori_loop(0, count, look, jnp.full_like(heights, NOTHING))

    return jnp.moveaxis(jax.lax.map(one_azimuth, (nodes, measures.astype(heights.dtype), counts)), 0, -1)
