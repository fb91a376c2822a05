"""The pictures in the report of `hshjax stereo`, as PNG."""

import io
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from hshjax import plotting
from hshjax.cli._stereo_files import albedos, displayable, shown_albedo
from hshjax.cli._stereo_metrics import Solved, directions, intensities
from hshjax.geometry import direction
from hshjax.lighting import DirectionalLight
from hshjax.stereo import Stereo, predict

WIDTH = 9.0
"""Of a row of pictures [inches]."""

DPI = 110
SHOWN = 4
"""Photographs that are compared, and new lights."""

NEW_LIGHTS = {
    "from the camera": (0, 0, 1),
    "from the left": (-1, 0, 0.6),
    "from above": (0, 1, 0.6),
    "from the right, low": (1, -0.2, 0.25),
}
INCIDENCE = (0, 30, 60)
"""Of lobes [degrees]."""


def normals(solved: Solved) -> bytes:
    """Normals as colours, those of the truth beside them, and the albedo."""
    stereo, truth = solved.stereo, solved.photographs.truth
    columns = {"normals": _painted(stereo, (stereo.normals + 1) / 2)}
    if truth is not None:
        columns["true normals"] = _painted(stereo, (truth + 1) / 2)
    columns["albedo"] = shown_albedo(stereo, albedos(stereo))
    return _row(columns, stereo)


def maps(solved: Solved) -> bytes:
    """What is known of every pixel's reliability: error where the truth is known, predicted deviation, misfit, share of
    outliers."""
    stereo = solved.stereo
    deviation = np.degrees(stereo.deviation)
    columns: dict[str, tuple[np.ndarray, str, float]] = {}  # values, unit, the least that a scale ends at
    if solved.error is not None:
        columns["angular error"] = solved.error, "degrees", 1e-3
    columns |= {
        "predicted deviation": (np.where(np.isfinite(deviation), deviation, np.nan), "degrees", 1e-3),
        "misfit": (100 * solved.misfit, "% of the pixel's RMS", 1e-3),
        "outliers": (100 * stereo.outliers.mean(axis=1), "% of photographs", 1.0),
    }
    figure, axes = _canvas(1, len(columns), stereo, extra=0.75)
    for axis, (title, (values, unit, least)) in zip(axes[0], columns.items(), strict=True):
        known = values[np.isfinite(values)]
        top = max(float(np.quantile(known, 0.98)), least) if known.size else least
        image = np.full(stereo.mask.shape, np.nan)
        image[stereo.mask] = values
        drawn = axis.imshow(_cropped(image, stereo), cmap="viridis", vmin=0, vmax=top, interpolation="nearest")
        axis.set_title(title, fontsize=9)
        bar = figure.colorbar(drawn, ax=axis, orientation="horizontal", pad=0.03, fraction=0.06, extend="max")
        bar.set_label(unit, fontsize=8)
        bar.ax.tick_params(labelsize=7)
    return _png(figure)


def comparison(solved: Solved) -> bytes:
    """Some photographs, the model's prediction of them, and four times the difference."""
    stereo, photographs = solved.stereo, solved.photographs
    chosen = _spread(directions(stereo.lights, stereo.positions), SHOWN)
    figure, axes = _canvas(3, len(chosen), stereo)
    for column, j in enumerate(chosen):
        observed = _radiance(stereo, np.asarray(photographs.values[:, j], float))
        predicted = _radiance(stereo, solved.predicted[:, j].astype(float))
        factor = _exposure(observed)
        # What is not known, a saturated value most of the time, is shown as the brightest.
        shown = np.where(stereo.mask[..., None] & np.isnan(observed), 1 / factor, observed)
        images = [plotting.display(image, factor) for image in (shown, predicted)]
        difference = plotting.display(4 * np.abs(observed - predicted), factor)
        for axis, image in zip(axes[:, column], (*images, difference), strict=True):
            axis.imshow(_cropped(image, stereo), interpolation="nearest")
        axes[0, column].set_title(f"light {j + 1}", fontsize=9)
    for axis, label in zip(axes[:, 0], ("photograph", "predicted", "4 × difference"), strict=True):
        _label(axis, label)
    return _png(figure)


def relit(solved: Solved) -> bytes:
    """Under lights that no photograph has."""
    stereo = solved.stereo
    towards = jnp.asarray(list(NEW_LIGHTS.values()), jnp.float32)
    radiance = predict(stereo, jax.vmap(DirectionalLight)(towards, jnp.ones(len(towards))), stray=False)
    factor = _exposure(_radiance(stereo, radiance[:, 0].astype(float)))
    images = {
        title: plotting.display(_radiance(stereo, radiance[:, k].astype(float)), factor)
        for k, title in enumerate(NEW_LIGHTS)
    }
    return _row(images, stereo)


def lights(solved: Solved, given: Any) -> bytes:
    """Directions of lights on the hemisphere, seen along the view. `given`: those to compare with, or None."""
    figure = Figure(figsize=(4.6, 4.1), dpi=DPI, layout="constrained")
    axis = figure.subplots()
    turn = np.linspace(0, 2 * np.pi, 181)
    for degrees in (30, 60, 90):
        radius = np.sin(np.radians(degrees))
        axis.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.75", lw=1.0 if degrees == 90 else 0.6)
        axis.text(0.72 * radius, 0.72 * radius, f"{degrees}°", fontsize=7, color="0.45")
    found, intensity = directions(solved.stereo.lights, solved.stereo.positions), intensities(solved.stereo.lights)
    if given is not None:
        there = directions(given)
        axis.plot(*np.stack([there, found], axis=1)[..., :2].T.reshape(2, 2, -1), color="0.4", lw=0.8)
        axis.scatter(*there[:, :2].T, s=34, facecolors="none", edgecolors=plotting.COLOURS[1], label="given")
    dots = axis.scatter(
        *found[:, :2].T,
        s=14,
        c=intensity / intensity.mean(),
        cmap="viridis",
        label="used" if given is None else "found",
        zorder=3,
    )
    if given is not None:
        axis.legend(fontsize=8, loc="upper left", frameon=False)
    bar = figure.colorbar(dots, ax=axis, fraction=0.045, pad=0.02)
    bar.set_label("irradiance or intensity / mean", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    axis.set_aspect("equal")
    axis.set_xlim(-1.08, 1.08)
    axis.set_ylim(-1.08, 1.12)
    axis.set_axis_off()
    return _png(figure)


def lobes(solved: Solved) -> bytes:
    """√ρ of each material over θ_o in the plane of incidence, relative to its largest value drawn."""
    stereo = solved.stereo
    theta = np.linspace(-np.radians(80), np.radians(80), 641)
    wo = direction(jnp.asarray(theta), jnp.zeros(theta.size))
    incidence = direction(jnp.radians(jnp.asarray(INCIDENCE, float)), jnp.full(len(INCIDENCE), np.pi))
    values = np.stack([np.asarray(stereo.brdf(wi, wo), float) for wi in incidence])  # incidence, angle, material
    count = values.shape[-1]
    figure = Figure(figsize=(max(WIDTH / 3 * count, 4.2), 2.7), dpi=DPI, layout="constrained")
    share = stereo.weights.mean(axis=2).sum(axis=0, dtype=float)
    for k in range(count):
        axis: Any = figure.add_subplot(1, count, k + 1, projection="polar")
        top = np.quantile(np.abs(values[..., k]), 0.995)
        for colour, degrees, value in zip(plotting.COLOURS, INCIDENCE, values[..., k], strict=False):
            axis.plot(theta, np.sqrt(np.maximum(value, 0) / top), color=colour, lw=1.5, label=f"{degrees}°")
            axis.plot([-np.radians(degrees)] * 2, [1.02, 1.12], color=colour, lw=2.5, clip_on=False)
        axis.set_theta_zero_location("N")
        axis.set_theta_direction(-1)
        axis.set_thetalim(-np.pi / 2, np.pi / 2)
        axis.set_rlim(0, 1.12)
        axis.set_rticks([0.5, 1], labels=[])
        axis.tick_params(labelsize=7)
        axis.set_title(f"material {k + 1}, {share[k] / share.sum():.0%} of the weights", fontsize=9)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, fontsize=8, frameon=False, title="incidence", title_fontsize=8, loc="outside right center"
    )
    return _png(figure)


def _row(images: dict[str, np.ndarray], stereo: Stereo) -> bytes:
    figure, axes = _canvas(1, len(images), stereo)
    for axis, (title, image) in zip(axes[0], images.items(), strict=True):
        axis.imshow(_cropped(image, stereo), interpolation="nearest")
        axis.set_title(title, fontsize=9)
    return _png(figure)


def _canvas(rows: int, columns: int, stereo: Stereo, extra: float = 0.25) -> tuple[Figure, np.ndarray]:
    """Axes without frames for pictures of the object, `extra` inches over or under each."""
    height, width = _cropped(stereo.mask, stereo).shape
    one = min(WIDTH / columns, 3.2)
    figure = Figure(
        figsize=(one * columns, rows * (one * min(height / width, 2.5)) + extra), dpi=DPI, layout="constrained"
    )
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.ravel():
        axis.set_xticks([])
        axis.set_yticks([])
        for spine in axis.spines.values():
            spine.set_visible(False)
    return figure, axes


def _cropped(image: np.ndarray, stereo: Stereo) -> np.ndarray:
    """What is around the object is left out."""
    rows, columns = (np.flatnonzero(stereo.mask.any(axis=axis)) for axis in (1, 0))
    return image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _painted(stereo: Stereo, values: np.ndarray) -> np.ndarray:
    """Colours in their places, white elsewhere and where they are unknown."""
    image = np.ones((*stereo.mask.shape, 3))
    image[stereo.mask] = np.where(np.isfinite(values), values, 1)
    return image


def _radiance(stereo: Stereo, values: np.ndarray) -> np.ndarray:
    """Of 1 or 3 channels, NaN outside the mask."""
    image = np.full((*stereo.mask.shape, values.shape[-1]), np.nan)
    image[stereo.mask] = values
    return displayable(image)


def _exposure(image: np.ndarray) -> float:
    """`plotting.exposure`, 1 for black images."""
    return plotting.exposure(image, 0.98) if np.nanquantile(image, 0.98) > 0 else 1.0


def _label(axis: Any, text: str) -> None:
    axis.set_ylabel(text, fontsize=9)


def _spread(towards: np.ndarray, count: int) -> list[int]:
    """Numbers of lights that lie far apart: each the farthest from those chosen before, from the first."""
    chosen = [0]
    while len(chosen) < min(count, len(towards)):
        nearest = np.max(towards @ towards[chosen].T, axis=1)
        nearest[chosen] = np.inf
        chosen.append(int(np.argmin(nearest)))
    return sorted(chosen)


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", metadata={"Software": None})
    return file.getvalue()
