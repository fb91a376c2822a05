"""Where a family of inequalities is violated most: all minima of a smooth function on a box, for all channels at once.

The functions are trigonometric polynomials, so that a grid of a few nodes a wavelength sees every feature of them. It
does not see every minimum: at the bottom of a curved valley neighbouring nodes lie at different heights of its walls.
Therefore every low node is judged by the minimum of the quadratic through its neighbourhood, and the promising ones
are followed to the minimum of the function itself.
"""

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array
from hshjax.fitting._constraints import Face, Family, family_gaps

NODES_A_WAVELENGTH = (8, 6, 5, 4, 3, 2)
"""Densities of the search grid; the first that keeps it below `LARGEST` nodes is taken."""

LARGEST = 300_000
FOLLOWED = 300
"""Nodes a channel that are followed beside the local minima of the predictions."""

RESOLVED = 1e-6
"""Size of a stencil [radians] below which a minimum is known: to 1e-12 times the second derivative."""

BLOCK = 32
"""Channels that are looked at together: enough to make rows worth while, few enough to hold their values."""

CHUNK = 2048
"""Points a call: one shape, so that little is compiled; small, so that rows keep to some MB."""


STRAIGHT = {"mode": "reflect", "reflect_type": "odd"}
BEYOND: dict[Face, Any] = {
    "wraps": {"mode": "wrap"},
    "mirrors": {"mode": "reflect"},
    "passes": STRAIGHT,
    "ends": STRAIGHT,
}
"""How `numpy.pad` continues a grid beyond the faces of a coordinate: the last two in a straight line."""


class Minima(NamedTuple):
    """Points `(n, d)` and their gap row(x) · c - floor(x) - rounding `(n,)`, without the margin."""

    x: np.ndarray
    gap: np.ndarray


class SearchGrid:
    """The nodes of one family. Host arrays, float64."""

    def __init__(self, family: Family):
        self.family = family
        lower, upper = family.box
        counts = [LARGEST]
        for density in NODES_A_WAVELENGTH:
            # A box side of length L holds degree x L / 2π wavelengths.
            counts = [
                max(8, int(np.ceil(density * degree * (b - a) / (2 * np.pi)))) + 1
                for degree, a, b in zip(family.degrees(), lower, upper, strict=True)
            ]
            if np.prod(counts) <= LARGEST:
                break
        axes = [
            np.linspace(a, b, n, endpoint=face != "wraps")
            for a, b, n, (face, _) in zip(lower, upper, counts, family.faces, strict=True)
        ]
        self.shape = tuple(counts)
        self.spacing = np.array([axis[1] - axis[0] for axis in axes])
        self.nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))

    def minima(
        self, coefficients: np.ndarray, channels: list[int], rounding: np.ndarray, steps: int
    ) -> dict[int, Minima]:
        """The lowest points for each of `channels`: all that lie below 0, as far as the grid tells, and near misses."""
        found = {}
        for block, filled in channel_blocks(coefficients, channels):
            columns, allowed = jnp.asarray(coefficients[:, filled]), jnp.asarray(rounding[filled])
            gaps = _gaps(self.family, columns, allowed, self.nodes)
            for k, c in enumerate(block):
                start = self._promising(gaps[:, k].reshape(self.shape))
                found[c] = follow(self.family, coefficients[:, c], rounding[c], start, self.spacing / 2, steps)
        return found

    def _promising(self, gap: np.ndarray) -> np.ndarray:
        """Points from which to descend."""
        from scipy.ndimage import minimum_filter  # here, to keep `import hshjax` cheap

        modes: Any = ["wrap" if face == "wraps" else "nearest" for face, _ in self.family.faces]
        scale = np.mean(np.abs(gap))
        # Where the function is large, it may fall far below the lowest of the nodes about a minimum. Rounding may set
        # a pair of nodes apart that mirror each other, and the lower one may be of the half that is dropped below.
        minimal = gap <= minimum_filter(gap, 3, mode=modes) + 1e-12 * scale
        low = np.argwhere((gap < 0.1 * scale) | minimal)
        if self.family.swaps:  # the other half says the same
            low = low[low[:, 0] <= low[:, 1]]
        step, predicted = _predict(gap, low, self.family.faces)
        sheet = np.full(gap.shape, np.inf)
        sheet[tuple(low.T)] = predicted
        # A quadratic through such nodes tells the depth below them to a few tenths.
        doubt = np.maximum(0.02 * scale, 0.3 * (gap[tuple(low.T)] - predicted))
        lowest = (sheet <= minimum_filter(sheet, 3, mode=modes))[tuple(low.T)] & (predicted < doubt)
        order = np.argsort(predicted)
        beside = order[~lowest[order] & (predicted[order] < 0)][:FOLLOWED]
        chosen = np.concatenate([order[lowest[order]], beside])
        flat = np.ravel_multi_index(tuple(low[chosen].T), gap.shape)
        return np.minimum(self.nodes[flat] + step[chosen] * self.spacing, _limit(self.family))


def _predict(gap: np.ndarray, nodes: np.ndarray, faces: tuple[tuple[Face, Face], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Step [nodes] towards the minimum of the quadratic about each node, no further than a node, and its value."""
    padded = gap
    for axis, (face, _) in enumerate(faces):
        width = [(1, 1) if a == axis else (0, 0) for a in range(gap.ndim)]
        padded = np.pad(padded, width, **BEYOND[face])
    here = nodes + 1

    def at(*shifts):
        return np.array([padded[tuple((here + shift).T)] for shift in shifts])

    values = at(*stencil(gap.ndim)).T
    step, predicted = _descend(values, gap.ndim)
    return step, np.minimum(predicted, values[:, 0])


def stencil(d: int) -> np.ndarray:
    """Shifts that a quadratic is fitted to: the centre, ± every axis, the four diagonals of every pair of axes."""
    unit = np.eye(d, dtype=int)
    shifts = [0 * unit[0]]
    for e in unit:
        shifts += [e, -e]
    for e, f in itertools.combinations(unit, 2):
        shifts += [e + f, -e - f, e - f, f - e]
    return np.array(shifts)


def _descend(values: np.ndarray, d: int) -> tuple[np.ndarray, np.ndarray]:
    """Newton step of the quadratic through the stencil, |.| of its curvatures, at most 1 a coordinate; its value.

    The coordinate that goes furthest beyond 1 stops there, and the others take the minimum of what is left to them: in
    a narrow valley the step stays at its bottom.
    """
    slope = (values[:, 1 : 2 * d + 1 : 2] - values[:, 2 : 2 * d + 1 : 2]) / 2
    curvature = np.zeros((len(values), d, d))
    for i in range(d):
        curvature[:, i, i] = values[:, 1 + 2 * i] + values[:, 2 + 2 * i] - 2 * values[:, 0]
    for k, (i, j) in enumerate(itertools.combinations(range(d), 2)):
        q = values[:, 1 + 2 * d + 4 * k :][:, :4]
        curvature[:, i, j] = curvature[:, j, i] = (q[:, 0] + q[:, 1] - q[:, 2] - q[:, 3]) / 4
    # A straight direction has no Newton step; a tiny curvature instead leads to the limit of 1.
    least = 1e-12 * np.max(np.abs(values), axis=1, initial=1e-300)[:, None]
    step = np.zeros((len(values), d))
    free = np.ones(step.shape, bool)
    for _ in range(d + 1):
        pull = slope + np.einsum("nij,nj->ni", curvature, np.where(free, 0, step))
        bends, axes = np.linalg.eigh(np.where(free[:, :, None] & free[:, None, :], curvature, 0))
        newton = np.einsum("nji,nj->ni", axes, np.where(free, pull, 0)) / np.maximum(np.abs(bends), least)
        step = np.where(free, -np.einsum("nij,nj->ni", axes, newton), step)
        furthest = np.abs(step) == np.max(np.abs(step), axis=1, keepdims=True)
        stops = free & furthest & (np.abs(step) > 1)
        step = np.where(stops, np.sign(step), step)
        free &= ~stops
        if not np.any(stops):
            break
    return step, values[:, 0] + np.sum(slope * step, axis=1) + np.einsum("ni,nij,nj->n", step, curvature, step) / 2


def follow(
    family: Family, coefficients: np.ndarray, rounding: float, x: np.ndarray, spacing: np.ndarray, steps: int
) -> Minima:
    """Descend from every point to a minimum nearby, by quadratics on stencils of size `spacing` `(d,)`.

    A stencil shrinks where its minimum lies within, and grows again, up to its first size, where it does not; a point
    whose stencil is below `RESOLVED` stays. Points may leave the box where the function goes on beyond its faces.
    `coefficients` `(modes,)`, `rounding`: of one channel.
    """
    shifts, d = stencil(x.shape[1]), x.shape[1]
    limit, first = _limit(family), spacing
    column, allowed = jnp.asarray(coefficients[:, None]), jnp.asarray([rounding], jnp.float64)

    def gaps(points):
        return _gaps(family, column, allowed, points)[:, 0]

    def descended(x, best, spacing):
        """One step of all points; the last is their stencils' new size."""
        centre = np.minimum(x, limit - spacing)
        points = (centre[:, None] + shifts * spacing[:, None]).reshape(-1, d)
        values = gaps(points).reshape(len(x), len(shifts))
        step, _ = _descend(values, d)
        target = centre + step * spacing
        k = np.argmin(values, axis=1)
        corner = points.reshape(len(x), len(shifts), d)[np.arange(len(x)), k]
        choices = np.stack([best, gaps(target), values[np.arange(len(x)), k]])
        winner = np.argmin(choices, axis=0)  # a tie stays
        x = np.stack([x, target, corner])[winner, np.arange(len(x))]
        at_face = target >= limit - 1e-3 * spacing
        inside = np.all((np.abs(step) < 0.99) | at_face, axis=1) | (winner == 0)
        grown = np.minimum(2 * spacing, first)
        return x, np.min(choices, axis=0), np.where(inside[:, None], spacing / 6, grown)

    x, best, spacing = x.copy(), gaps(x), np.tile(spacing, (len(x), 1))
    for _ in range(steps):
        moving = np.max(spacing, axis=1) > RESOLVED
        if not np.any(moving):
            break
        x[moving], best[moving], spacing[moving] = descended(x[moving], best[moving], spacing[moving])
    return Minima(x, best)


def _gaps(family: Family, columns: Array, rounding: Array, x: np.ndarray) -> np.ndarray:
    """Gaps `(n, channels)` of points, in chunks."""
    return in_chunks(lambda p: family_gaps(family, columns, rounding, p), x)


def channel_blocks(coefficients: np.ndarray, channels: list[int]) -> Iterator[tuple[list[int], np.ndarray]]:
    """Blocks of `channels`, and the same filled up by repetition: a program is compiled for every width."""
    width = min(BLOCK, coefficients.shape[1])
    for start in range(0, len(channels), width):
        block = channels[start : start + width]
        yield block, np.resize(block, width)


def in_chunks(function, x: np.ndarray) -> np.ndarray:
    """`function` of points `(n, d)`, in calls of one shape."""
    if len(x) == 0:
        return np.asarray(function(jnp.zeros((CHUNK, x.shape[1]))))[:0]
    parts = []
    for part in np.split(x, range(CHUNK, len(x), CHUNK)):
        padded = np.concatenate([part, np.repeat(part[-1:], CHUNK - len(part), axis=0)])
        parts.append(np.asarray(function(jnp.asarray(padded)))[: len(part)])
    return np.concatenate(parts)


def _limit(family: Family) -> np.ndarray:
    """What no coordinate may exceed."""
    return np.where([above == "ends" for _, above in family.faces], family.box[1], np.inf)
