"""Scenes that photometric stereo finds hard: two materials, golden paint, and light from one part to another.

The last is traced by Mitsuba, as direct light alone, which cast shadows are in, and with interreflection.
"""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from experiments.config import RecipeConfig, Section
from experiments.recipes._stereo_mitsuba import mitsuba_scenes
from experiments.recipes._stereo_scenes import scenes
from experiments.record import Record
from hshjax.photographs import Photographs
from hshjax.stereo import angular_errors, lambertian, solve_calibrated

DIRECT = 2
"""Depth of paths from a light over one surface to the eye."""


class Scenes(Section):
    """Synthetic scenes and their lights."""

    names: Annotated[tuple[str, ...], Field(description="shape/material")] = ()
    size: Annotated[int, Field(ge=8, description="pixels along a side")] = 96
    lights: Annotated[int, Field(ge=4, description="number")] = 96
    layout: Annotated[Literal["patch", "dome"], Field(description="of lights")] = "patch"
    spread: Annotated[float, Field(ge=0, description="of irradiances, in logarithms")] = 0.0


class Config(RecipeConfig):
    recipe: Literal["stereo_hard"]
    rendered: Annotated[Scenes, Field(description="by this library: direct light")] = Scenes()
    traced: Annotated[Scenes, Field(description="by Mitsuba: of one material each")] = Scenes()
    depth: Annotated[int, Field(gt=DIRECT, description="of paths with interreflection")] = 8
    spp: Annotated[int, Field(ge=1, description="samples of Mitsuba a value")] = 256
    variant: Annotated[Literal["llvm_ad_rgb", "scalar_rgb"], Field(description="of Mitsuba; scalar needs no LLVM")] = (
        "llvm_ad_rgb"
    )
    shortened: Annotated[
        dict[str, int], Field(default_factory=dict, description="of solve_calibrated, for a quick look")
    ]


def run(config: Config, record: Record) -> None:
    todo = [(config.rendered, name, None) for name in config.rendered.names]
    todo += [(config.traced, name, depth) for name in config.traced.names for depth in (DIRECT, config.depth)]
    rows = []
    for given, name, depth in record.progress(todo, "scenes"):
        found = record.stage(f"{name} depth {depth}", _figures, config, given, name, depth)
        light = "direct" if depth in (None, DIRECT) else "interreflected"
        by = "hshjax" if depth is None else "Mitsuba"
        rows.append({"scene": name, "light": light, "by": by, **found})
        record.metric(f"{name}, {light}: mean", found["mean"], "degrees", "angular error of normals")
    words = [
        f"{by}: {given.size} x {given.size} pixels, {given.lights} lights ({given.layout}, spread {given.spread:g})"
        for by, given in (("hshjax", config.rendered), ("Mitsuba", config.traced))
        if given.names
    ]
    record.paragraph(
        f"Angular errors of normals [degrees] over the pixels of the mask. {'. '.join(words)}. Cast shadows are in all "
        f"of them; interreflected: paths of up to {config.depth} vertices, {config.spp} samples a value. "
        "**Lambert**: mean of `lambertian`; **mean**, **median**: of `solve_calibrated`, its defaults; **outliers**: "
        "share of values that fit neither shading nor shadow."
    )
    record.table("hard", rows, "Angular errors [degrees].", printed=True)


def _figures(config: Config, given: Scenes, name: str, depth: int | None) -> dict[str, float]:
    photographs = _photographs(config, given, name, depth)
    settings: dict[str, Any] = {"seed": config.seed, **config.shortened}
    solved = solve_calibrated(photographs, **settings)
    assert photographs.truth is not None
    errors = angular_errors(solved.normals, photographs.truth)
    start = angular_errors(lambertian(photographs).normals, photographs.truth)
    return {
        "Lambert": float(np.nanmean(start)), "mean": float(np.nanmean(errors)), "median": float(np.nanmedian(errors)),
        "outliers": float(solved.outliers.mean()), "pixels": photographs.pixels,
    }  # fmt: skip


def _photographs(config: Config, given: Scenes, name: str, depth: int | None) -> Photographs:
    lit: dict[str, Any] = {
        "size": given.size, "lights": given.lights, "layout": given.layout, "spread": given.spread, "seed": config.seed
    }  # fmt: skip
    if depth is None:
        return scenes([name], **lit)[name]
    return mitsuba_scenes([name], depth=depth, spp=config.spp, variant=config.variant, **lit)[name]
