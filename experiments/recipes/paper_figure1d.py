"""The paper's Fig. 1(d): the Helmholtz basis up to order 3 at one incident direction, as lobes."""

import math
from typing import Annotated, Literal

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from pydantic import Field

from experiments.config import RecipeConfig
from experiments.recipes._paper import BLUE, GREEN, ORANGE
from experiments.record import Record
from hshjax import HSH, HelmholtzBasis, direction

VIEW = math.radians(-70), math.radians(22)
"""Azimuth and elevation of the eye."""
ZERO = 1e-12


class Config(RecipeConfig):
    recipe: Literal["paper_figure1d"]
    order: Annotated[int, Field(ge=0, le=4, description="largest order of HSH")] = 3
    theta_i: Annotated[float, Field(ge=0, lt=90, description="polar angle of the light [degrees]")] = 60.0
    phi_i: Annotated[float, Field(description="azimuth of the light [degrees]")] = 0.0
    meridians: Annotated[int, Field(ge=8, description="quadrilaterals around a lobe")] = 48
    parallels: Annotated[int, Field(ge=4, description="quadrilaterals from pole to horizon")] = 20


def run(config: Config, record: Record) -> None:
    pairs = HelmholtzBasis(HSH(config.order))
    light = direction(jnp.asarray(math.radians(config.theta_i)), jnp.asarray(math.radians(config.phi_i)))
    # The horizon itself is left out: there odd m have an infinite slope and a lobe would end in a spike of facets.
    theta = np.linspace(0, math.pi / 2 * (1 - 1e-6), config.parallels + 1)
    phi = np.linspace(0, 2 * math.pi, config.meridians + 1)
    grid = direction(jnp.asarray(theta)[:, None], jnp.asarray(phi)[None, :])
    values = np.asarray(pairs(light, grid))  # (parallels + 1, meridians + 1, modes)
    directions = np.asarray(grid)
    largest = np.abs(values).max(axis=(0, 1))
    scale = 1 / largest.max()
    vanishing = int(np.sum(largest < ZERO))

    record.paragraph(
        f"Figure 1(d) of the paper shows its basis (Eq. 2) up to order {config.order} at the incident direction "
        f"({config.theta_i:g}°, {config.phi_i:g}°). Here are all {pairs.count} functions of that order over "
        "unordered pairs, with N = 1/sqrt(2 (1 + δ)): the paper leaves the factor open and its series runs over "
        f"ordered pairs, which would show every function off the diagonal twice. {vanishing} of them vanish "
        "identically at this direction, because both of their factors do: sines in the azimuth at φi = 0, and at z = "
        "1/2, the paper's angle, also every factor that is odd in 2z − 1. That is a property of the direction, not of "
        "the basis. The radius is the modulus, all pictures share one scale (the largest value is "
        f"{largest.max():.4g} sr⁻¹), orange is positive and blue negative, and the green line points to the light."
    )
    labels = {
        k: f"({a[0]},{a[1]})×({b[0]},{b[1]})".replace("-", "\N{MINUS SIGN}") for k, (a, b) in enumerate(pairs.modes)
    }
    lobes = _Lobes(directions, values * scale, light, labels)

    modes = pairs.basis.modes
    places = {k: (modes.index(a), modes.index(b)) for k, (a, b) in enumerate(pairs.modes)}
    heads = [f"({n},{m})".replace("-", "\N{MINUS SIGN}") for n, m in modes]
    record.figure(
        "sheet", lobes.sheet(places, heads),
        f"All {pairs.count} functions: (n, m) by column, (p, q) by row. A small circle marks one that vanishes.",
    )  # fmt: skip
    degrees = pairs.degrees()
    record.heading("By pair of orders")
    for group in _groups(config.order):
        chosen = [k for k, (n, p) in enumerate(degrees) if (n, p) in group]
        said = ", ".join(f"({n}, {p})" for n, p in group)
        stem = "orders " + " ".join(f"{n}-{p}" for n, p in group)
        record.figure(
            stem, lobes.grid(chosen), f"Orders (n, p) = {said}; labels (n,m)×(p,q), one scale with the sheet."
        )
    record.table(
        "functions",
        [
            {"(n,m)×(p,q)": labels[k], "minimum": float(values[..., k].min()), "maximum": float(values[..., k].max())}
            for k in range(len(labels))
        ],
        "Extreme values over wo [sr⁻¹].",
    )
    record.metric("functions", pairs.count)
    record.metric("vanishing", vanishing, note="at this incident direction")
    record.metric("largest value", float(largest.max()), "sr^-1")


def _groups(order: int) -> list[list[tuple[int, int]]]:
    """Pairs of orders that share a figure, some 30 functions each."""
    groups = [[(n, p) for p in range(min(order, 1) + 1) for n in range(p + 1)]]
    for p in range(2, order + 1):
        groups.append([(n, p) for n in range(min(p, 2))])
        groups += [[(n, p)] for n in range(2, p + 1)]
    return groups


class _Lobes:
    """Lobes `(parallels, meridians, lobes)` in orthographic projection, drawn far to near into one flat picture.

    A picture of 136 lobes needs one scale and one painter; as many three-dimensional axes would take minutes.
    """

    def __init__(self, directions, values, light, labels):
        azimuth, elevation = VIEW
        self.right = np.array([-math.sin(azimuth), math.cos(azimuth), 0])
        self.eye = np.array(
            [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
        )
        self.up = np.cross(self.eye, self.right)
        self.directions, self.values, self.labels = directions, values, labels
        self.light = self._flat(np.asarray(light))
        circle = np.linspace(0, 2 * math.pi, 73)
        self.rim = self._flat(np.stack([np.cos(circle), np.sin(circle), 0 * circle], -1))

    def _flat(self, points):
        return np.stack([points @ self.right, points @ self.up], -1)

    def facets(self, k: int):
        """Projected quadrilaterals `(facets, 4, 2)` and their colours, far to near."""
        points = np.abs(self.values[..., k, None]) * self.directions
        corners = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], -2).reshape(-1, 4, 3)
        sign = self.values[:-1, :-1, k] + self.values[1:, 1:, k]
        normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        length = np.linalg.norm(normal, axis=-1)
        seen = length > 1e-9
        lamp = self.eye + 0.8 * self.up - 0.5 * self.right
        shade = 0.62 + 0.38 * np.abs(normal @ (lamp / np.linalg.norm(lamp))) / np.where(seen, length, 1)
        base = np.where(sign.reshape(-1, 1) >= 0, to_rgb(ORANGE), to_rgb(BLUE))
        order = np.argsort(corners.mean(axis=1) @ self.eye)
        order = order[seen[order]]
        return self._flat(corners)[order], np.clip(base * shade[:, None], 0, 1)[order]

    def _paint(self, ax, centres: dict[int, tuple[float, float]], unit: float) -> None:
        quads, colors = [], []
        for k, centre in centres.items():
            facets, shades = self.facets(k)
            quads.append(facets * unit + np.array(centre))
            colors.append(shades)
        offsets = np.array(list(centres.values()))[:, None, :]
        ax.add_collection(LineCollection(list(0.3 * unit * self.rim + offsets), colors="0.8", linewidths=0.5, zorder=0))
        stick = np.stack([0 * self.light, self.light * 0.55 * unit])
        ax.add_collection(LineCollection(list(stick + offsets), colors=GREEN, linewidths=0.7, zorder=1))
        painted = PolyCollection(
            np.concatenate(quads), facecolors=np.concatenate(colors), edgecolors="face", linewidths=0.1
        )
        painted.set_zorder(2)
        ax.add_collection(painted)
        zero = [centre for k, centre in centres.items() if np.abs(self.values[..., k]).max() < ZERO]
        if zero:
            ax.plot(*np.array(zero).T, "o", color="0.55", markersize=2.2, markerfacecolor="white", zorder=3)
        ax.set_aspect("equal")
        ax.axis("off")

    def sheet(self, places: dict[int, tuple[int, int]], heads: list[str]):
        """Columns a, rows b >= a."""
        size = len(heads)
        width = max(3.0, 0.72 * size)
        figure, ax = plt.subplots(figsize=(width, width))
        self._paint(ax, {k: (a, -0.85 * b) for k, (a, b) in places.items()}, unit=0.75)
        for i, head in enumerate(heads):
            ax.text(-0.75, -0.85 * i + 0.1, head, ha="right", va="center", fontsize=9, color="0.25")
            ax.text(i, -0.85 * i + 0.6, head, ha="center", va="bottom", fontsize=9, color="0.25")
        ax.set_xlim(-1.5, size)
        ax.set_ylim(-0.85 * size + 0.3, 1.0)
        return figure

    def grid(self, chosen: list[int]):
        """One labelled cell a function, seven a row."""
        columns = min(7, len(chosen))
        lines = -(-len(chosen) // columns)
        figure, ax = plt.subplots(figsize=(1.35 * columns, 1.35 * lines + 0.2))
        centres = {k: (i % columns, -float(i // columns)) for i, k in enumerate(chosen)}
        self._paint(ax, centres, unit=0.9)
        for k, (x, y) in centres.items():
            ax.text(x, y - 0.3, self.labels[k], ha="center", va="top", fontsize=8, color="0.25")
        ax.set_xlim(-0.55, columns - 0.45)
        ax.set_ylim(-lines + 0.6, 0.6)
        return figure
