"""Compact models of measured materials as series for the closed form of Eq. 1: what is lost of BRDF and radiance."""

from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field

from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._blocks import square_blocks
from experiments.recipes._compact_metrics import NODES, POLAR, evaluated
from experiments.recipes._surrogate import read_surrogates
from experiments.record import Record
from hshjax import (
    HSH,
    EnvironmentMap,
    HalfVectorBasis,
    HarmonicLight,
    IdentityWarp,
    IsotropicBasis,
    LinearBRDF,
    LogLinearBRDF,
    LogWarp,
    SphericalHarmonics,
    fit_compact_all,
    reflect,
    to_series,
)
from hshjax.fitting._furnace import furnace_rule
from hshjax.geometry import frame
from hshjax.io import read_exr, read_rgl

ROWS = 64
"""To which environment maps are averaged before their series is taken."""


class Config(RecipeConfig):
    recipe: Literal["harmonic_conversion"]
    folder: Annotated[DataPath, Field(description="folder of *.bsdf files")]
    surrogates: Annotated[DataPath, Field(description="file of networks that stand in for measured materials")]
    environments: Annotated[list[DataPath], Field(min_length=1, description="environment maps")]
    files: Annotated[int | None, Field(ge=1, description="take so many of the files; all without it")] = None
    every: Annotated[int, Field(ge=1, description="take every n-th surrogate")] = 27
    coefficients: Annotated[int, Field(ge=2, description="of a compact model")] = 100
    orders: Annotated[list[int], Field(min_length=1, description="of HSH")] = Field(default=[4, 8, 12])
    light_order: Annotated[int, Field(ge=0, description="to which the environment maps are band-limited")] = 8
    tolerance: Annotated[float, Field(gt=0, description="to which coefficients are to settle")] = 5e-3
    frames: Annotated[int, Field(ge=1, description="ways to turn the surface under a light")] = 64


def run(config: Config, record: Record) -> None:
    materials = _materials(config)
    fitted = record.stage("compact", _compact, config, materials)
    lights = [_light(local_path(text), config.light_order) for text in config.environments]
    turns = np.asarray(frame(jnp.asarray(_unit(record.rng("frames").standard_normal((config.frames, 3))))))
    local = [_turned(light, turns) for light in lights]
    rows = []
    for name, compact in record.progress(zip(materials, fitted, strict=True), "materials"):
        rows += record.stage(name, _rows, config, name, _model(compact), lights, local, turns)

    record.heading("What a series loses of a compact model")
    record.paragraph(
        f"{len(materials)} materials as log-linear models of {config.coefficients} coefficients, converted by "
        "`to_series` to isotropic bases of HSH in norm D, until coefficients move by no more than "
        f"{config.tolerance:g} when the rule is doubled. Radiance: relative root mean square over {config.frames} "
        f"random normals, eyes at {', '.join(f'{x:.0f}' for x in np.degrees(POLAR))} degrees from them, and channels, "
        f"under {len(lights)} environment maps band-limited to order {config.light_order}: the closed form of the "
        "series against the sum of the compact model itself over half vectors."
    )
    record.table(
        "errors", rows,
        "BRDF: relative L2 in norm D, the worst channel. Radiance: the mean over the maps, and the worst. Moved: the "
        "change of the coefficients when the rule was doubled last.",
    )  # fmt: skip
    for order in config.orders:
        own = [row for row in rows if row["order"] == order]
        record.metric(f"order {order}: BRDF", float(np.median([row["BRDF"] for row in own])), note="median")
        record.metric(f"order {order}: radiance", float(np.median([row["radiance"] for row in own])), note="median")


def _materials(config: Config) -> dict[str, Any]:
    paths = sorted(local_path(config.folder).glob("*.bsdf"))[: config.files]
    networks = read_surrogates(local_path(config.surrogates))
    return {path.stem: read_rgl(path) for path in paths} | {
        name: networks[name] for name in list(networks)[:: config.every]
    }


def _compact(config: Config, materials: dict[str, Any]) -> list[dict[str, Any]]:
    kept = []
    for found in fit_compact_all(list(materials.values()), config.coefficients):
        model = found.model
        kept.append({
            "functions": [list(mode) for mode in model.basis.modes], "scale": [found.alpha, found.beta],
            **{name: np.asarray(getattr(model, name)) for name in ("coefficients", "mixing", "low", "high", "terms")},
        })  # fmt: skip
    return kept


def _model(kept: dict[str, Any]) -> LogLinearBRDF:
    alpha, beta = kept["scale"]
    back = IdentityWarp() if beta is None else LogWarp(jnp.asarray(beta))
    basis = HalfVectorBasis(tuple(map(tuple, kept["functions"])), LogWarp(jnp.asarray(alpha)), back)
    parts = (jnp.asarray(kept[name]) for name in ("coefficients", "mixing", "low", "high"))
    return LogLinearBRDF(basis, *parts, terms=kept["terms"])


def _light(path: Any, order: int) -> HarmonicLight:
    image = square_blocks(np.asarray(read_exr(path), float), ROWS).mean((1, 3))
    return HarmonicLight.from_environment(EnvironmentMap(jnp.asarray(image), up="y"), order)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _rows(
    config: Config,
    name: str,
    model: LogLinearBRDF,
    lights: list[HarmonicLight],
    local: list[np.ndarray],
    turns: np.ndarray,
) -> list[dict[str, Any]]:
    largest = max(config.orders)
    found = to_series(model, IsotropicBasis(HSH(largest)), tolerance=config.tolerance)
    size = np.asarray(found.residual / found.relative)
    truth = _radiance(model, lights[0].order, local)
    eyes = np.stack([np.sin(POLAR), 0 * np.sin(POLAR), np.cos(POLAR)], axis=-1)
    normals = jnp.asarray(np.repeat(turns[:, 2], len(POLAR), axis=0))
    view = jnp.asarray(np.einsum("fij,ai->faj", turns, eyes).reshape(-1, 3))
    rows = []
    for order in config.orders:
        # Projections in norm D: a lower order is a prefix, and what was cut off adds to the error.
        basis, coefficients = IsotropicBasis(HSH(order)), np.asarray(found.model.coefficients)
        lost = np.sum((coefficients[basis.count :] / size) ** 2, axis=0)
        series = LinearBRDF(basis, jnp.asarray(coefficients[: basis.count]), found.model.target)
        errors = []
        for light, expected in zip(lights, truth, strict=True):
            radiance = np.asarray(reflect(series, light, normals, view)).reshape(expected.shape)
            errors.append(float(np.linalg.norm(radiance - expected) / np.linalg.norm(expected)))
        rows.append({
            "material": name, "order": order, "numbers": coefficients[: basis.count].size,
            "BRDF": float(np.sqrt(np.asarray(found.relative) ** 2 + lost).max()),
            "radiance": float(np.mean(errors)), "radiance, worst map": max(errors),
            "moved": float(found.quadrature_error), "rule": found.method,
        })  # fmt: skip
    return rows


def _turned(light: HarmonicLight, turns: np.ndarray) -> np.ndarray:
    """Its coefficients in each frame, `(frames, modes, channels)`."""
    return np.asarray(jax.jit(jax.vmap(lambda turn: light.rotated(turn).coefficients))(jnp.asarray(turns)))


def _radiance(model: LogLinearBRDF, order: int, local: list[np.ndarray]) -> list[np.ndarray]:
    """Of the model itself, `(frames, angles, channels)` for each light: sums over half vectors about each normal."""
    functions, moments = SphericalHarmonics(order), []
    for angle in POLAR:
        wi, wo, weight = furnace_rule(angle, NODES)
        value = evaluated(model, wi, np.broadcast_to(wo, wi.shape))
        moments.append(np.asarray(functions(jnp.asarray(wi))).T @ (weight[:, None] * value))
    return [np.einsum("fkc,akc->fac", of_light, np.stack(moments)) for of_light in local]
