"""Lights and a camera nearby: what photometric stereo makes of them, and what it loses where it takes them as far away.

Rendered scenes without noise, but where a row says so; what the camera says of the mean depth may be wrong.
"""

import dataclasses
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field

from experiments.config import RecipeConfig, Section
from experiments.recipes._stereo_lights import HALF_ANGLE, directional, nearby
from experiments.recipes._stereo_meshes import camera, pinhole
from experiments.recipes._stereo_scenes import parts, photographs
from experiments.record import Record
from hshjax import DirectionalLight, OrthographicCamera, PerspectiveCamera, PointLight
from hshjax.photographs import Photographs
from hshjax.stereo import angular_errors, lambertian, solve_calibrated

DIAMETER = 2.0
"""Of objects: the camera sees [-1, 1]²."""

NEAR, FAR, LAMBERT = "nearby", "as far", "Lambert"


class Case(Section):
    """Where lights and camera are, and what is wrong with the photographs."""

    lights: Annotated[
        float | None, Field(gt=0.5, description="distance from the middle of the object [diameters]; none: far")
    ] = None
    camera: Annotated[float | None, Field(gt=0.5, description="likewise")] = None
    noise: Annotated[float, Field(ge=0, description="standard deviation of values, over their mean")] = 0.0
    off: Annotated[float, Field(gt=-1, lt=1, description="how much farther the mean depth is told than it is: of the "
                                "distance of the camera, or of the lights where that is far")] = 0.0  # fmt: skip


class Config(RecipeConfig):
    recipe: Literal["stereo_near"]
    objects: Annotated[tuple[str, ...], Field(min_length=1, description="synthetic scenes, shape/material")]
    cases: Annotated[tuple[Case, ...], Field(min_length=1, description="rows of the table")]
    size: Annotated[int, Field(ge=8, description="pixels along a side")] = 64
    lights: Annotated[int, Field(ge=4, description=f"within {HALF_ANGLE:.0f} degrees of the view")] = 32
    shortened: Annotated[
        dict[str, int], Field(default_factory=dict, description="of solve_calibrated, for a quick look")
    ]


def run(config: Config, record: Record) -> None:
    rows = []
    for number, case in enumerate(record.progress(config.cases, "cases"), 1):
        row: dict[str, Any] = {key: _word(value) for key, value in case}
        for name in config.objects:
            found = record.stage(f"case {number} {name}", _errors, config, name, case)
            row |= {f"{name}: {title}": found.get(title) for title in (NEAR, FAR, LAMBERT)}
            for title, error in found.items():
                record.metric(f"{name}, {_title(case)}: {title}", error, "degrees")
        rows.append(row)
    record.paragraph(
        f"Mean angular errors of normals [degrees] on rendered scenes of {config.size} x {config.size} pixels and "
        f"{config.lights} lights within {HALF_ANGLE:.0f} degrees of the view. `lights`, `camera`: their distances "
        "from the middle of the object, in its diameters. `noise`: over the mean of all values. `off`: how much too "
        "far away the camera says the object to be, as a share of its own distance, or of that of the lights where "
        f"the camera is far. **{NEAR}**: `solve_calibrated` with positions of lights and camera. **{FAR}**: with "
        "directions and irradiance of lights as they are in the middle of the image at the true mean depth, and the "
        f"camera far away. **{LAMBERT}**: `lambertian`, with positions."
    )
    record.table("near", rows, "Mean angular errors [degrees].", printed=True)


def _word(value: float | None) -> float | str:
    return "far" if value is None else value


def _title(case: Case) -> str:
    told = ", ".join(f"{key} {_word(value)}" for key, value in case if key in ("lights", "camera") or value)
    return told.replace("lights far, camera far", "all far")


def _errors(config: Config, name: str, case: Case) -> dict[str, float]:
    given = photographed(config, name, case)
    settings: dict[str, Any] = {"seed": config.seed, **config.shortened}
    found = {LAMBERT: _mean_error(lambertian(given).normals, given)}
    if case.lights is not None or case.camera is not None:
        found[NEAR] = _mean_error(solve_calibrated(given, **settings).normals, given)
    if not case.off:
        found[FAR] = _mean_error(solve_calibrated(as_far(given), **settings).normals, given)
    return found


def photographed(config: Config, name: str, case: Case) -> Photographs:
    """The photographs of a case, with what they tell the solver of lights and camera."""
    lights: DirectionalLight | PointLight = directional(config.lights, seed=config.seed)
    eye: OrthographicCamera | PerspectiveCamera | None = None
    if case.lights is not None:
        lights, eye = nearby(lights, DIAMETER * case.lights), camera(config.size)
    if case.camera is not None:
        eye = pinhole(config.size, DIAMETER * case.camera)
    distance = case.camera or case.lights or 0
    shape, material = parts(name, config.seed)
    made = photographs(
        shape, material, lights, camera=eye, off=DIAMETER * distance * case.off, size=config.size, seed=config.seed,
        note=name,
    )  # fmt: skip
    if not case.noise:
        return made
    noise = np.random.default_rng([config.seed, 15]).normal(size=made.values.shape)
    noisy = made.values + case.noise * made.values.mean() * noise
    return dataclasses.replace(made, values=noisy.astype(made.values.dtype))


def as_far(photographs: Photographs) -> Photographs:
    """The same photographs, lights and camera told to be far away: light as it comes to the point above the middle of
    the image that has the mean depth."""
    lights, eye = photographs.lights, photographs.camera
    if isinstance(lights, PointLight):
        assert isinstance(eye, OrthographicCamera | PerspectiveCamera)  # else nobody knows how deep the object lies
        middle = jnp.asarray(eye.target if isinstance(eye, PerspectiveCamera) else eye.centre, lights.position.dtype)
        towards = lights.position - middle[None]
        distance = jnp.linalg.norm(towards, axis=1, keepdims=True)
        intensity = lights.intensity.reshape(len(towards), -1)
        lights = jax.vmap(DirectionalLight)(towards / distance, intensity / distance**2)
    return dataclasses.replace(photographs, lights=lights, camera=None)


def _mean_error(normals: np.ndarray, photographs: Photographs) -> float:
    assert photographs.truth is not None
    return float(np.nanmean(angular_errors(normals, photographs.truth)))
