"""Shape from shading: what one photograph tells of a shape, with the fitted BRDF and with Lambert's law.

Every photograph is solved by itself; the outline alone, without any photograph, is beside it.
"""

import time
from collections.abc import Callable
from typing import Annotated, Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._one_light import (
    angles_of,
    as_sphere,
    best_lambert,
    fitted_to_normals,
    learned,
    lights_at,
    only,
    thinned,
    with_fitted_lights,
)
from experiments.recipes._stereo_materials import material
from experiments.recipes._stereo_scenes import scenes
from experiments.record import Record
from hshjax import Lambert
from hshjax.brdfs import AbstractBRDF
from hshjax.io import read_photographs
from hshjax.photographs import Photographs, placed
from hshjax.stereo import SingleImage, angular_errors, solve_single_image
from hshjax.stereo._history import History
from hshjax.stereo._relief_energy import ReliefEnergy, Target, Weights
from hshjax.stereo._relief_levels import levels
from hshjax.stereo._single_image import from_start
from hshjax.stereo._slope_shading import normals_of

OUTLINE, LAMBERT, FITTED, KNOWN = "outline alone", "Lambert", "fitted BRDF", "BRDF of known normals"

UNHELD = ", no outline"
"""What is solved without telling the outline."""

HELD_STARTS = ("smooth", "convex")
"""Where the outline is told, which speaks for hills."""

AZIMUTH = 40.0
"""Of the lights of scenes [degrees]."""


class Config(RecipeConfig):
    recipe: Literal["shape_from_shading"]
    scenes: Annotated[tuple[str, ...], Field(description="shape/material, whose masks end at silhouettes")] = ()
    reliefs: Annotated[tuple[str, ...], Field(description="shape/material, whose masks do not")] = ()
    ball: Annotated[DataPath | None, Field(description="photographs of one material, with true normals")] = None
    sphere: Annotated[DataPath | None, Field(description="photographs of a sphere, whose lights are fitted, too")] = (
        None
    )
    size: Annotated[int, Field(ge=8, description="pixels along a side of a scene")] = 48
    every: Annotated[int, Field(ge=1, description="which pixels of photographs are taken, along rows and columns")] = 3
    angles: Annotated[tuple[float, ...], Field(min_length=1, description="between light and view [degrees]")] = (
        5.0,
        20.0,
        40.0,
        60.0,
    )
    shown: Annotated[tuple[str, ...], Field(description="pictures of these, under the light before the last")] = ()


def run(config: Config, record: Record) -> None:
    names = [*config.scenes, *config.reliefs]
    names += ["ball"] * (config.ball is not None) + ["sphere", "sphere, fitted lights"] * (config.sphere is not None)
    rows = []
    for name in record.progress(names, "objects"):
        for index, angle in enumerate(config.angles):
            stage = f"{name} {angle:g}".replace("/", " ").replace(":", " ")
            case = record.stage(stage, _solved, config, name, index)
            rows += [{"object": name, **row} for row in case["rows"]]
            if name in config.shown and index == max(len(config.angles) - 2, 0):
                title = f"{name}, light {case['rows'][0]['light']:.0f} degrees from the view"
                record.figure(_file(name), _figure(case), f"{title}: see the text.")
    record.paragraph(
        f"Mean angular errors of normals [degrees] over all pixels of the mask, one photograph each. **{FITTED}**: of "
        "scenes, the BRDF fitted to the file of the material (`table:`) or the true one; of the ball and the sphere, "
        "one that `solve_calibrated` learns, without true normals, from the other photographs of the same object. "
        f"**{KNOWN}**: one that is fitted to these, given the true normals. "
        f"**{LAMBERT}**: with the albedo that suits this photograph best, given the true normals. **{OUTLINE}**: no "
        f"photograph at all. **{UNHELD[2:]}**: without telling the outline; of starts, hollows and flat ground too."
    )
    record.table("errors", rows, "Mean angular errors [degrees], a line for each photograph.")
    methods = [key for key in rows[0] if key not in ("object", "light", "seconds", "determined")]
    means = []
    for name in names:
        own = [row for row in rows if row["object"] == name]
        means.append({"object": name, **{key: _mean([row[key] for row in own]) for key in methods}})
    record.table("means", means, "Means over the lights.", printed=True)
    for row in means:
        for key in (LAMBERT, FITTED):
            if row[key] is not None:
                record.metric(f"{row['object']}, {key}", row[key], "degrees", "mean over lights")


def _mean(values: list) -> float | None:
    return float(np.mean(values)) if all(value is not None for value in values) else None


def _solved(config: Config, name: str, index: int) -> dict[str, Any]:
    """A row of errors, and pictures of one photograph."""
    photograph, brdf = _given(config, name, index)
    held, row, pictures = name not in config.reliefs, {"light": float(angles_of(photograph)[0])}, {}
    row |= dict.fromkeys((OUTLINE, LAMBERT, FITTED, KNOWN, LAMBERT + UNHELD, FITTED + UNHELD))
    if held:
        pictures[OUTLINE] = outline_alone(photograph.mask)
        row[OUTLINE] = _error(pictures[OUTLINE], photograph)
    begin = time.perf_counter()
    for title, material_ in ((LAMBERT, best_lambert(photograph)), (FITTED, brdf)):
        free = solve_single_image(photograph, material_, contour=False)
        row[title + UNHELD], best = _error(free.normals, photograph), free
        if held:
            best = solve_single_image(photograph, material_, starts=HELD_STARTS)
            row[title] = _error(best.normals, photograph)
        pictures[title] = best.normals
        if title == FITTED:
            pictures |= {"heights": best.heights, **_images(photograph, best)}
            row["determined"] = float(best.determined.mean())
    if name not in (*config.scenes, *config.reliefs):
        other, exact = _given(config, name, index, fitted_to_normals)
        row[KNOWN] = _error(solve_single_image(other, exact, starts=HELD_STARTS).normals, other)
    row["seconds"] = time.perf_counter() - begin
    return {"rows": [row], "mask": photograph.mask, "truth": photograph.truth, "pictures": pictures}


def _images(photograph: Photographs, solved: SingleImage) -> dict[str, np.ndarray]:
    return {"photograph": photograph.values[:, 0], "prediction": solved.prediction[:, 0]}


def _given(
    config: Config, name: str, index: int, find: Callable[..., tuple[AbstractBRDF, np.ndarray]] = learned
) -> tuple[Photographs, AbstractBRDF]:
    """One photograph, and what is taken for its BRDF; of objects, what is found of all other photographs."""
    if name in (*config.scenes, *config.reliefs):
        many = scenes([name], size=config.size, lights=lights_at(config.angles, AZIMUTH), seed=config.seed)[name]
        (layer,) = material(name.partition("/")[2].replace("table:", "rgl:")).layers
        return only(many, [index]), layer.brdf
    many = read_photographs(local_path(config.ball if name == "ball" else config.sphere))
    if name != "ball":
        many = as_sphere(many)
    if name.endswith("fitted lights"):
        many = with_fitted_lights(many)
    many = thinned(many, config.every)
    number = int(np.argmin(np.abs(angles_of(many) - config.angles[index])))
    brdf, stray = find(many, number)
    photograph = only(many, [number])
    values = (photograph.values - stray.astype(photograph.values.dtype)).astype(photograph.values.dtype)
    return Photographs(values, photograph.mask, photograph.lights, None, photograph.truth, photograph.notes), brdf


def outline_alone(mask: np.ndarray) -> np.ndarray:
    """Normals that bend least while they look out of the mask at its outline: no photograph."""
    nothing = np.zeros((int(mask.sum()), 1, 1))
    energies = [
        ReliefEnergy(level, Lambert(1.0), np.array([[0.0, 0.0, 1.0]]), True)
        for level in levels(Target(nothing, nothing, nothing, mask))
    ]
    with History(None).stage("outline") as done:
        state, _ = from_start("smooth", energies, Weights(1.0), False, done)
    return normals_of(energies[0].corners.slopes(state.heights))


def _error(normals: np.ndarray, photograph: Photographs) -> float:
    return float(np.nanmean(angular_errors(normals, photograph.truth)))


def _file(name: str) -> str:
    return name.replace("/", "-").replace(":", "-").replace(" ", "-").replace(",", "")


def _figure(case: dict[str, Any]) -> Any:
    """Photograph and prediction, heights; true and found normals; their errors."""
    mask, pictures = case["mask"], case["pictures"]
    methods = [key for key in (OUTLINE, LAMBERT, FITTED) if key in pictures]
    figure, axes = plt.subplots(3, 1 + len(methods), figsize=(2.1 * (1 + len(methods)), 6.6), layout="constrained")
    bright = np.nanquantile(pictures["photograph"], 0.98)

    def display(values):
        values = np.nan_to_num(values) / bright
        return placed(np.clip(values, 0, 1) ** (1 / 2.2), mask, 1.0)

    def show(ax, image, title, **options):
        drawn = ax.imshow(image, interpolation="nearest", **options)
        ax.set_title(title, fontsize=9)
        return drawn

    show(axes[0, 0], display(pictures["photograph"]), "photograph")
    show(axes[0, 1], display(pictures["prediction"]), f"prediction, {FITTED}")
    heights = show(axes[0, 2], pictures["heights"], "heights [pixels]")
    figure.colorbar(heights, cax=axes[0, -1].inset_axes((0, 0.1, 0.06, 0.8)))
    show(axes[1, 0], placed((case["truth"] + 1) / 2, mask, 1.0), "true normals")
    for ax, low, key in zip(axes[1, 1:], axes[2, 1:], methods, strict=True):
        show(ax, placed((pictures[key] + 1) / 2, mask, 1.0), key)
        errors = angular_errors(pictures[key], case["truth"])
        image = show(low, placed(errors, mask, np.nan), f"error, mean {np.nanmean(errors):.1f}°", vmin=0, vmax=20)
    bar = figure.colorbar(image, cax=axes[2, 0].inset_axes((0.85, 0.1, 0.06, 0.8)), label="angular error [degrees]")
    bar.ax.yaxis.set_ticks_position("left")
    bar.ax.yaxis.set_label_position("left")
    for ax in axes.ravel():
        ax.set_axis_off()
    return figure
