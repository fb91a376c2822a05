"""Measured materials and their surrogates by linear, positive, valid and parametric models: errors, validity, time."""

import time
from collections.abc import Callable
from typing import Annotated, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

import hshjax
from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._material import joint_error, negative_share
from experiments.recipes._paper import BLUE, GREEN, ORANGE, RED, plain
from experiments.recipes._surrogate import read_surrogates
from experiments.record import Record
from hshjax import (
    GGX,
    HSH,
    CookTorrance,
    CosineWeighted,
    ExpBRDF,
    IsotropicBasis,
    Lambert,
    LinearBRDF,
    SampleMisfit,
    Samples,
    Smoothness,
    Zernike,
    fit,
    initial_guesses,
    isotropic_pair_rule,
    multi_start,
    positive_start,
    project,
    project_all,
)
from hshjax.geometry import direction
from hshjax.io import read_rgl

NORM = "A"
CONSTRAINTS = ("non_negative", "energy")
FIGURES = {
    "error": "cosine-weighted L2, relative, norm A",
    "log error": "mean |Δ log(1 + ρ cos θi cos θo)| over dω_i dω_o",
    "negative energy": "share of ∫∫ |ρ| cos cos that is negative",
    "smallest value": "[1/sr]",
    "largest albedo": "directional, over θo from 0 to 89°",
}


class Config(RecipeConfig):
    recipe: Literal["measured_fits"]
    folder: Annotated[DataPath, Field(description="folder of *.bsdf files")]
    surrogates: Annotated[DataPath, Field(description="file of networks that stand in for measured materials")]
    every: Annotated[int, Field(ge=1, description="take every n-th material of each kind")] = 1
    order: Annotated[int, Field(ge=1, description="order of HSH")] = 8
    degree: Annotated[int, Field(ge=2, description="degree of the rule that samples a material")] = 32
    judge_degree: Annotated[int, Field(ge=2, description="degree of the rule that judges the fits")] = 48
    ridge: Annotated[
        float, Field(ge=0, description="weight of the smoothness of exp-HSH, relative to the energy of the data")
    ] = 1e-6
    starts: Annotated[int, Field(ge=1, description="starts of each parametric fit")] = 4
    repeats: Annotated[int, Field(ge=1, description="interleaved repeats of each timing")] = 3


def run(config: Config, record: Record) -> None:
    materials = _materials(config)
    rule = isotropic_pair_rule(config.degree)
    samples = {name: Samples.from_function(brdf, rule) for name, brdf in materials.items()}
    judge = isotropic_pair_rule(config.judge_degree)
    truth = {name: Samples.from_function(brdf, judge) for name, brdf in materials.items()}

    models = _models(config)
    rows = []
    for label, fitter in record.progress(models.items(), "models"):
        kept = record.stage(label, fitter, list(samples.values()))
        rows += record.stage(f"{label} judged", _judge, label, kept, truth)
    summary = _summary(rows, list(models))

    record.heading("What was fitted, and to what")
    record.paragraph(
        f"{len(materials)} materials: those measured in `{config.folder}` and the networks of `{config.surrogates}`, "
        f"three channels each, sampled at the {rule.weight.size} nodes of an isotropic rule of degree {config.degree} "
        f"over the whole hemispheres and judged at the {judge.weight.size} nodes of another of degree "
        f"{config.judge_degree}. Linear models minimise norm A; exp-HSH and the parametric ones minimise the "
        f"cosine-weighted difference (norm D), exp-HSH with a smoothness of weight {config.ridge:g} relative to the "
        f"energy of the data. That weight was chosen by looking at some of these materials; nothing else was "
        f"tuned. Parametric fits take the best of {config.starts} starts. Coefficients are per material of three "
        "channels."
    )
    record.table(
        "summary", summary,
        "Medians over the materials, and the worst material for validity. " + "; ".join(
            f"{name}: {meaning}" for name, meaning in FIGURES.items()
        ) + ".",
    )  # fmt: skip
    record.figure("errors", _draw(rows, list(models)), "Every material: relative error, sorted for each model.")
    record.table("materials", rows, "Every material and model.")
    for row in summary:
        record.metric(f"{row['model']}: error", row["error"], note="median over materials")
        record.metric(f"{row['model']}: smallest value", row["smallest value"], "1/sr", "of all materials")
        record.metric(f"{row['model']}: largest albedo", row["largest albedo"], note="of all materials")

    record.heading("One call or many")
    times = record.stage("times", _times, config, list(samples.values()))
    record.table(
        "times", times,
        "Seconds for all materials, compiled, median of interleaved repeats on the machine of the manifest. Linear: "
        "one factorisation for all against a jitted projection each. Parametric: one vmapped call against jitted ones, "
        "from the best guess alone and from several starts.",
    )  # fmt: skip


def _materials(config: Config) -> dict[str, Any]:
    measured = {path.stem: read_rgl(path) for path in sorted(local_path(config.folder).glob("*.bsdf"))}
    networks = read_surrogates(local_path(config.surrogates))
    return {name: kind[name] for kind in (measured, networks) for name in list(kind)[:: config.every]}


def _nearest_zernike(count: int) -> IsotropicBasis:
    """The isotropic Zernike basis whose count is nearest."""
    return min((IsotropicBasis(Zernike(order)) for order in range(1, 33)), key=lambda basis: abs(basis.count - count))


def _models(config: Config) -> dict[str, Callable[[list[Samples]], dict[str, Any]]]:
    """Fitters by label: from the samples of all materials to the arrays that `_rebuilt` makes models of."""
    hsh = IsotropicBasis(HSH(config.order))
    zernike = _nearest_zernike(hsh.count)
    return {
        f"HSH {config.order}": lambda samples: _linear(hsh, samples),
        f"{zernike.basis}".replace("(order=", " ").rstrip(")"): lambda samples: _linear(zernike, samples),
        f"HSH {config.order}, valid": lambda samples: _linear(hsh, samples, CONSTRAINTS),
        f"exp-HSH {config.order}": lambda samples: _exponential(hsh, samples, config.ridge),
        "Cook-Torrance + diffuse": lambda samples: _parametric(COOK_TORRANCE, samples, config.starts),
        "GGX + diffuse": lambda samples: _parametric(GGX_DIFFUSE, samples, config.starts),
    }


ZERO = np.zeros(3)
COOK_TORRANCE = CookTorrance(ZERO, ZERO, 0.3)
GGX_DIFFUSE = Lambert(ZERO) + GGX(ZERO, 0.3)


def _linear(basis: IsotropicBasis, samples: list[Samples], constraints: tuple[str, ...] = ()) -> dict[str, Any]:
    start = time.perf_counter()
    fits = project_all(basis, samples, norm=NORM, constraints=constraints)
    coefficients = np.stack([np.asarray(found.model.coefficients) for found in fits])
    seconds = time.perf_counter() - start
    out = {"kind": "linear", "family": type(basis.basis).__name__, "order": basis.basis.order, "seconds": seconds}
    if constraints:
        out["certified"] = [bool(found.certificate.holds) for found in fits]
    return out | {"coefficients": coefficients}


def _exponential(basis: IsotropicBasis, samples: list[Samples], ridge: float) -> dict[str, Any]:
    first = samples[0]

    # Channels do not touch: each is a fit of its own, all of a material in one batch.
    @jax.jit
    @jax.vmap
    def fitted(value):
        data = Samples(first.wi, first.wo, value[:, None], first.weight)
        energy = jnp.sum(first.weight * (first.wi[:, 2] * first.wo[:, 2] * value) ** 2)
        objective = {"data": SampleMisfit(data, CosineWeighted()), "smooth": ridge * energy * Smoothness()}
        found = fit(positive_start(ExpBRDF, basis, data), objective, throw=False)
        return found.model.coefficients[:, 0], found.result == hshjax.Outcome.converged

    start = time.perf_counter()
    coefficients, converged = zip(*(fitted(one.value.T) for one in samples), strict=True)
    coefficients = np.stack([np.asarray(c).T for c in coefficients])
    return {
        "kind": "exp", "family": "HSH", "order": basis.basis.order, "coefficients": coefficients,
        "converged": np.asarray(converged).all(axis=1).tolist(), "seconds": time.perf_counter() - start,
    }  # fmt: skip


def _parametric_fitter(template: Any, first: Samples, starts: int) -> Callable[[Any], Any]:
    """From the values of a material to its best fit."""

    def fitted(value):
        data = Samples(first.wi, first.wo, value, first.weight)
        objective = {"data": SampleMisfit(data, CosineWeighted())}
        guesses = initial_guesses(template, data, starts)
        if starts == 1:
            return fit(jax.tree.map(lambda leaf: leaf[0], guesses), objective, throw=False)
        return multi_start(guesses, objective, throw=False).best

    return fitted


def _parametric(template: Any, samples: list[Samples], starts: int) -> dict[str, Any]:
    begin = time.perf_counter()
    values = jnp.stack([one.value for one in samples])
    found = eqx.filter_jit(eqx.filter_vmap(_parametric_fitter(template, samples[0], starts)))(values)
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(found.model)]
    return {
        "kind": "Cook-Torrance" if template is COOK_TORRANCE else "GGX", "leaves": leaves,
        "converged": np.asarray(found.result == hshjax.Outcome.converged).tolist(),
        "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def _rebuilt(kept: dict[str, Any], k: int) -> tuple[Any, int]:
    """The model of the k-th material, and its number of coefficients for three channels."""
    if kept["kind"] in ("linear", "exp"):
        basis = IsotropicBasis(getattr(hshjax, kept["family"])(kept["order"]))
        coefficients = jnp.asarray(kept["coefficients"][k])
        return (LinearBRDF if kept["kind"] == "linear" else ExpBRDF)(basis, coefficients), coefficients.size
    template = COOK_TORRANCE if kept["kind"] == "Cook-Torrance" else GGX_DIFFUSE
    leaves = [jnp.asarray(leaf[k]) for leaf in kept["leaves"]]
    return jax.tree.unflatten(jax.tree.structure(template), leaves), sum(leaf.size for leaf in leaves)


def _judge(label: str, kept: dict[str, Any], truth: dict[str, Samples]) -> list[dict[str, Any]]:
    rows = []
    theta = jnp.deg2rad(jnp.asarray([*range(0, 90, 5), 89.0]))
    wo = direction(theta, jnp.zeros_like(theta))
    for k, (name, samples) in enumerate(truth.items()):
        model, count = _rebuilt(kept, k)
        value = np.asarray(model(samples.wi, samples.wo))
        data = np.asarray(samples.value)
        cosines = np.asarray(samples.wi[:, 2] * samples.wo[:, 2])[:, None]
        solid = np.asarray(samples.weight)[:, None]
        shaded, expected = (np.maximum(x * cosines, -0.99) for x in (value, data))
        rows.append({
            "material": name, "model": label, "coefficients": count,
            "error": joint_error(value, samples, NORM),
            "log error": float(np.sum(solid * np.abs(np.log1p(shaded) - np.log1p(expected))) / np.sum(solid) / 3),
            "negative energy": negative_share(value, samples),
            "smallest value": float(value.min()),
            "largest albedo": float(jnp.max(hshjax.albedo(model, wo))),
            "converged": bool(kept["converged"][k]) if "converged" in kept else True,
            "certified": bool(kept["certified"][k]) if "certified" in kept else "",
            "seconds": kept["seconds"] / len(truth),
        })  # fmt: skip
    return rows


def _summary(rows: list[dict[str, Any]], labels: list[str]) -> list[dict[str, Any]]:
    summary = []
    for label in labels:
        own = [row for row in rows if row["model"] == label]
        middle = {key: float(np.median([row[key] for row in own])) for key in ("error", "log error", "negative energy")}
        summary.append({
            "model": label, "coefficients": own[0]["coefficients"], **middle,
            "smallest value": min(row["smallest value"] for row in own),
            "largest albedo": max(row["largest albedo"] for row in own),
            "not converged": sum(not row["converged"] for row in own),
            "not certified": sum(row["certified"] is False for row in own),
            "seconds a material": own[0]["seconds"],
        })  # fmt: skip
    return summary


def _times(config: Config, samples: list[Samples]) -> list[dict[str, Any]]:
    first, basis = samples[0], IsotropicBasis(HSH(config.order))
    alone = jax.jit(lambda value: project(basis, Samples(first.wi, first.wo, value, first.weight), norm=NORM).model)
    values = [one.value for one in samples]
    cases = {
        "linear": (
            lambda: [found.model.coefficients for found in project_all(basis, samples, norm=NORM)],
            lambda: [alone(value).coefficients for value in values],
        )
    }
    for name, template in (("Cook-Torrance + diffuse", COOK_TORRANCE), ("GGX + diffuse", GGX_DIFFUSE)):
        for starts in dict.fromkeys((1, config.starts)):
            fitted = _parametric_fitter(template, first, starts)
            one, many = eqx.filter_jit(fitted), eqx.filter_jit(eqx.filter_vmap(fitted))
            cases[f"{name}, {'the best guess' if starts == 1 else f'{starts} starts'}"] = (
                lambda many=many: many(jnp.stack(values)).loss,
                lambda one=one: [one(value).loss for value in values],
            )
    rows = []
    for name, (together, each) in cases.items():
        seconds = {"together": [], "each": []}
        for repeat in range(config.repeats + 1):
            for key, call in (("together", together), ("each", each)):
                start = time.perf_counter()
                jax.block_until_ready(call())
                if repeat > 0:  # the first compiles
                    seconds[key].append(time.perf_counter() - start)
        middle = {key: float(np.median(series)) for key, series in seconds.items()}
        rows.append({"fits": name, **middle, "ratio": middle["each"] / middle["together"]})
    return rows


def _draw(rows: list[dict[str, Any]], labels: list[str]) -> Any:
    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    colours = (BLUE, ORANGE, BLUE, GREEN, RED, "black")
    for label, colour, style in zip(labels, colours, ("-", "-", "--", "-", "-", "-"), strict=True):
        errors = sorted(row["error"] for row in rows if row["model"] == label)
        axes.semilogy(np.arange(1, len(errors) + 1), errors, style, color=colour, lw=1.3, label=label)
    axes.set(xlabel="materials, sorted by error", ylabel="relative error, norm A")
    axes.legend(frameon=False, fontsize=8)
    plain(axes)
    return figure
