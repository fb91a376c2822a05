"""Claim 6: samples that violate reciprocity are filtered by projecting them on a reciprocal basis.

All norms are D: of g = z_i z_o ρ for dω_i dω_o, the one in which the projection is orthogonal. The rules used are
symmetric under the swap of wi and wo, so that reciprocal and antireciprocal parts of samples are exact and orthogonal.
"""

import math
import os
from pathlib import Path
from typing import Annotated, Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

from experiments.config import DATA_VARIABLE, RecipeConfig
from experiments.recipes._paper import BLUE, GREEN, ORANGE, PAPER_BRDFS, RED, TITLES, paper_brdf, plain
from experiments.record import Record
from hshjax import HSH, HelmholtzBasis, IsotropicBasis, Samples, TensorBasis, isotropic_pair_rule, pair_rule, project
from hshjax.io import read_rgl

PAIRS = {"tensor (control)": TensorBasis, "Helmholtz": HelmholtzBasis, "isotropic": IsotropicBasis}
COSINE_70 = math.cos(math.radians(70))
KINDS = ("reciprocal", "antireciprocal", "both")


Name = Literal["CT_spec_Fconst", "OrenNayar_s0.3"]
Orders = Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)]


class Config(RecipeConfig):
    recipe: Literal["reciprocity_filter"]
    orders: Annotated[Orders, Field(description="orders of HSH, noise")] = (2, 4)
    brdfs: Annotated[tuple[Name, ...], Field(min_length=1, description="surfaces under noise")] = PAPER_BRDFS
    levels: Annotated[tuple[float, ...], Field(min_length=1, description="size of the noise, relative to truth")] = (
        0.03, 0.1, 0.3,
    )  # fmt: skip
    degree: Annotated[int, Field(ge=2, description="degree of the pair rule of the noisy samples")] = 20
    folder: Annotated[str, Field(description="*.bsdf files in this folder of the measured data")] = "rgl"
    measured_orders: Annotated[Orders, Field(description="of HSH, measured")] = (2, 4, 8, 12, 16)
    measured_degree: Annotated[int, Field(ge=2, description="degree of the isotropic rule of the measured samples")] = (
        64
    )


def run(config: Config, record: Record) -> None:
    rows = record.stage("noise", _noise, config, record)
    measured = _measured_files(config)
    found = record.stage("measured", _measured, config, [str(path) for path in measured]) if measured else []

    record.heading("The claim and the measurement")
    _conclude_noise(record, config, rows)
    _conclude_measured(record, config, found)
    record.heading("Noise of known size")
    record.figure(
        "noise", _draw_noise(config, rows),
        "Distance to the truth after the fit against the size of the noise, half of its energy antireciprocal. "
        "Dashed: before the fit.",
    )  # fmt: skip
    record.table("noise", rows, "Everything relative to the truth, in norm D. after² = approximation² + noise kept².")
    if found:
        record.heading("Measured materials")
        record.figure(
            "measured", _draw_measured(found),
            "Change of a measurement by its reciprocal fit, and the part of it that is the filter (dashed, the same "
            "at every order); the rest is approximation error.",
        )  # fmt: skip
        record.table(
            "measured", found,
            "Relative to the measurement, in norm D. change² = filtered² + approximation²; filter share = "
            "filtered²/change².",
        )  # fmt: skip


# Noise of known size


def _noise(config: Config, record: Record) -> list[dict[str, Any]]:
    rule = pair_rule(config.degree)
    n = round(rule.weight.size**0.5)
    cosines = np.asarray(rule.wi[:, 2] * rule.wo[:, 2])
    weight = np.asarray(rule.weight)
    white = record.rng("noise").standard_normal((n, n))
    parts = {"reciprocal": (white + white.T) / 2, "antireciprocal": (white - white.T) / 2}
    parts["both"] = parts["reciprocal"] / _size(weight, parts["reciprocal"]) + parts["antireciprocal"] / _size(
        weight, parts["antireciprocal"]
    )
    noises = [level * parts[kind].ravel() / _size(weight, parts[kind]) for kind in KINDS for level in config.levels]

    rows = []
    for name in config.brdfs:
        truth = cosines * np.asarray(paper_brdf(name)(rule.wi, rule.wo))[:, 0]
        truth /= _size(weight, truth)
        # One channel a noise, the truth itself first: one projection serves all.
        noisy = np.stack([truth, *(truth + noise for noise in noises)], axis=1)
        samples = Samples(rule.wi, rule.wo, noisy / cosines[:, None], rule.weight, rule.degree, rule.isotropic)
        for order in config.orders:
            for label, family in PAIRS.items():
                basis = family(HSH(order))
                model = project(basis, samples, norm="D", reciprocity=False).model
                fit = np.asarray(basis.evaluate(model.coefficients, rule.wi, rule.wo))
                approximation = _size(weight, fit[:, 0] - truth)
                for k, (kind, level) in enumerate(((kind, level) for kind in KINDS for level in config.levels), 1):
                    rows.append({
                        "brdf": TITLES[name], "order": order, "basis": label, "coefficients": basis.count,
                        "noise": kind, "level": level,
                        "violation before": _violation(weight, noisy[:, k]),
                        "violation after": _violation(weight, fit[:, k]),
                        "distance before": _size(weight, noisy[:, k] - truth),
                        "distance after": _size(weight, fit[:, k] - truth),
                        "approximation": approximation,
                        "noise kept": _size(weight, fit[:, k] - fit[:, 0]),
                    })  # fmt: skip
    return rows


def _size(weight: np.ndarray, values: np.ndarray) -> float:
    """sqrt(Σ w g²)."""
    return float(np.sqrt(np.sum(weight * values.ravel() ** 2)))


def _violation(weight: np.ndarray, g: np.ndarray) -> float:
    """Norm of g(wi, wo) - g(wo, wi) over that of g, on a product rule."""
    n = round(g.size**0.5)
    return _size(weight, g.reshape(n, n) - g.reshape(n, n).T) / _size(weight, g)


# Measured materials


def _measured_files(config: Config) -> list[Path]:
    folder = os.environ.get(DATA_VARIABLE)
    return sorted((Path(folder) / config.folder).glob("*.bsdf")) if folder else []


def _measured(config: Config, paths: list[str]) -> list[dict[str, Any]]:
    degree = max(config.measured_degree, 2 * max(config.measured_orders))
    rule = isotropic_pair_rule(degree)
    polar = degree // 2 + 1
    cosines = np.asarray(rule.wi[:, 2] * rule.wo[:, 2])[:, None]
    weight = np.asarray(rule.weight)[:, None]
    rows = []
    for path in paths:
        samples = read_rgl(path).samples(rule)
        g = cosines * np.asarray(samples.value)
        cube = g.reshape(polar, polar, -1, g.shape[1])
        # The swap is (z_i, z_o, Δφ) -> (z_o, z_i, -Δφ); node 0 of the azimuths is Δφ = 0.
        swapped = np.roll(cube.transpose(1, 0, 2, 3)[:, :, ::-1], 1, axis=2)
        reciprocal = ((cube + swapped) / 2).reshape(g.shape)

        def size(values):
            return float(np.sqrt(np.sum(weight * values**2)))

        total = size(g)
        # Away from the directions that the database extrapolates: is the violation one of the measurement?
        low = (np.asarray(rule.wi[:, 2]) > COSINE_70) & (np.asarray(rule.wo[:, 2]) > COSINE_70)
        inner = size(low[:, None] * (g - swapped.reshape(g.shape))) / size(low[:, None] * g)
        for order in config.measured_orders:
            basis = IsotropicBasis(HSH(order))
            model = project(basis, samples, norm="D", reciprocity=False).model
            fit = np.asarray(basis.evaluate(model.coefficients, rule.wi, rule.wo))
            fit_cube = fit.reshape(cube.shape)
            fit_swapped = np.roll(fit_cube.transpose(1, 0, 2, 3)[:, :, ::-1], 1, axis=2)
            change, filtered = size(fit - g) / total, size(reciprocal - g) / total
            rows.append({
                "material": Path(path).stem, "order": order, "coefficients": basis.count,
                "violation before": size((cube - swapped).reshape(g.shape)) / total,
                "violation before, θ < 70°": inner,
                "violation after": size((fit_cube - fit_swapped).reshape(g.shape)) / size(fit),
                "change": change, "filtered": filtered, "approximation": size(fit - reciprocal) / total,
                "filter share": filtered**2 / change**2,
            })  # fmt: skip
    return rows


# Words and pictures


def _conclude_noise(record: Record, config: Config, rows: list[dict[str, Any]]) -> None:
    reciprocal = [row for row in rows if row["basis"] != "tensor (control)"]
    control = [row for row in rows if row["basis"] == "tensor (control)"]
    worst = max(row["violation after"] for row in reciprocal)
    mixed = [row for row in rows if row["noise"] == "both"]
    kept = {
        label: float(np.mean([row["noise kept"] / row["distance before"] for row in mixed if row["basis"] == label]))
        for label in PAIRS
    }
    passed = max(row["noise kept"] / row["distance before"] for row in reciprocal if row["noise"] == "antireciprocal")
    worse = [row for row in reciprocal if row["distance after"] > row["distance before"]]
    record.paragraph(
        "The paper states that measurements which violate Helmholtz reciprocity are filtered by projecting them on "
        "its basis. That is so by construction: with added noise, the violation of the fits in the reciprocal bases "
        f"is at most {worst:.1e} of their norm, where it was up to "
        f"{max(row['violation before'] for row in reciprocal):.2f} in the samples; purely antireciprocal noise is "
        f"removed to a share of {passed:.1e}. The control, all products of HSH without symmetry, keeps violations of "
        f"up to {max(row['violation after'] for row in control):.2e}. Reciprocity is the smaller part of the "
        "denoising, though: any basis of low order rejects most white noise. Of noise with equal reciprocal and "
        f"antireciprocal energy the control keeps {kept['tensor (control)']:.1%} in norm, the Helmholtz basis "
        f"{kept['Helmholtz']:.1%} and the isotropic one {kept['isotropic']:.1%}. And a filter is also an "
        f"approximation: in {len(worse)} of {len(reciprocal)} cases the fit is further from the truth than the noisy "
        "samples were, because the basis cannot say the surface at this order, above all the highlight of "
        "Cook-Torrance."
    )
    record.metric("violation after, reciprocal bases", worst, note="largest, relative, norm D")
    record.metric("violation after, control", max(row["violation after"] for row in control))
    for label, value in kept.items():
        record.metric(f"noise kept, {label}", value, note="mean over cases with both kinds of noise")
    record.metric("fits further from the truth than the samples", len(worse), note=f"of {len(reciprocal)}")


def _conclude_measured(record: Record, config: Config, found: list[dict[str, Any]]) -> None:
    if not found:
        why = (
            f"no *.bsdf file lies in its folder {config.folder}"
            if os.environ.get(DATA_VARIABLE)
            else f"the environment variable {DATA_VARIABLE}, the folder of measured data, is not set"
        )
        record.paragraph(
            f"**The measured materials were left out: {why}.** Nothing is said here about measured data. With the "
            "data in place, the same command with `--force` includes them."
        )
        record.metric("measured materials", 0, note=f"left out: {why}")
        return
    top = max(config.measured_orders)
    last = [row for row in found if row["order"] == top]
    said = "; ".join(
        f"{row['material']}: violation {row['violation before']:.1%} ({row['violation before, θ < 70°']:.1%} below "
        f"70°), change {row['change']:.1%}, of it filter "
        f"{row['filtered']:.1%} and approximation {row['approximation']:.1%} (filter share of the energy "
        f"{row['filter share']:.0%})"
        for row in last
    )
    record.paragraph(
        f"{len(last)} measured materials, fitted at order {top} in the isotropic reciprocal basis: {said}. The "
        f"violation after the fit is at most {max(row['violation after'] for row in found):.1e}. Where approximation "
        "is the larger part, the change of the data is not a filter of errors but a loss of detail, and a higher "
        "order or another basis is needed before the fit can be called filtered data. The samples include the grazing "
        "directions that the database extrapolates; norm D gives them little weight. A measurement that is not "
        "symmetric in the azimuth counts as approximation here."
    )
    record.metric("measured materials", len(last))
    for row in last:
        record.metric(f"{row['material']} violation before", row["violation before"])
        record.metric(f"{row['material']} filter share", row["filter share"], note=f"order {top}")


def _draw_noise(config: Config, rows):
    figure, axes = plt.subplots(1, len(config.brdfs), figsize=(4.6 * len(config.brdfs), 3.6), squeeze=False)
    colors = dict(zip(PAIRS, (ORANGE, RED, BLUE), strict=True))
    for ax, name in zip(axes[0], config.brdfs, strict=True):
        for order, marker in zip(config.orders, "osD^v<>"[: len(config.orders)], strict=False):
            for label in PAIRS:
                chosen = [
                    row for row in rows
                    if (row["brdf"], row["order"], row["basis"], row["noise"]) == (TITLES[name], order, label, "both")
                ]  # fmt: skip
                ax.loglog(
                    [row["level"] for row in chosen], [row["distance after"] for row in chosen],
                    color=colors[label], marker=marker, markersize=4, linewidth=1.2, label=f"{label}, order {order}",
                )  # fmt: skip
        ax.loglog(config.levels, config.levels, color="0.5", linestyle="--", linewidth=1, label="samples")
        ax.set_title(TITLES[name], fontsize=10)
        ax.set_xlabel("noise, relative")
        ax.set_xticks(config.levels, [f"{level:g}" for level in config.levels])
        ax.xaxis.set_minor_formatter("")
        plain(ax)
    axes[0, 0].set_ylabel("distance to the truth, relative")
    axes[0, -1].legend(frameon=False, fontsize=7)
    figure.tight_layout()
    return figure


def _draw_measured(found):
    materials = list(dict.fromkeys(row["material"] for row in found))
    figure, ax = plt.subplots(figsize=(6.4, 3.8))
    for material, color, marker in zip(
        materials, [GREEN, RED, BLUE, ORANGE] * len(materials), "osD^" * len(materials), strict=False
    ):
        chosen = [row for row in found if row["material"] == material]
        orders = [row["order"] for row in chosen]
        ax.semilogy(orders, [row["change"] for row in chosen], color=color, marker=marker, markersize=4, label=material)
        ax.semilogy(orders, [row["filtered"] for row in chosen], color=color, linestyle="--", linewidth=1)
    ax.set_xlabel("order")
    ax.set_ylabel("relative change, norm D")
    ax.legend(frameon=False, fontsize=8)
    plain(ax)
    figure.tight_layout()
    return figure
