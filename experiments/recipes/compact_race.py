"""How few numbers carry a measured highlight: compact models against series of products and networks, by one judge."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

import hshjax
from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._compact_metrics import (
    Folded,
    Positive,
    cells,
    evaluated,
    images,
    l2_error,
    largest_albedo,
    log_error,
    pictures,
    psnr,
    table,
    together,
)
from experiments.recipes._paper import BLUE, GREEN, ORANGE, RED, plain
from experiments.recipes._surrogate import read_surrogates
from experiments.record import Record
from hshjax import (
    GGX,
    HSH,
    IsotropicBasis,
    Lambert,
    LogLinearBRDF,
    Samples,
    Zernike,
    fit_compact_all,
    half_vector_samples,
    isotropic_pair_rule,
)
from hshjax.fitting import LogCosineWeighted, SampleMisfit, initial_guesses, multi_start
from hshjax.fitting._compact_equations import DARK, EVERYWHERE, FLOOR, MARGIN, visibility
from hshjax.io import read_rgl

REFERENCE = "reference_eval.npz"
MODELS = {
    "compact": (BLUE, "-"), "HSH": (RED, "-"), "HSH, log": (RED, ":"), "Zernike": (ORANGE, "-"),
    "Zernike, log": (ORANGE, ":"), "GGX": ("0.7", "-"), "network": (GREEN, "-"), "network, both ways": (GREEN, ":"),
}  # fmt: skip
"""Colours, and lines of points."""


class Config(RecipeConfig):
    recipe: Literal["compact_race"]
    folder: Annotated[DataPath, Field(description=f"folder of *.bsdf files and {REFERENCE}, values of random pairs")]
    surrogates: Annotated[DataPath, Field(description="file of networks that stand in for measured materials")]
    networks: Annotated[DataPath, Field(description="file of networks of the materials in the folder")]
    environments: Annotated[tuple[DataPath, ...], Field(description="environment maps of the pictures, y up")]
    every: Annotated[int, Field(ge=1, description="take every n-th surrogate")] = 1
    coefficients: Annotated[tuple[int, ...], Field(min_length=1, description="of compact models")] = (25, 50, 100, 150)
    shape: Annotated[tuple[int, int, int], Field(description="cells of the grid that is fitted")] = (92, 24, 6)
    size: Annotated[int, Field(ge=8, description="pixels of a picture under lamps; half under environments")] = 128
    hsh_order: Annotated[int, Field(ge=0, description="order of HSH")] = 8
    zernike_order: Annotated[int, Field(ge=0, description="order of Zernike functions")] = 12
    degree: Annotated[int, Field(ge=2, description="degree of the rule that products are fitted on")] = 48


def run(config: Config, record: Record) -> None:
    judge = _Judge(config, record)
    rows: list[dict[str, Any]] = []
    brdfs = [Positive(brdf) for brdf in judge.materials.values()]
    grids = [half_vector_samples(brdf, shape=config.shape) for brdf in brdfs]
    for count in record.progress(config.coefficients, "compact models"):
        rows += record.stage(f"compact {count}", _compact, judge, grids, count)
    nodes = [Samples.from_function(brdf, isotropic_pair_rule(config.degree)) for brdf in brdfs]
    for label, basis in (("HSH", HSH(config.hsh_order)), ("Zernike", Zernike(config.zernike_order))):
        rows += record.stage(label, _products, judge, nodes, label, IsotropicBasis(basis))
        rows += record.stage(f"{label}, log", _exponentials, judge, grids, f"{label}, log", IsotropicBasis(basis))
    rows += record.stage("GGX", _lobes, judge, grids)
    rows += record.stage("networks", _networks, config, judge)
    summary = _summary(rows)
    record.paragraph(
        f"{len(judge.materials)} materials: those measured in `{config.folder}` (RGL) and networks that stand in for "
        f"MERL, three channels. Compact models (`hshjax.fit_compact`, its defaults) are fitted to {config.shape[0]} x "
        f"{config.shape[1]} x {config.shape[2]} cells, products by least squares in norm A on a rule of degree "
        f"{config.degree}, both in closed form; products marked log are series of ln ρ, on the cells. n counts all "
        "coefficients of the three channels; that of compact models leaves out which functions a material has chosen, "
        "the warp's scale and two bounds a channel. GGX is one lobe and a diffuse part, fitted from many starts. "
        "Networks were published with 675 weights, and are judged where a measurement is known; both ways: their mean "
        "over the swap of the directions. Weights and warp of compact models are of a recipe found on these materials "
        "by others; how functions are chosen, the grid and the ridge were settled on every fourth of the surrogates."
    )
    record.table("summary", summary, "Medians over materials, and the worst decile of the log error.")
    record.figure("rate", _draw(summary), "Log error against the number of coefficients: medians.")
    record.table(
        "table", rows,
        "log: 1000 x mean |Δ ln(1 + ρ cos)| over 90 x 30 x 12 cells of sqrt(θ_h), θ_d, φ_d below 80 degrees, both "
        "cosines. l2: relative, of ρ cos cos. psnr [dB]: mean of three spheres (three lamps, two environments), both "
        "directions below 80 degrees, the material made reciprocal, exposed alike, in sRGB, capped at 80. "
        "random_pairs_log: as log, on measured pairs as they are, not made reciprocal. max_albedo: directional, up to "
        "80 degrees, light from everywhere. seconds: of the fit, a material's share of the batch, "
        "on the machine at hand.",
    )  # fmt: skip
    for row in summary:
        record.metric(f"{row['database']}, {row['model']}, n = {row['n']}: log", row["log"], note="median")
        record.metric(f"{row['database']}, {row['model']}, n = {row['n']}: psnr", row["psnr"], "dB", "median")


class _Judge:
    """Materials, and what is known of them."""

    def __init__(self, config: Config, record: Record):
        networks = read_surrogates(local_path(config.surrogates))
        names = list(networks)[:: config.every]
        self.measured = {path.stem: read_rgl(path) for path in sorted(local_path(config.folder).glob("*.bsdf"))}
        self.materials: dict[str, Callable] = self.measured | {name: networks[name] for name in names}
        self.pictures = pictures([local_path(path) for path in config.environments], config.size)
        with np.load(local_path(config.folder) / REFERENCE) as file:
            self.pairs = {key: np.asarray(file[key], float) for key in file}
        self.cells, self.tables, self.images = cells(), {}, {}
        for name, brdf in record.progress(self.materials.items(), "materials"):
            known = record.stage(f"truth {name}", self._truth, brdf)
            self.tables[name], self.images[name] = known["table"], known["images"]

    def _truth(self, brdf: Callable) -> dict[str, Any]:
        return {"table": table(brdf), "images": images(Folded(Positive(brdf)), self.pictures)}

    def database(self, name: str) -> str:
        return "RGL" if name in self.measured else "MERL"

    def row(self, name: str, n: int, model: str, values: dict[str, Any], seconds: float) -> dict[str, Any]:
        """The figures of a model by its values: table, images, pairs and albedo."""
        truth, cells = self.tables[name], self.cells
        pairs = None
        if name in self.measured:
            pairs = log_error(self.pairs[name], values["pairs"], self.pairs["wi"], self.pairs["wo"])
        return {
            "n": n, "database": self.database(name), "material": name, "model": model,
            "log": log_error(truth, values["table"], cells.wi, cells.wo),
            "psnr": psnr(self.images[name], values["images"]), "l2": l2_error(truth, values["table"], cells.weight),
            "random_pairs_log": pairs, "max_albedo": float(np.max(values["albedo"])), "seconds": seconds,
        }  # fmt: skip

    def values(self, brdf: Callable) -> dict[str, Any]:
        """All that `row` asks of a BRDF of any number of channels."""
        model = Positive(brdf)
        return {
            "table": evaluated(model, self.cells.wi, self.cells.wo),
            "images": images(model, self.pictures),
            "pairs": evaluated(model, self.pairs["wi"], self.pairs["wo"]),
            "albedo": largest_albedo(model),
        }


def _compact(judge: _Judge, samples: list[Samples], count: int) -> list[dict[str, Any]]:
    begin = time.perf_counter()
    fits = fit_compact_all(samples, count)
    seconds = (time.perf_counter() - begin) / len(fits)
    groups = defaultdict(list)
    for name, fit in zip(judge.materials, fits, strict=True):
        groups[fit.alpha].append((name, fit.model))
    rows = []
    for group in groups.values():
        names, models = zip(*group, strict=True)
        rows += _each(judge, names, count, "compact", judge.values(together(models)), seconds)
    return rows


def _channels(values: dict[str, Any], part: slice) -> dict[str, Any]:
    return {
        key: [image[..., part] for image in value] if key == "images" else value[..., part]
        for key, value in values.items()
    }


def _products(judge: _Judge, samples: list[Samples], label: str, basis: IsotropicBasis) -> list[dict[str, Any]]:
    begin = time.perf_counter()
    fits = hshjax.project_all(basis, samples, norm="A")
    seconds = (time.perf_counter() - begin) / len(fits)
    coefficients = jnp.concatenate([fit.model.coefficients for fit in fits], axis=1)
    values = judge.values(hshjax.LinearBRDF(basis, coefficients, fits[0].model.target))
    return _each(judge, judge.materials, 3 * basis.count, label, values, seconds)


def _each(
    judge: _Judge, names: Iterable[str], n: int, label: str, values: dict[str, Any], seconds: float
) -> list[dict[str, Any]]:
    """Rows of materials by the values of a model of all their channels."""
    return [
        judge.row(name, n, label, _channels(values, slice(3 * k, 3 * k + 3)), seconds) for k, name in enumerate(names)
    ]


def _exponentials(judge: _Judge, samples: list[Samples], label: str, basis: IsotropicBasis) -> list[dict[str, Any]]:
    """ρ = exp(series), each channel by itself: least squares in ln ρ, bounded as compact fits are, on like weights."""
    begin, models = time.perf_counter(), []
    design = np.asarray(basis(samples[0].wi, samples[0].wo))
    cosine = np.asarray(samples[0].wi[:, 2:] + samples[0].wo[:, 2:]) / 2
    for one in samples:
        target = np.log(np.maximum(one.value, FLOOR))
        roots = np.sqrt(np.asarray(one.weight)[:, None] * visibility(cosine * np.asarray(one.value), DARK, EVERYWHERE))
        columns = [
            jnp.asarray(np.linalg.lstsq(root[:, None] * design, root * logarithm, rcond=1e-6)[0])
            for root, logarithm in zip(roots.T, target.T, strict=True)
        ]
        bounds = (jnp.asarray(part) for part in (target.min(axis=0) - MARGIN, target.max(axis=0) + MARGIN))
        models.append(LogLinearBRDF(basis, columns, jnp.eye(len(columns)), *bounds))
    seconds = (time.perf_counter() - begin) / len(models)
    return _each(judge, judge.materials, models[0].count, label, judge.values(together(models)), seconds)


def _lobes(judge: _Judge, samples: list[Samples]) -> list[dict[str, Any]]:
    """Lambert and one GGX lobe, seven parameters, from many starts: least squares in ln(1 + ρ cos cos)."""
    rows = []
    for name, one in zip(judge.materials, samples, strict=True):
        begin = time.perf_counter()
        black = jnp.zeros(one.channels)
        starts = initial_guesses(Lambert(black) + GGX(black, jnp.asarray(0.3)), one)
        found = multi_start(starts, {"data": SampleMisfit(one, LogCosineWeighted())}, max_steps=60, throw=False)
        seconds = time.perf_counter() - begin
        rows.append(judge.row(name, 2 * one.channels + 1, "GGX", judge.values(found.best.model), seconds))
    return rows


def _networks(config: Config, judge: _Judge) -> list[dict[str, Any]]:
    """675 weights each; only where they are not the truth themselves."""
    published = read_surrogates(local_path(config.networks))
    rows = []
    for name in judge.measured:
        network = published[name]

        def both_ways(wi, wo, network=network):
            return (Positive(network)(wi, wo) + Positive(network)(wo, wi)) / 2

        for label, brdf in {"network": network, "network, both ways": both_ways}.items():
            rows.append(judge.row(name, 675, label, judge.values(brdf), 0.0))
    return rows


def _summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    groups = defaultdict(list)
    for row in rows:
        groups[row["database"], row["model"], row["n"]].append(row)
    found = []
    for (database, model, n), group in groups.items():

        def median(key, group=group):
            values = [row[key] for row in group if row[key] is not None]
            return float(np.median(values)) if values else None

        found.append({
            "database": database, "model": model, "n": n, "materials": len(group), "log": median("log"),
            "worst decile": float(np.quantile([row["log"] for row in group], 0.9)), "psnr": median("psnr"),
            "l2": median("l2"), "random_pairs_log": median("random_pairs_log"),
            "max_albedo": float(np.max([row["max_albedo"] for row in group])), "seconds": median("seconds"),
        })  # fmt: skip
    return found


def _draw(summary: list[dict[str, Any]]) -> Any:
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained", sharey=True)
    for ax, database in zip(axes, ("MERL", "RGL"), strict=True):
        for model, (color, style) in MODELS.items():
            line = sorted(
                (row["n"], row["log"]) for row in summary if (row["database"], row["model"]) == (database, model)
            )
            if line:
                filled = {"markerfacecolor": color if style == "-" else "white"}
                ax.loglog(*zip(*line, strict=True), "o" + style, color=color, label=model, **filled)
        ax.set(title=database, xlabel="coefficients, three channels")
        plain(ax)
    axes[0].set_ylabel("log error x 1000")
    axes[1].legend(fontsize=7)
    return figure
