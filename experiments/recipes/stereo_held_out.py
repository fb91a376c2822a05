"""Photographs under lights that were left out, predicted by photometric stereo, and by what gradients make of it.

How well does a recovered BRDF predict? By alternation, and refined jointly: with normals, with more functions, with
roughnesses.
"""

import dataclasses
import time
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field

from experiments.config import DataPath, RecipeConfig, local_path
from experiments.record import Record
from hshjax import HSH, IsotropicBasis, LinearBRDF
from hshjax.io import read_photographs
from hshjax.photographs import Photographs
from hshjax.stereo import Stereo, angular_errors, predict, refine_jointly, solve_calibrated

LIT = 0.1
"""Least n·l of the values that are looked at."""

ALTERNATION = "alternation (solve_calibrated)"

REFINED: dict[str, dict[str, Any]] = {
    "normals, BRDF": {},
    "normals alone": {"brdf": False},
    "BRDF alone": {"normals": False},
    "BRDF alone, HSH of order 4 added": {"normals": False, "order": 4},
    "normals, BRDF, HSH of order 4 added": {"order": 4},
    "BRDF alone, roughnesses too": {"normals": False, "brdf": lambda brdf: brdf},
    "normals, BRDF, lights": {"lights": True},
}
"""Arguments of `refine_jointly`; order: of functions that are added to the BRDF."""

MASKS = ("nothing", "outliers", "outliers and shadows")


class Config(RecipeConfig):
    recipe: Literal["stereo_held_out"]
    objects: Annotated[tuple[DataPath, ...], Field(min_length=1, description="photographs with known lights")]
    step: Annotated[int, Field(ge=1, description="every so many pixels are looked at, either way")] = 1
    held: Annotated[int, Field(ge=1, description="photographs that are left out")] = 10
    draws: Annotated[int, Field(ge=1, description="how often they are drawn, seeds 0, 1, ...")] = 1
    refined: Annotated[tuple[str, ...], Field(description="of `REFINED`")] = tuple(REFINED)
    pixels: Annotated[int, Field(ge=2, description="that shared unknowns are refined on")] = 2000
    shortened: Annotated[
        dict[str, int], Field(default_factory=dict, description="of solve_calibrated, for a quick look")
    ]


def run(config: Config, record: Record) -> None:
    rows = []
    for path in record.progress(config.objects, "objects"):
        name = local_path(path).name
        draws = [record.stage(f"{name} {seed}", _draw, config, path, seed) for seed in range(config.draws)]
        for title in (ALTERNATION, *config.refined):
            found = [draw[title] for draw in draws]
            row = {key: float(np.mean([each[key] for each in found])) for key in found[0]}
            rows.append({"object": name, "solution": title, **row})
            record.metric(
                f"{name}, {title}: held out", row["held out, outliers and shadows"], "", "masked as photographs say"
            )
    record.paragraph(
        f"Of each object {config.held} photographs are left out (`numpy.random.default_rng(s).choice`, mean over "
        f"{config.draws} draws, s = 0, 1, ...); one pixel of {config.step} either way is looked at. The rest is "
        "solved, and the photographs left out are predicted. Errors: root mean square of prediction less photograph "
        f"over that of the photograph, all channels, over values with n·l > {LIT}. Masks are those of a solution of "
        "ALL photographs, so that no prediction decides by itself what it is judged by: outliers, and shadows (values "
        "below 0.15 of the pixel's 90 % quantile), which cast shadows are among. Masked: the share of values that do "
        "not count."
    )
    record.table("held_out", rows, "Errors of prediction, angles in degrees.", printed=True)


def thinned(photographs: Photographs, step: int) -> Photographs:
    """Every so many pixels, either way."""
    chosen = np.zeros_like(photographs.mask)
    chosen[::step, ::step] = True
    kept = chosen[photographs.mask]
    truth = None if photographs.truth is None else photographs.truth[kept]
    return dataclasses.replace(
        photographs, values=photographs.values[kept], mask=photographs.mask[::step, ::step].copy(), truth=truth
    )


def _draw(config: Config, path: str, seed: int) -> dict[str, dict[str, float]]:
    """Figures of every solution for one draw of photographs that are left out."""
    photographs = thinned(read_photographs(local_path(path)), config.step)
    left_out = np.sort(np.random.default_rng(seed).choice(photographs.count, config.held, replace=False))
    kept = np.setdiff1d(np.arange(photographs.count), left_out)
    settings: dict[str, Any] = dict(config.shortened)
    judge = solve_calibrated(photographs, **settings)
    parts = {"seen": (kept, _some(photographs, kept)), "held out": (left_out, _some(photographs, left_out))}
    seen, begin = parts["seen"][1], time.perf_counter()
    stereo = solve_calibrated(seen, **settings)
    found = {ALTERNATION: _figures(stereo, judge, parts) | {"seconds": time.perf_counter() - begin}}
    for title in config.refined:
        begin = time.perf_counter()
        refined = _refined(config, stereo, seen, **REFINED[title])
        found[title] = _figures(refined, judge, parts) | {"seconds": time.perf_counter() - begin}
    return found


def _figures(stereo: Stereo, judge: Stereo, parts: dict[str, tuple[np.ndarray, Photographs]]) -> dict[str, float]:
    row = {}
    for word, (lights, part) in parts.items():
        if part.truth is not None:
            row["angle"] = float(np.nanmean(angular_errors(stereo.normals, part.truth)))
        predicted = predict(stereo, part.lights)
        for mask in MASKS:
            hidden = np.zeros((part.pixels, part.count), bool)
            if mask != "nothing":
                hidden |= judge.outliers[:, lights]
            if mask == "outliers and shadows":
                hidden |= judge.shadows[:, lights]
            row[f"{word}, {mask}"], row[f"{word}, {mask}: masked"] = _error(stereo, part, predicted, hidden)
    return row


def _refined(config: Config, stereo: Stereo, photographs: Photographs, order: int = 0, **settings: Any) -> Stereo:
    if order:
        basis = IsotropicBasis(HSH(order))
        more = LinearBRDF(basis, jnp.zeros((basis.count, stereo.weights.shape[1]), jnp.float32))
        settings["start"] = stereo.brdf + more
    return refine_jointly(stereo, photographs, pixels=config.pixels, **settings)


def _some(photographs: Photographs, lights: np.ndarray) -> Photographs:
    chosen = jax.tree.map(lambda leaf: leaf[lights], photographs.lights)
    return dataclasses.replace(photographs, values=photographs.values[:, lights], lights=chosen)


def _error(stereo: Stereo, part: Photographs, predicted: np.ndarray, hidden: np.ndarray) -> tuple[float, float]:
    lights: Any = part.lights
    direction = np.asarray(lights.direction, float)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    counts = np.isfinite(part.values).all(axis=2) & (stereo.normals @ direction.T > LIT) & ~hidden
    missed = np.where(counts[..., None], predicted - part.values, 0).astype(float)
    shown = np.where(counts[..., None], part.values, 0).astype(float)
    return float(np.sqrt(np.sum(missed**2) / np.sum(shown**2))), float(1 - counts.mean())
