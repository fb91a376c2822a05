"""Shape and light from one photograph, or three, in natural illumination, where one of them is unknown or both are."""

import dataclasses
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._stereo_meshes import seen
from experiments.recipes._stereo_shapes import SHAPES
from experiments.record import Record
from hshjax import (
    GGX,
    HSH,
    EnvironmentMap,
    HarmonicLight,
    IsotropicBasis,
    Lambert,
    LinearBRDF,
    Samples,
    isotropic_pair_rule,
    plotting,
    project,
    reflect,
)
from hshjax.io import read_exr
from hshjax.photographs import Photographs
from hshjax.stereo import angular_errors, light_from_shape, solve_natural
from hshjax.stereo._inflated import Inflated
from hshjax.stereo._natural import NEAR

CASES = {
    "light known": {},
    "light known, grey": {"grey": True},
    "light unknown": {"unknown": True},
    "light unknown, grey": {"unknown": True, "grey": True},
    "three lights known": {"lights": 3},
    "three lights unknown": {"lights": 3, "unknown": True},
}


class Config(RecipeConfig):
    recipe: Literal["natural_light"]
    environments: Annotated[tuple[DataPath, ...], Field(min_length=3, description="maps of light, up is y")]
    shapes: Annotated[tuple[str, ...], Field(description="of the shapes of photometric stereo")] = ("sphere", "blob")
    materials: Annotated[tuple[Literal["lambert", "glossy"], ...], Field(description="known to the solver")] = (
        "lambert", "glossy",
    )  # fmt: skip
    size: Annotated[int, Field(ge=12, description="pixels along a side")] = 64
    truth_order: Annotated[int, Field(ge=2, description="of light that makes photographs")] = 8
    lambert_order: Annotated[int, Field(ge=0, description="of light that is looked for, on Lambert's surfaces")] = 2
    glossy_order: Annotated[int, Field(ge=0, description="of light that is looked for, on glossy ones")] = 4
    noise: Annotated[float, Field(gt=0, description="of values, over the photograph's root mean square")] = 0.01
    cases: Annotated[tuple[str, ...], Field(description="of `CASES`")] = tuple(CASES)
    steps: Annotated[int, Field(ge=1, description="of a fit at most")] = 500


def run(config: Config, record: Record) -> None:
    first, low, high = local_path(config.environments[0]).name, config.lambert_order, config.glossy_order
    record.paragraph(
        f"Photographs of {config.size} x {config.size} pixels in the light of `{first}` as a series of order "
        f"{config.truth_order} (three: all maps), noise {config.noise:.0%}. A known light is that series; an unknown "
        f"one is looked for up to order {low} (Lambert) or {high} (glossy: half Lambert, half GGX of roughness 0.4, as "
        "a series of order 6, known). Error: mean angle of normals [degrees]. Dome: that of the start, which knows the "
        "outline alone. Residual: over the photograph's root mean square. Spread: the largest mean angle between the "
        f"best solution and another whose loss is within {NEAR - 1:.0%} of its. Light: relative error of the radiance "
        "of a white Lambert sphere in the light that was found."
    )
    rows, shown = [], {}
    todo = [(s, m, c) for m in config.materials for s in config.shapes for c in config.cases]
    for shape, material, case in record.progress(todo, "cases"):
        found = record.stage(f"{shape} {material} {case}".replace(",", ""), _case, config, shape, material, case)
        shown.setdefault((shape, material), {})[case] = found
        rows.append({"shape": shape, "material": material, "case": case, **found["row"]})
        record.metric(f"{shape} {material}, {case}: error", found["row"]["error"], "deg")
    record.table("shapes", rows, "Shape in natural illumination.", printed=True)
    record.heading("Light from a known shape")
    lights = [
        {
            "shape": shape,
            "material": material,
            **record.stage(f"light {shape} {material}", _light, config, shape, material),
        }
        for material in config.materials
        for shape in config.shapes
    ]
    record.table(
        "lights", lights,
        "Determined: combinations of coefficients whose deviation is below a tenth of the light's norm, of all; "
        "residual: over the photograph's root mean square; error: of the radiance of a white Lambert sphere, relative.",
        printed=True,
    )  # fmt: skip
    for (shape, material), cases in shown.items():
        record.figure(
            f"{shape}-{material}", _draw(cases), f"{shape}, {material}: the photograph, normals, errors to 30°."
        )


def _lights(config: Config) -> list[HarmonicLight]:
    def of(path):
        image = np.asarray(read_exr(local_path(path)), float)[..., :3]
        rows, columns = 64, 128
        step = image.shape[0] // rows, image.shape[1] // columns
        image = image.reshape(rows, step[0], columns, step[1], 3).mean(axis=(1, 3))
        return HarmonicLight.from_environment(EnvironmentMap(jnp.asarray(image), up="y"), config.truth_order)

    return [of(path) for path in config.environments[:3]]


def _order(config: Config, material: str) -> int:
    return config.lambert_order if material == "lambert" else config.glossy_order


def _brdf(name: str) -> Any:
    if name == "lambert":
        return Lambert(1.0)
    basis = IsotropicBasis(HSH(6))
    glossy = 0.5 * Lambert(1.0) + 0.5 * GGX(1.0, 0.4)
    model = project(basis, Samples.from_function(glossy, isotropic_pair_rule(32))).model
    return LinearBRDF(basis, model.coefficients, model.target)


def _photographs(config: Config, shape: str, material: str, case: dict[str, Any]) -> Photographs:
    mask, normals, _ = seen(SHAPES[shape](config.seed), config.size)
    lights = _lights(config)[: case.get("lights", 1)]
    view, brdf = jnp.asarray([0.0, 0.0, 1.0]), _brdf(material)
    values = np.stack([np.asarray(reflect(brdf, light, jnp.asarray(normals), view)) for light in lights], axis=1)
    coefficients = np.stack([np.asarray(light.coefficients) for light in lights])
    if case.get("grey"):
        values, coefficients = values.mean(-1, keepdims=True), coefficients.mean(-1, keepdims=True)
    level = np.sqrt(np.mean(values**2, axis=0, keepdims=True))
    values = values + config.noise * level * np.random.default_rng(config.seed).normal(size=values.shape)
    many = jax.vmap(HarmonicLight)(jnp.asarray(coefficients))
    return Photographs(values, mask, many, None, normals)


def _case(config: Config, shape: str, material: str, name: str) -> dict[str, Any]:
    case = CASES[name]
    given = _photographs(config, shape, material, case)
    photographs = dataclasses.replace(given, lights=None) if case.get("unknown") else given
    found = solve_natural(
        photographs, brdf=_brdf(material), order=_order(config, material), noise=config.noise, steps=config.steps
    )
    errors = angular_errors(found.normals, given.truth)
    outline = Inflated.of(given.mask, jnp.result_type(float))
    dome = angular_errors(np.asarray(outline.normals(outline.flat(1)), float), given.truth)
    near = found.losses <= NEAR * np.nanmin(found.losses)
    row = {
        "dome": float(dome.mean()), "error": float(errors.mean()), "median": float(np.median(errors)),
        "residual": found.residual, "starts that agree": found.agreeing(), "spread": float(found.spread[near].max()),
        "light": _shading_error(found.lights.coefficients, given.lights.coefficients) if case.get("unknown") else None,
    }  # fmt: skip
    image = found.image(np.asarray(given.values[:, 0], float))
    return {"row": row, "photograph": image, "normals": found.image(found.normals), "errors": found.image(errors)}


def _shading_error(found: Any, true: Any) -> float:
    """Relative, of radiance of a white Lambert sphere's visible half; of all lights together."""
    z = np.linspace(0.05, 0.95, 10)
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    z, turn = (a.ravel() for a in np.meshgrid(z, turn))
    rim = np.sqrt(1 - z**2)
    normals, view = jnp.asarray(np.stack([rim * np.cos(turn), rim * np.sin(turn), z], 1)), jnp.asarray([0.0, 0.0, 1.0])

    def radiance(coefficients):
        return np.stack([
            np.asarray(reflect(Lambert(1.0), HarmonicLight(c), normals, view)) for c in jnp.asarray(coefficients)
        ])  # fmt: skip

    wanted = radiance(true)
    return float(np.linalg.norm(radiance(found) - wanted) / np.linalg.norm(wanted))


def _light(config: Config, shape: str, material: str) -> dict[str, Any]:
    given = _photographs(config, shape, material, {})
    order = _order(config, material)
    found = light_from_shape(given.values[:, 0], given.truth, brdf=_brdf(material), order=order)
    level = np.sqrt(np.mean(given.values[:, 0] ** 2))
    true = given.lights.coefficients
    return {
        "order": order, "coefficients": (order + 1) ** 2, "determined": int(found.determined.min()),
        "condition": float(found.condition.max()), "residual": float(found.noise.max() / level),
        "error": _shading_error(found.light.coefficients[None], true),
    }  # fmt: skip


def _draw(cases: dict[str, Any]) -> Any:
    figure, axes = plt.subplots(3, len(cases), figsize=(1.5 * len(cases), 4.8), squeeze=False, layout="constrained")
    for column, (name, found) in zip(axes.T, cases.items(), strict=True):
        image = np.broadcast_to(found["photograph"], (*found["photograph"].shape[:2], 3))
        column[0].imshow(plotting.display(image, plotting.exposure(image)))
        column[0].set_title(name, fontsize=7)
        column[1].imshow(np.where(np.any(found["normals"], -1, keepdims=True), (found["normals"] + 1) / 2, 1))
        column[2].imshow(found["errors"], vmin=0, vmax=30, cmap="magma")
        column[2].set_xlabel(f"{found['row']['error']:.1f}°", fontsize=8)
    for ax in axes.ravel():
        ax.set(xticks=[], yticks=[], frame_on=False)
    return figure
