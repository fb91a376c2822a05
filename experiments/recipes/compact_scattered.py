"""Are error bars of compact models right? Few and scattered samples, of known noise and as they were measured.

Each model sees a part of the samples; the others tell how many of them lie inside its intervals.
"""

from collections import defaultdict
from collections.abc import Callable
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._compact_metrics import LARGEST, log_error
from experiments.recipes._paper import BLUE, ORANGE, plain
from experiments.recipes._surrogate import Surrogate, read_surrogates
from experiments.record import Record
from hshjax import CompactPosterior, Samples, fit_compact, infer_compact
from hshjax.geometry import from_half_difference

LEVEL = 0.9

TUNED = 4
"""Every so many surrogates were looked at while the prior was chosen: they are left out."""


class Config(RecipeConfig):
    recipe: Literal["compact_scattered"]
    surrogates: Annotated[DataPath, Field(description="file of networks that stand in for measured materials")]
    measured: Annotated[DataPath, Field(description="file of measured values at random pairs")]
    every: Annotated[int, Field(ge=1, description="take every n-th of the surrogates that were not tuned on")] = 4
    sizes: Annotated[tuple[int, ...], Field(min_length=1, description="numbers of samples")] = (50, 200, 1000)
    held_out: Annotated[int, Field(ge=10, description="samples that judge; of measured pairs, all that are left")] = (
        1000
    )
    noise: Annotated[float, Field(gt=0, description="of samples of the surrogates, relative to the value")] = 0.05
    additive: Annotated[float, Field(ge=0, description="of the same, beside it [sr^-1]")] = 1e-3
    functions: Annotated[int, Field(ge=1, description="of the basis, in every channel")] = 150
    plain: Annotated[int, Field(ge=3, description="coefficients of the fit beside it; fewer for few samples")] = 150


def run(config: Config, record: Record) -> None:
    rows: list[dict[str, Any]] = []
    networks = read_surrogates(local_path(config.surrogates))
    names = [name for k, name in enumerate(networks) if k % TUNED][:: config.every]
    arguments = {name: (config, name, networks[name], record.rng(name)) for name in names}
    for found in record.stage_each(arguments, _surrogate, "surrogates"):
        rows += found
    with np.load(local_path(config.measured)) as file:
        pairs = {key: np.asarray(file[key], float) for key in file}
    measured = {name: (config, name, pairs, record.rng(name)) for name in pairs if name not in ("wi", "wo")}
    for found in record.stage_each(measured, _measured, "measured materials"):
        rows += found
    summary = _summary(rows)
    record.paragraph(
        f"{len(names)} networks that stand in for MERL, none of those that the prior was chosen on, with noise of "
        f"{config.noise:.0%} of the value and {config.additive:g} sr^-1 beside it (standard deviations); and random "
        "pairs of measured materials (RGL) with the noise and the departure from reciprocity that they have. "
        "Directions below 80 degrees: pairs, uniform over both hemispheres; angles, uniform in θ_h, θ_d and φ_d. "
        f"Models are those of `hshjax.infer_compact`; intervals are meant to hold {LEVEL:.0%}. Surrogates are told "
        "their relative noise, measured materials are not."
    )
    record.table(
        "summary", summary,
        "inside: share of held-out samples (all channels) within the intervals of new samples: median and worst "
        "materials, and in how many of them it is between 85 and 95 %. surface: share of noiseless values within the "
        "intervals of the surface: median, worst. width: high over low of the surface, of the median pair. log: 1000 x "
        "mean |Δ ln(1 + ρ cos θ)| over held-out pairs against noiseless values (measured ones where there are none), "
        "channels and cosines; plain: the same of `hshjax.fit_compact`, energy unconstrained. All but the worst are "
        "medians over materials.",
    )  # fmt: skip
    record.figure(
        "coverage", _draw(summary, rows),
        "Share of held-out samples inside 90 % intervals: every material, and medians (lines). The band is 85 to 95 %.",
    )  # fmt: skip
    record.table("materials", rows, "Each material; factor: by what deviations were scaled; alpha: the warp's scale.")
    for row in summary:
        label = f"{row['database']}, {row['design']}, {row['samples']} samples"
        record.metric(f"{label}: inside", row["inside"], note="median")
        record.metric(f"{label}: inside, least", row["least"])
        record.metric(f"{label}: log", row["log"], note="median")


def pairs_uniform(rng: np.random.Generator, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs `(size, 3)` uniform over two hemispheres, as far as 80 degrees."""
    z = rng.uniform(np.cos(LARGEST), 1, (2, size))
    azimuth = rng.uniform(0, 2 * np.pi, (2, size))
    rim = np.sqrt(1 - z**2)
    wi, wo = np.stack([rim * np.cos(azimuth), rim * np.sin(azimuth), z], axis=-1)
    return wi, wo


def angles_uniform(rng: np.random.Generator, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs `(size, 3)` uniform in θ_h, θ_d and φ_d, both directions below 80 degrees."""
    half, difference, azimuth = rng.uniform(0, [[np.pi / 2], [np.pi / 2], [2 * np.pi]], (3, 12 * size))
    wi, wo = (np.asarray(w) for w in from_half_difference(*map(jnp.asarray, (half, difference, azimuth))))
    kept = np.flatnonzero(np.minimum(wi[:, 2], wo[:, 2]) > np.cos(LARGEST))[:size]
    return wi[kept], wo[kept]


DESIGNS: dict[str, Callable] = {"pairs": pairs_uniform, "angles": angles_uniform}


def _surrogate(config: Config, name: str, network: Surrogate, rng: np.random.Generator) -> list[dict[str, Any]]:
    rows = []
    for design, draw in DESIGNS.items():
        for size in config.sizes:
            wi, wo = draw(rng, size + config.held_out)
            truth = np.maximum(np.asarray(network(jnp.asarray(wi), jnp.asarray(wo))), 0)
            noise = config.noise * truth * rng.standard_normal(truth.shape)
            value = truth + noise + config.additive * rng.standard_normal(truth.shape)
            known = {"database": "MERL", "design": design, "samples": size, "material": name}
            rows.append(known | _judged(config, wi, wo, value, truth, size, config.noise))
    return rows


def _measured(
    config: Config, name: str, pairs: dict[str, np.ndarray], rng: np.random.Generator
) -> list[dict[str, Any]]:
    rows = []
    for size in config.sizes:
        order = rng.permutation(len(pairs["wi"]))
        wi, wo, value = (pairs[key][order] for key in ("wi", "wo", name))
        known = {"database": "RGL", "design": "pairs", "samples": size, "material": name}
        rows.append(known | _judged(config, wi, wo, value, None, size, None))
    return rows


def _judged(
    config: Config, wi: np.ndarray, wo: np.ndarray, value: np.ndarray, truth: np.ndarray | None, size: int, noise
) -> dict[str, Any]:
    """Figures of a model of the first samples on all others."""
    seen = Samples.scattered(*(jnp.asarray(part[:size]) for part in (wi, wo, value)), isotropic=True)
    found = infer_compact(seen, config.functions, noise=noise)
    beside = fit_compact(seen, min(config.plain, size // 2), energy=False).model
    a, b = wi[size:], wo[size:]
    goal = value[size:] if truth is None else truth[size:]
    low, high = _bounds(found, a, b, noise=False)
    return {
        "inside": _share(value[size:], _bounds(found, a, b, noise=True)),
        "surface": None if truth is None else _share(goal, (low, high)),
        "width": float(np.median(high / low)),
        "log": log_error(np.maximum(goal, 0), np.asarray(found.model(a, b)), a, b),
        "plain": log_error(np.maximum(goal, 0), np.asarray(beside(a, b)), a, b),
        "factor": float(found.factor), "alpha": found.alpha, "noise": found.noise, "dark": found.dark,
    }  # fmt: skip


def _bounds(found: CompactPosterior, wi: np.ndarray, wo: np.ndarray, *, noise: bool) -> tuple[np.ndarray, np.ndarray]:
    low, high = found.interval(jnp.asarray(wi), jnp.asarray(wo), LEVEL, noise=noise)
    return np.asarray(low), np.asarray(high)


def _share(value: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> float:
    return float(np.mean((value >= bounds[0]) & (value <= bounds[1])))


def _summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    groups = defaultdict(list)
    for row in rows:
        groups[row["database"], row["design"], row["samples"]].append(row)
    found = []
    for (database, design, samples), group in groups.items():
        column = {key: [row[key] for row in group if row[key] is not None] for key in group[0]}
        inside, surface = column["inside"], column["surface"]
        found.append({
            "database": database, "design": design, "samples": samples, "materials": len(group),
            "inside": float(np.median(inside)), "least": min(inside), "most": max(inside),
            "in 85 to 95 %": int(np.sum((np.array(inside) >= 0.85) & (np.array(inside) <= 0.95))),
            "surface": float(np.median(surface)) if surface else None, "surface, least": min(surface, default=None),
            "width": float(np.median(column["width"])), "log": float(np.median(column["log"])),
            "log, worst": max(column["log"]), "plain": float(np.median(column["plain"])),
            "plain, worst": max(column["plain"]),
        })  # fmt: skip
    return found


def _draw(summary: list[dict[str, Any]], rows: list[dict[str, Any]]) -> Any:
    figure, ax = plt.subplots(figsize=(7.2, 0.9 + 0.42 * len(summary)), layout="constrained")
    ax.axvspan(0.85, 0.95, color="0.92")
    ax.axvline(LEVEL, color="0.6", linewidth=1)
    labels = []
    for y, group in enumerate(summary):
        key = [group[part] for part in ("database", "design", "samples")]
        shares = [row["inside"] for row in rows if [row[part] for part in ("database", "design", "samples")] == key]
        color = BLUE if group["database"] == "MERL" else ORANGE
        ax.plot(shares, np.full(len(shares), y), "o", color=color, markersize=4, alpha=0.5, markeredgewidth=0)
        ax.plot([group["inside"]] * 2, [y - 0.3, y + 0.3], color=color, linewidth=2)
        labels.append(f"{key[0]}, {key[1]}, {key[2]}")
    ax.set_yticks(range(len(labels)), labels)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_xlabel("share of held-out samples inside")
    plain(ax)
    return figure
