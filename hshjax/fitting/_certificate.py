"""What can be said of a fit that is to be physically valid: on directions that the fit has not seen."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.bases import AbstractProductBasis
from hshjax.brdfs._linear import EXPONENTS, Target, cosine_power
from hshjax.fitting._constraints import Energy, Family, NonNegative, last_polar, polar_angle, vanishes
from hshjax.fitting._search import channel_blocks, follow, in_chunks

TOLERANCE = 1e-6
"""What the smallest value [sr^-1] and the largest albedo may miss."""

PAIRS = 300_000
"""Upper limit of the pairs that are looked at."""

CELLS = {1: 64, 2: 24, 3: 16, 4: 6}
"""Cells along every axis, by the number of axes."""

STRIDE = 0.1
"""First size [radians] of the quadratics by which minima are sought between the nodes as well."""

STAGES = ((1024, 12), (64, 60))
"""From the lowest point of how many cells, by how many steps: from all for a little, from the lowest to the end."""


class Certificate(eqx.Module):
    """The smallest ρ and the largest directional albedo of a fit, on directions that were not used to make it.

    - `smallest`: smallest value of ρ per channel [sr^-1]; `albedo`: largest directional albedo per channel.
    - `kept`: whether they keep what the constraints asked for, smallest >= -1e-6 sr^-1 and albedo <= 1 + 1e-6, per
      channel. `holds`: whether all channels do.
    - `pairs`, `directions`: at how many pairs, and how many outgoing directions, they were looked for.
    - `max_theta`: the largest polar angle among them [radians]; below 90 degrees where ρ is a quotient of a series and
      its cosines, whose rounding grows towards the horizon.
    - `lift`: constant that was added to the optimum, per channel, to make up for what the last round of exchange left
      over (to ρ; to the series, if that stands for z_i z_o ρ or its root and "energy" is not asked for). 0 where the
      optimum itself is certified.
    - `rounds`: rounds of exchange that the fit took. `active`: per channel, how many inequalities shape it.

    For isotropic bases the pairs fill their three dimensions: nodes closer than the search's, with grazing angles, the
    pole, retro-reflection and mirror direction added, and minima sought between the lowest of them. For others the four
    dimensions are sampled, by quasi-random pairs and such configurations: a coarser look.
    """

    smallest: Float[Array, " channels"]
    albedo: Float[Array, " channels"]
    lift: Float[Array, " channels"]
    kept: tuple[bool, ...] = eqx.field(static=True)
    pairs: int = eqx.field(static=True)
    directions: int = eqx.field(static=True)
    max_theta: float = eqx.field(static=True)
    rounds: int = eqx.field(static=True)
    active: tuple[int, ...] = eqx.field(static=True)

    @property
    def holds(self) -> bool:
        """Whether every channel keeps what the constraints asked for."""
        return all(self.kept)

    def part(self, channels: slice) -> "Certificate":
        """The certificate of some of the channels."""
        return Certificate(
            self.smallest[channels],
            self.albedo[channels],
            self.lift[channels],
            self.kept[channels],
            self.pairs,
            self.directions,
            self.max_theta,
            self.rounds,
            self.active[channels],
        )


class Certifier:
    """Looks at fits of one basis, whose coefficients are kept in `dtype`; what it has seen it does not look at again.

    Both figures are reported whatever was asked for, and looked for just as close to the horizon.
    """

    def __init__(self, basis: AbstractProductBasis, target: Target, constraints: tuple[str, ...], dtype: np.dtype):
        exponent = EXPONENTS[target]
        edge = last_polar(dtype) if exponent else np.pi
        depth = int(vanishes(exponent, constraints))
        values = NonNegative(basis, (depth * basis.reciprocal, depth), edge)
        energy = Energy(basis, exponent, exponent, edge)
        self.values = _Watch(values, _pairs(values), exponent)
        self.energy = _Watch(energy, _directions(energy), 0.0)
        self.constraints, self.dtype, self.theta = constraints, dtype, polar_angle(edge)

    def certify(
        self, coefficients: np.ndarray, rounds: int, active: tuple[int, ...], lift: np.ndarray
    ) -> tuple[Certificate, dict[str, "Lowest"]]:
        """The certificate of float64 `coefficients` `(modes, channels)`, and what is lowest for each constraint."""
        dark, bright = self.values.lowest(coefficients), self.energy.lowest(coefficients)
        kept = {"non_negative": dark.figure >= -TOLERANCE, "energy": -bright.figure <= 1 + TOLERANCE}
        every = tuple(bool(all(channel)) for channel in zip(*(kept[name] for name in self.constraints), strict=True))
        smallest, albedo, added = (jnp.asarray(figure, self.dtype) for figure in (dark.figure, -bright.figure, lift))
        pairs, directions = len(self.values.x), len(self.energy.x)
        certificate = Certificate(smallest, albedo, added, every, pairs, directions, self.theta, rounds, active)
        return certificate, {"non_negative": dark, "energy": bright._replace(lowest=1 + bright.lowest)}


class Lowest(NamedTuple):
    """Per channel: the smallest ρ (or -albedo), the smallest gap in the scale of the rows, and the lowest points."""

    figure: np.ndarray
    lowest: np.ndarray
    points: list[np.ndarray]


class _Watch:
    """The lowest of one family's sums, at the points `x` and at the minima next to the lowest of them."""

    def __init__(self, family: Family, x: np.ndarray, exponent: float):
        self.family, self.x, self.exponent = family, x, exponent
        self.seen: dict[int, tuple[np.ndarray, float, float, np.ndarray]] = {}

    def lowest(self, coefficients: np.ndarray) -> Lowest:
        """Of every channel; those whose coefficients are as they were keep what was found."""
        changed = [
            c
            for c, column in enumerate(coefficients.T)
            if c not in self.seen or not np.array_equal(column, self.seen[c][0])
        ]
        for block, filled in channel_blocks(coefficients, changed):
            at_points = self._at(coefficients[:, filled], self.x)
            for k, c in enumerate(block):
                column = coefficients[:, c].copy()  # the caller may change its own
                self.seen[c] = (column, *self._descended(column, at_points[:, :, k]))
        _, figure, lowest, points = zip(*(self.seen[c] for c in range(coefficients.shape[1])), strict=True)
        return Lowest(np.array(figure), np.array(lowest), list(points))

    def _at(self, columns: np.ndarray, x: np.ndarray) -> np.ndarray:
        coefficients = jnp.asarray(columns)
        return in_chunks(lambda p: _sums(self.family, coefficients, p, self.exponent), x)

    def _descended(self, column: np.ndarray, at_points: np.ndarray) -> tuple[float, float, np.ndarray]:
        sizes = np.full(self.x.shape[1], STRIDE)
        points, values = [self.x], [at_points]
        for cells, steps in STAGES:
            # Neither figure's lowest points alone: those may crowd in one valley, while another one is deeper.
            start = [_lowest_of_cells(self.family, points[-1], values[-1][:, k], cells) for k in (0, 1)]
            points.append(follow(self.family, column, 0.0, np.unique(np.concatenate(start), axis=0), sizes, steps).x)
            values.append(self._at(column[:, None], points[-1])[:, :, 0])
        figure, lowest = np.min(np.concatenate(values), axis=0)
        return figure, lowest, np.concatenate(points[1:])


@partial(jax.jit, static_argnums=(0, 3))
def _sums(family: Family, coefficients: Array, x: Array, exponent: float) -> Float[Array, "n 2 channels"]:
    """ρ at pairs, or minus the albedo of directions; and what the rows add up to."""
    sums = family.sums(coefficients, x)
    if isinstance(family, Energy):
        return jnp.stack([sums, sums], axis=1)
    factor = family.scale(x) / cosine_power(*family.pairs(x), exponent)
    return jnp.stack([sums * factor[:, None], sums], axis=1)


def _lowest_of_cells(family: Family, x: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """The lowest point of every cell of the box, those of the lowest cells."""
    lower, upper = family.box
    cells = CELLS[x.shape[1]]
    cell = np.clip((x - lower) / (upper - lower) * cells, 0, cells - 1).astype(int)
    number = cell @ cells ** np.arange(x.shape[1])
    order = np.argsort(values, kind="stable")
    _, first = np.unique(number[order], return_index=True)
    return x[order[np.sort(first)[:count]]]


def _polar(count: int, edge: float) -> np.ndarray:
    """α of evenly spaced polar angles, and of some near the pole and the horizon."""
    last = np.degrees(polar_angle(edge))
    theta = (np.arange(count) + 0.5) / count * last
    theta = np.radians(np.r_[theta, 0, 0.05, 0.5, [t for t in (86, 88, 89, 89.5, 89.9) if t < last], last])
    return 2 * np.arcsin(np.minimum(np.sqrt(2) * np.sin(theta / 2), 1))  # cos²(α/2) = cos θ


def _pairs(family: NonNegative) -> np.ndarray:
    polar, azimuth = family.degrees()[0], family.degrees()[2]
    lower, upper = family.box
    if family.box.shape[1] == 4:
        return _four_dimensional(family)
    n, m = max(30, 6 * polar), max(30, 6 * azimuth)
    shrink = min(1.0, (PAIRS / (m * (n + 9) ** 2)) ** (1 / 3))
    alpha = _polar(int(n * shrink), family.edge)
    phi = lower[2] + (np.arange(int(m * shrink)) + 0.5) / int(m * shrink) * (upper[2] - lower[2])
    phi = np.r_[phi, 0, 0.005, np.pi - 0.005, np.pi]  # retro-reflection and mirror direction: θ_i runs through θ_o
    grid = np.stack(np.meshgrid(alpha, alpha, phi, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[grid[:, 0] <= grid[:, 1]] if family.swaps else grid


def _four_dimensional(family: NonNegative) -> np.ndarray:
    from scipy.stats import qmc  # here, to keep `import hshjax` cheap

    lower, upper = family.box
    anywhere = qmc.scale(qmc.Halton(4, rng=np.random.default_rng(0)).random(PAIRS // 2), lower, upper)
    alpha = _polar(24, family.edge)
    phi = np.pi * (2 * (np.arange(24) + 0.5) / 24 - 1)
    ai, ao, phi_i = (axis.ravel() for axis in np.meshgrid(alpha, alpha, phi, indexing="ij"))
    mirror, retro = (np.stack([ai, ao, phi_i, phi_i + turn], axis=1) for turn in (np.pi, 0))
    special = np.concatenate([mirror, retro])
    special[:, 3] = np.mod(special[:, 3] + np.pi, 2 * np.pi) - np.pi
    return np.concatenate([anywhere, special])


def _directions(family: Energy) -> np.ndarray:
    polar, *azimuth = family.degrees()
    alpha = _polar(max(200, 20 * polar), family.edge)
    if not azimuth:
        return alpha[:, None]
    count = max(60, 8 * azimuth[0])
    phi = np.pi * (2 * (np.arange(count) + 0.5) / count - 1)
    return np.stack(np.meshgrid(alpha, phi, indexing="ij"), axis=-1).reshape(-1, 2)
