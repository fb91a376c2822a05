"""Are the parameters of analytic BRDFs recovered from noisy samples, by guesses and many starts?

Truths are drawn at random, sampled where highlights and grazing directions are seen alike, disturbed by noise in
proportion to their values, and fitted without any knowledge of them.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

from experiments.config import RecipeConfig
from experiments.recipes._paper import BLUE, ORANGE, plain
from experiments.record import Record
from hshjax import (
    GGX,
    AbstractBRDF,
    BlinnPhong,
    CookTorrance,
    CosineWeighted,
    Lambert,
    MultiStart,
    OrenNayar,
    Outcome,
    SampleMisfit,
    Samples,
    SchlickFresnel,
    Ward,
    initial_guesses,
    multi_start,
)

FAR = 0.1
"""Relative error of a parameter beyond which a truth counts as missed."""


@dataclass(frozen=True)
class Study:
    """A model by the ranges of its truths: `build(*parameters)`; slopes are drawn in equal ratios."""

    build: Callable[..., AbstractBRDF]
    ranges: tuple[tuple[float, float], ...]
    isotropic: bool = True


# Normal albedo of a highlight is its specular, times f0 with Fresnel: of diffuse + highlight, the weaker one always
# holds 5 % or more.
DIFFUSE, SPECULAR, SLOPE = (0.1, 0.6), (0.1, 0.4), (0.05, 0.6)
COATED = (DIFFUSE, SPECULAR, SLOPE)
SCHLICK = (DIFFUSE, (0.4, 0.9), SLOPE, (0.1, 0.6))

STUDIES = {
    "Lambert": Study(Lambert, (DIFFUSE,)),
    "Oren-Nayar": Study(OrenNayar, ((0.1, 0.9), SLOPE)),
    "Oren-Nayar, full": Study(lambda albedo, sigma: OrenNayar(albedo, sigma, full=True), ((0.1, 0.9), SLOPE)),
    "Blinn-Phong + Lambert": Study(lambda d, s, m: Lambert(d) + BlinnPhong(s, 2 / m**2), COATED),
    "Cook-Torrance": Study(CookTorrance, COATED),
    "Cook-Torrance, Schlick": Study(lambda d, s, m, f0: CookTorrance(d, s, m, SchlickFresnel(f0)), SCHLICK),
    "GGX + Lambert": Study(lambda d, s, m: Lambert(d) + GGX(s, m), COATED),
    "GGX + Lambert, Schlick": Study(lambda d, s, m, f0: Lambert(d) + GGX(s, m, SchlickFresnel(f0)), SCHLICK),
    "Ward + Lambert, isotropic": Study(lambda d, s, m: Lambert(d) + Ward(s, m, m), COATED, isotropic=False),
    "Ward + Lambert": Study(lambda d, s, x, y: Lambert(d) + Ward(s, x, y), (*COATED, SLOPE), isotropic=False),
}
Name = Literal[
    "Lambert", "Oren-Nayar", "Oren-Nayar, full", "Blinn-Phong + Lambert", "Cook-Torrance", "Cook-Torrance, Schlick",
    "GGX + Lambert", "GGX + Lambert, Schlick", "Ward + Lambert, isotropic", "Ward + Lambert",
]  # fmt: skip


class Config(RecipeConfig):
    recipe: Literal["recovery"]
    models: Annotated[tuple[Name, ...], Field(min_length=1, description="models to recover")] = tuple(STUDIES)
    truths: Annotated[int, Field(ge=2, description="truths of every model")] = 20
    samples: Annotated[int, Field(ge=10, description="samples of every truth")] = 2000
    noise: Annotated[float, Field(ge=0, description="standard deviation of the noise, relative to the value")] = 0.01
    starts: Annotated[int, Field(ge=1, description="starts of every fit")] = 16


def run(config: Config, record: Record) -> None:
    found = {
        name: record.stage(
            name, recover, STUDIES[name], record.rng(name),
            config.truths, config.samples, config.noise, config.starts, config.dtype,
        )
        for name in record.progress(config.models, "models")
    }  # fmt: skip
    rows = [_row(name, result) for name, result in found.items()]

    record.heading("What was recovered")
    _conclude(config, record, rows)
    record.figure(
        "errors", _draw(found),
        "Relative error of the parameter that is farthest off, a dot for each truth: of the best guess before any step "
        "(open), and of the fit (full). The line is at 10 %, beyond which a truth counts as missed.",
    )  # fmt: skip
    record.table(
        "recovery", rows,
        "Errors are relative, over all truths and parameters; missed: a parameter is off by more than 10 %; stuck: "
        "the loss is above that of the truth itself, so that there was a better optimum; not converged: the step limit "
        "was reached or a number became infinite; starts agreed: mean share of the starts within 0.1 % of the best "
        "loss after screening; steps of the chosen start, screening included; seconds for all truths in one vmapped "
        "call, without and with compilation, on a machine that others may use.",
    )  # fmt: skip


def recover(
    study: Study, rng: np.random.Generator, truths: int, size: int, noise: float, starts: int, dtype: str
) -> dict[str, Any]:
    """Fits to random truths, all in one vmapped call.

    **Returns:** `error` and `guess_error`, relative, `(truths, parameters)`; `loss` and `true_loss`, `(truths,)`;
    `converged`, `agreed` (share of starts), `steps`, each `(truths,)`; `seconds`, `compile_seconds`.
    """
    drawn = [
        np.exp(rng.uniform(*np.log(range_), truths)) if range_ is SLOPE else rng.uniform(*range_, truths)
        for range_ in study.ranges
    ]
    truth = jax.vmap(study.build)(*(jnp.asarray(values, dtype) for values in drawn))
    wi, wo = (jnp.asarray(w, dtype) for w in half_angle_pairs(rng, size, isotropic=study.isotropic))
    clean = eqx.filter_vmap(lambda brdf: brdf(wi, wo))(truth)
    value = clean * jnp.asarray(1 + noise * rng.standard_normal(clean.shape), dtype)
    template = jax.tree.map(lambda leaf: leaf[0], truth)

    def fit_one(value: jax.Array, truth: AbstractBRDF) -> tuple[MultiStart, AbstractBRDF, jax.Array]:
        samples = Samples.scattered(wi, wo, value, isotropic=study.isotropic)
        objective = {"data": SampleMisfit(samples, CosineWeighted())}
        guesses = initial_guesses(template, samples, starts)
        found = multi_start(guesses, objective, throw=False)
        true_loss = jnp.sum(objective["data"](truth) ** 2) / 2
        return found, jax.tree.map(lambda leaf: leaf[0], guesses), true_loss

    begin = time.perf_counter()
    compiled = eqx.filter_jit(eqx.filter_vmap(fit_one)).lower(value, truth).compile()
    middle = time.perf_counter()
    found, guess, true_loss = jax.block_until_ready(compiled(value, truth))
    end = time.perf_counter()
    agreed = jax.vmap(lambda one: one.agreeing() / one.losses.size)(found)
    return {
        "error": _relative(found.best.model, truth),
        "guess_error": _relative(guess, truth),
        "loss": jax.vmap(lambda one: one.best.loss)(found),
        "true_loss": true_loss,
        "converged": jax.vmap(lambda one: one.best.result == Outcome.converged)(found),
        "agreed": agreed,
        "steps": jax.vmap(lambda one: one.steps[one.chosen])(found),
        "seconds": end - middle,
        "compile_seconds": middle - begin,
    }


def half_angle_pairs(rng: np.random.Generator, size: int, *, isotropic: bool) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of directions `(size, 3)` stratified in sqrt(θ_h), θ_d and φ_d, both at least 0.05 above the horizon.

    Half vectors crowd towards the normal, where highlights are. `isotropic` puts them at φ_h = 0, otherwise their
    azimuths are random, too. A stratum holds one point; of those above the horizon, `size` are kept by lot.
    """
    side = int(np.ceil((4 * size) ** (1 / 3)))  # well over a third of the strata lie above the horizon
    cells = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    u, v, w = ((cells + rng.random(cells.shape)) / side).T
    theta_h, theta_d, phi_d = np.pi / 2 * u**2, np.pi / 2 * v, 2 * np.pi * w
    phi_h = np.zeros_like(u) if isotropic else rng.uniform(0, 2 * np.pi, u.size)
    sine, cosine = np.sin(theta_h), np.cos(theta_h)
    h = np.stack([sine * np.cos(phi_h), sine * np.sin(phi_h), cosine], axis=-1)
    across = np.stack([cosine * np.cos(phi_h), cosine * np.sin(phi_h), -sine], axis=-1)
    d = np.stack([np.sin(theta_d) * np.cos(phi_d), np.sin(theta_d) * np.sin(phi_d), np.cos(theta_d)], axis=-1)
    wi = d[:, :1] * across + d[:, 1:2] * np.cross(h, across) + d[:, 2:] * h
    wo = 2 * np.sum(wi * h, axis=1, keepdims=True) * h - wi
    above = np.flatnonzero((wi[:, 2] > 0.05) & (wo[:, 2] > 0.05))
    kept = rng.permutation(above)[:size]
    return wi[kept], wo[kept]


def _relative(model: AbstractBRDF, truth: AbstractBRDF) -> np.ndarray:
    """|parameter - true one| / true one, `(truths, parameters)`."""
    pairs = zip(jax.tree.leaves(model), jax.tree.leaves(truth), strict=True)
    return np.stack([np.abs(np.asarray(a) - np.asarray(b)) / np.asarray(b) for a, b in pairs], axis=1)


def _row(name: str, result: dict[str, Any]) -> dict[str, Any]:
    error = result["error"]
    return {
        "model": name,
        "parameters": error.shape[1],
        "median error": float(np.median(error)),
        "90th percentile": float(np.quantile(error, 0.9)),
        "worst": float(np.max(error)),
        "median error of the guess": float(np.median(result["guess_error"])),
        "missed": int(np.sum(np.max(error, axis=1) > FAR)),
        # Equal but for the last step's tolerance is no other optimum.
        "stuck": int(np.sum(result["loss"] > 1.001 * result["true_loss"])),
        "not converged": int(np.sum(~result["converged"])),
        "starts agreed": float(np.mean(result["agreed"])),
        "median steps": float(np.median(result["steps"])),
        "most steps": int(np.max(result["steps"])),
        "seconds": round(float(result["seconds"]), 2),
        "with compilation": round(float(result["seconds"] + result["compile_seconds"]), 1),
    }


def _conclude(config: Config, record: Record, rows: list[dict[str, Any]]) -> None:
    def total(column: str) -> int:
        return sum(row[column] for row in rows)

    fits = config.truths * len(rows)
    worst = max(rows, key=lambda row: row["median error"])
    record.paragraph(
        f"{config.truths} truths of each of {len(rows)} models, {config.samples} samples with "
        f"{config.noise:.1%} of noise, {config.starts} starts, {config.dtype}. The median relative error of the "
        f"parameters is at most {worst['median error']:.2%} ({worst['model']}). Of {fits} fits, {total('stuck')} are "
        f"stuck in a worse optimum than the truth, {total('not converged')} did not converge, and in "
        f"{total('missed')} a parameter is off by more than {FAR:.0%}. A truth that is missed by a fit that is not "
        "stuck is one that the samples do not tell from the fit: more starts do not help, more samples or a held "
        "parameter do."
    )
    record.paragraph(
        "Truths: diffuse 0.1 to 0.6; specular 0.1 to 0.4, or 0.4 to 0.9 under a Fresnel factor of f0 0.1 to 0.6; "
        "slope, roughness, sigma and Ward's alpha 0.05 to 0.6 in equal ratios, Blinn-Phong's exponent 2 / slope²; "
        "albedo of Oren-Nayar 0.1 to 0.9. Ward's lobe is fitted with two slopes to truths with one, too."
    )
    for row in rows:
        record.metric(f"{row['model']}: median error", row["median error"], note="relative")
        record.metric(f"{row['model']}: 90th percentile", row["90th percentile"], note="relative")
        record.metric(f"{row['model']}: missed", row["missed"], note=f"of {config.truths}")
        record.metric(f"{row['model']}: stuck", row["stuck"], note=f"of {config.truths}")


def _draw(found: dict[str, dict[str, Any]]):
    figure, ax = plt.subplots(figsize=(7.2, 0.8 + 0.5 * len(found)))
    for y, result in enumerate(found.values()):
        for errors, shift, color, face in (
            (result["guess_error"], 0.16, ORANGE, "none"), (result["error"], -0.16, BLUE, BLUE),
        ):  # fmt: skip
            worst = np.maximum(np.max(errors, axis=1), 1e-6)  # of a log axis
            ax.scatter(worst, np.full(worst.shape, y + shift), s=18, edgecolors=color, facecolors=face, linewidths=1)
    ax.axvline(FAR, color="0.5", linestyle="--", linewidth=1)
    ax.set_xscale("log")
    ax.set_yticks(range(len(found)), list(found))
    ax.set_ylim(len(found) - 0.5, -0.5)
    ax.set_xlabel("relative error of the farthest parameter")
    ax.scatter([], [], s=18, edgecolors=ORANGE, facecolors="none", label="best guess")
    ax.scatter([], [], s=18, color=BLUE, label="fit")
    figure.legend(frameon=False, fontsize=8, ncols=2, loc="upper right")
    plain(ax)
    figure.tight_layout()
    return figure
