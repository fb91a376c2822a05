"""Infinitely many inequalities by a few at a time.

The exchange method for semi-infinite programs (Hettich & Kortanek, SIAM Review 35(3), 1993): solve with the
inequalities at hand, look for the points where the solution violates others, add those at the minima, drop what is far
from active, and solve again. The optimum grows from round to round, so that it ends; near the end the points stand at
the minima of the solution itself.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from hshjax.fitting._certificate import Lowest
from hshjax.fitting._constraints import Family, family_levels, family_rows
from hshjax.fitting._least_distance import least_distance
from hshjax.fitting._search import SearchGrid, in_chunks

MARGIN = 5e-7
"""What every inequality is asked for beyond its floor (sr^-1 or albedo); half of what the certificate lets it miss."""

COARSE = 4
"""Rounds in which the minima are moving still, so that it does not pay to find them to all digits."""


@dataclass
class Channel:
    """What the exchange knows of one channel: points of every family, and how many inequalities hold it."""

    points: list[np.ndarray]
    active: int = 0
    settled: bool = False


class Exchange:
    """min |root (c - start)|² for every channel, c in the inequalities of all `families` and in the span of `free`.

    `start` `(modes, channels)`, `root` upper triangular, `free` `(modes, unknowns)` or None for all; `rounding`
    `(channels,)`: how far coefficients may be off after the fit. Host arrays, float64.
    """

    def __init__(self, families: tuple[Family, ...], root: np.ndarray, start: np.ndarray, free, rounding: np.ndarray):
        self.grids = [SearchGrid(family) for family in families]
        self.free = free
        if free is None:
            self.root, self.start = root, start
        else:
            orthogonal, self.root = np.linalg.qr(root @ free)
            self.start = np.linalg.solve(self.root, orthogonal.T @ (root @ start))
        self.rounding = rounding
        self.coefficients = self._full(self.start)
        self.channels = [Channel([np.zeros((0, grid.spacing.size)) for grid in self.grids]) for _ in start.T]
        self.rounds = 0

    def _full(self, unknowns: np.ndarray) -> np.ndarray:
        return unknowns.copy() if self.free is None else self.free @ unknowns

    @property
    def settled(self) -> bool:
        return all(channel.settled for channel in self.channels)

    def round(self) -> None:
        """Search, add, solve, drop: for every channel that is not settled."""
        self.rounds += 1
        steps = 2 if self.rounds <= COARSE else 4
        todo = [c for c, channel in enumerate(self.channels) if not channel.settled]
        found = [grid.minima(self.coefficients, todo, self.rounding, steps) for grid in self.grids]
        for c in todo:
            channel = self.channels[c]
            mine = [minima[c] for minima in found]
            worst = min(np.min(gap, initial=np.inf) for _, gap in mine)
            if worst >= 0:
                channel.settled = True
                continue
            for k, (x, _) in enumerate(mine):
                channel.points[k] = _distinct(np.concatenate([channel.points[k], x]), self.grids[k].spacing)
            self._solve(c)

    def add(self, found: list[Lowest]) -> None:
        """Take points that the search has not seen, one entry per family, and solve where they lie below 0."""
        for c, channel in enumerate(self.channels):
            if min(lowest.lowest[c] for lowest in found) < 0:
                for k, lowest in enumerate(found):
                    channel.points[k] = np.concatenate([channel.points[k], lowest.points[c]])
                channel.settled = False
                self._solve(c)

    def _solve(self, c: int) -> None:
        channel = self.channels[c]
        rows, floors = [], []
        for grid, x in zip(self.grids, channel.points, strict=True):
            rows.append(in_chunks(lambda p, family=grid.family: family_rows(family, p), x))
            levels = in_chunks(lambda p, family=grid.family: jnp.stack(family_levels(family, p), axis=1), x)
            floors.append(levels @ [1, self.rounding[c]] + MARGIN)
        matrix, floor = np.concatenate(rows), np.concatenate(floors)
        reduced = matrix if self.free is None else matrix @ self.free
        point, multiplier = least_distance(self.root, self.start[:, c], reduced, floor)
        self.coefficients[:, c] = self._full(point)
        slack = matrix @ self.coefficients[:, c] - floor
        ends = np.cumsum([len(x) for x in channel.points])[:-1]
        # What is far from active would only slow the next solution down.
        keep = (multiplier > 0) | (slack <= np.sort(slack)[min(slack.size, 2 * point.size) - 1])
        channel.active = int(np.sum(multiplier > 0))
        channel.points = [x[k] for x, k in zip(channel.points, np.split(keep, ends), strict=True)]


def _distinct(x: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """One of every cluster of points that agree to a thousandth of the grid's spacing."""
    _, first = np.unique(np.round(x / (1e-3 * spacing)), axis=0, return_index=True)
    return x[np.sort(first)]
