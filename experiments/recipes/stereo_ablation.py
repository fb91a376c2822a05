"""What each ingredient of photometric stereo brings, on real objects and on synthetic scenes with true normals.

One ingredient at a time is taken away or changed; all else stays as `solve_calibrated` has it.
"""

import dataclasses
import time
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field

from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._stereo_scenes import scenes
from experiments.record import Record
from hshjax import HSH, HalfVectorBasis, IsotropicBasis, LogWarp, Zernike
from hshjax.io import read_photographs
from hshjax.photographs import Photographs
from hshjax.stereo import angular_errors, solve_calibrated
from hshjax.stereo._chart import from_chart
from hshjax.stereo._columns import Column, default_columns
from hshjax.stereo._history import History
from hshjax.stereo._observe import Observations
from hshjax.stereo._stages import start

WARP = 0.1
"""Scale of the half-vector functions: highlights of paint and plastic."""

START = "the start alone: Lambert, middle ranks"

INGREDIENTS: dict[str, dict[str, Any]] = {
    "as it is": {},
    START: {},
    "no stray light": {"stray": False},
    "no learning (rounds = 0)": {"rounds": 0},
    "no handing on (sweeps = 0)": {"sweeps": 0},
    "handed on without smoothness": {"smoothness": 0.0},
    "one material": {"materials": 1},
    "three materials": {"materials": 3},
    "columns: Zernike of order 4": {"columns": "Zernike"},
    "columns: HSH of order 4": {"columns": "HSH"},
    "columns: 20 half-vector functions": {"columns": "half-vector"},
    "columns: HSH of order 4 and the highlights": {"columns": "HSH and highlights"},
}
"""Arguments of `solve_calibrated`, columns by name."""


def columns(name: str) -> tuple[Column, ...]:
    """Columns by their name."""
    if name == "Zernike":
        return (IsotropicBasis(Zernike(4)),)
    if name == "half-vector":
        return (HalfVectorBasis(20, LogWarp(jnp.asarray(WARP))),)
    return (IsotropicBasis(HSH(4)), *(default_columns()[1:] if name == "HSH and highlights" else ()))


class Config(RecipeConfig):
    recipe: Literal["stereo_ablation"]
    objects: Annotated[tuple[DataPath, ...], Field(description="photographs with true normals")] = ()
    scenes: Annotated[tuple[str, ...], Field(description="synthetic scenes, shape/material")] = ()
    size: Annotated[int, Field(ge=8, description="pixels along a side of a scene")] = 64
    lights: Annotated[int, Field(ge=8, description="of a scene")] = 96
    few: Annotated[tuple[int, ...], Field(description="numbers of lights that are drawn of all")] = (10, 20)
    draws: Annotated[int, Field(ge=1, description="how often they are drawn, seeds 0, 1, ...")] = 10
    shortened: Annotated[dict[str, int], Field(default_factory=dict, description="arguments of all, for a quick look")]


def run(config: Config, record: Record) -> None:
    names = [*(local_path(path).name for path in config.objects), *config.scenes]
    few = {f"{count} lights": count for count in config.few}
    found: dict[str, list] = {title: [] for title in [*INGREDIENTS, *few]}
    for name in record.progress(names, "objects"):
        photographs = _photographs(config, name)
        for title, results in found.items():
            arguments = config, photographs, title, few.get(title)
            results.append(record.stage(f"{name}, {title}".replace("/", " "), _errors, *arguments))
    record.paragraph(
        "Mean angular error of normals [degrees] over the pixels whose true normal is known. "
        f"Scenes have {config.size} x {config.size} pixels and {config.lights} lights over a patch, cast shadows and "
        "no light from one part of the shape to another. Few lights: the mean over "
        f"{config.draws} draws `numpy.random.default_rng(s).choice(lights, k, replace=False)`, s = 0, 1, ... "
        "Seconds: of a solution, all objects together, compilation included."
    )
    rows = [
        {
            "ingredient": title,
            **dict(zip(names, [e for e, _ in results], strict=True)),
            "seconds": sum(s for _, s in results),
        }
        for title, results in found.items()
    ]
    record.table("ingredients", rows, "Mean angular errors [degrees], one ingredient changed at a time.", printed=True)
    for row in rows:
        errors = [row[name] for name in names]
        record.metric(f"{row['ingredient']}: mean", float(np.mean(errors)), "degrees", "over objects")


def _photographs(config: Config, name: str) -> Photographs:
    for path in config.objects:
        if local_path(path).name == name:
            return read_photographs(local_path(path))
    return scenes([name], size=config.size, lights=config.lights, seed=config.seed)[name]


def _errors(config: Config, photographs: Photographs, title: str, count: int | None) -> tuple[float, float]:
    """Mean error [degrees] and time [s], of one solution or as means over draws of lights."""
    if photographs.truth is None:
        raise ValueError("an ablation needs photographs with true normals")
    settings = {"seed": config.seed, **config.shortened, **INGREDIENTS.get(title, {})}
    if "columns" in settings:
        settings["columns"] = columns(settings["columns"])
    errors, begin = [], time.perf_counter()
    draws = [None] if count is None else range(config.draws)
    for seed in draws:
        some = photographs if seed is None else drawn(photographs, count, seed)
        normals = _start(some) if title == START else solve_calibrated(some, **settings).normals
        errors.append(np.nanmean(angular_errors(normals, photographs.truth)))
    return float(np.mean(errors)), (time.perf_counter() - begin) / len(draws)


def _start(photographs: Photographs) -> np.ndarray:
    observations = Observations(photographs)
    with History(None).stage("start") as done:
        return np.asarray(from_chart(jnp.asarray(start(observations, done))))


def drawn(photographs: Photographs, count: int, seed: int) -> Photographs:
    """Some of the photographs, drawn at random."""
    chosen = np.random.default_rng(seed).choice(photographs.count, count, replace=False)
    lights = jax.tree.map(lambda leaf: leaf[chosen], photographs.lights)
    return dataclasses.replace(photographs, values=photographs.values[:, chosen], lights=lights)
