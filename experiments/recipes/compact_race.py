"""How few numbers carry a measured highlight: compact models against series, analytic lobes and networks, one judge."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._compact_metrics import (
    Folded,
    Positive,
    cells,
    evaluated,
    gloss,
    images,
    l2_error,
    largest_albedo,
    log_error,
    pictures,
    psnr,
    table,
    together,
)
from experiments.recipes._compact_report import classes, draw, random_pairs, said_of_classes, said_of_pairs, summary
from experiments.recipes._compact_rivals import (
    TEMPLATES,
    exponential_series,
    half_vector_series,
    joined,
    lobe,
    numbers,
    product_series,
)
from experiments.recipes._published import abc, read_parameters, shifted_gamma
from experiments.recipes._surrogate import read_surrogates
from experiments.record import Record
from hshjax import HSH, IsotropicBasis, Samples, Zernike, fit_compact_all, half_vector_samples, isotropic_pair_rule
from hshjax.io import read_rgl

REFERENCE = "reference_eval.npz"
PUBLISHED = {
    "ABC, published": ("merl_abc_low2012.csv", abc),
    "SGD, published": ("merl_sgd_bagher2012.csv", shifted_gamma),
}
WEIGHTS = 675
"""Of a network."""


class Config(RecipeConfig):
    recipe: Literal["compact_race"]
    folder: Annotated[DataPath, Field(description=f"folder of *.bsdf files and {REFERENCE}, values of random pairs")]
    surrogates: Annotated[DataPath, Field(description="file of networks that stand in for measured materials")]
    networks: Annotated[DataPath, Field(description="file of networks of the materials in the folder")]
    fits: Annotated[DataPath, Field(description="folder of published parameters of analytic models, *.csv")]
    environments: Annotated[tuple[DataPath, ...], Field(description="environment maps of the pictures, y up")]
    every: Annotated[int, Field(ge=1, description="take every n-th surrogate")] = 1
    coefficients: Annotated[tuple[int, ...], Field(min_length=1, description="of compact models")] = (25, 50, 100, 150)
    shape: Annotated[tuple[int, int, int], Field(description="cells of the grid that is fitted")] = (92, 24, 6)
    size: Annotated[int, Field(ge=8, description="pixels of a picture under lamps; half under environments")] = 128
    hsh_order: Annotated[int, Field(ge=0, description="order of HSH")] = 8
    zernike_order: Annotated[int, Field(ge=0, description="order of Zernike functions")] = 12
    half_vector: Annotated[int, Field(ge=1, description="functions a channel of series without logarithm")] = 74
    degree: Annotated[int, Field(ge=2, description="degree of the rule that products are fitted on")] = 48


def run(config: Config, record: Record) -> None:
    judge = _Judge(config, record)
    rows: list[dict[str, Any]] = []
    brdfs = [Positive(brdf) for brdf in judge.materials.values()]
    grids = [half_vector_samples(brdf, shape=config.shape) for brdf in brdfs]
    for count in record.progress(config.coefficients, "compact models"):
        rows += record.stage(f"compact {count}", _compact, judge, grids, count)
    for label, warped in (("half-vector, linear", True), ("half-vector, no warp", False)):
        rows += record.stage(label, _half_vector, judge, grids, label, config.half_vector, warped)
    nodes = [Samples.from_function(brdf, isotropic_pair_rule(config.degree)) for brdf in brdfs]
    for label, basis in (("HSH", HSH(config.hsh_order)), ("Zernike", Zernike(config.zernike_order))):
        rows += record.stage(label, _products, judge, nodes, label, IsotropicBasis(basis))
        rows += record.stage(f"{label}, log", _exponentials, judge, grids, f"{label}, log", IsotropicBasis(basis))
    for label in TEMPLATES:
        rows += record.stage(label, _lobes, judge, grids, label)
    rows += record.stage("published", _published, config, judge)
    rows += record.stage("networks", _networks, config, judge)
    _report(config, record, rows, {name: gloss(values) for name, values in judge.tables.items()})


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
        truths = record.stage_each(
            {f"truth {name}": (brdf,) for name, brdf in self.materials.items()}, self._truth, "materials"
        )
        for name, known in zip(self.materials, truths, strict=True):
            self.tables[name], self.images[name] = known["table"], known["images"]

    def _truth(self, brdf: Callable) -> dict[str, Any]:
        return {"table": table(brdf), "images": images(Folded(Positive(brdf)), self.pictures)}

    def database(self, name: str) -> str:
        return "RGL" if name in self.measured else "MERL"

    def row(self, name: str, n: int, model: str, values: dict[str, Any], seconds: float | None) -> dict[str, Any]:
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

    def rows(
        self, names: Iterable[str], n: int, model: str, brdf: Callable, seconds: float | None
    ) -> list[dict[str, Any]]:
        """The figures of a model of all channels of several materials, three each."""
        values = self.values(brdf)
        parts = (slice(3 * k, 3 * k + 3) for k in range(len(list(names))))
        return [
            self.row(name, n, model, _channels(values, part), seconds) for name, part in zip(names, parts, strict=True)
        ]

    def values(self, brdf: Callable) -> dict[str, Any]:
        """All that `row` asks of a BRDF of any number of channels."""
        model = Positive(brdf)
        return {
            "table": evaluated(model, self.cells.wi, self.cells.wo),
            "images": images(model, self.pictures),
            "pairs": evaluated(model, self.pairs["wi"], self.pairs["wo"]),
            "albedo": largest_albedo(model),
        }


def _channels(values: dict[str, Any], part: slice) -> dict[str, Any]:
    return {
        key: [image[..., part] for image in value] if key == "images" else value[..., part]
        for key, value in values.items()
    }


def _timed(fit: Callable, *arguments: Any, **settings: Any) -> tuple[list, float]:
    """What a fit of many materials finds, and the seconds of each."""
    begin = time.perf_counter()
    found = fit(*arguments, **settings)
    return found, (time.perf_counter() - begin) / len(found)


def _by(names: Iterable[str], models: list, key: Callable) -> list[tuple[list[str], list]]:
    """Models that have something in common, and the names of their materials: their functions are evaluated once."""
    groups = defaultdict(list)
    for name, model in zip(names, models, strict=True):
        groups[key(model)].append((name, model))
    return [([name for name, _ in group], [model for _, model in group]) for group in groups.values()]


def _compact(judge: _Judge, samples: list[Samples], count: int) -> list[dict[str, Any]]:
    fits, seconds = _timed(fit_compact_all, samples, count)
    rows = []
    for names, group in _by(judge.materials, fits, lambda fit: (fit.alpha, fit.beta)):
        rows += judge.rows(names, count, "compact", together([fit.model for fit in group]), seconds)
    return rows


def _half_vector(judge: _Judge, samples: list[Samples], label: str, count: int, warped: bool) -> list[dict[str, Any]]:
    models, seconds = _timed(half_vector_series, samples, count, warped=warped)
    rows = []
    # Materials under one warp share the very basis.
    for names, group in _by(judge.materials, models, lambda model: id(model.basis)):
        rows += judge.rows(names, group[0].coefficients.size, label, joined(group), seconds)
    return rows


def _products(judge: _Judge, samples: list[Samples], label: str, basis: IsotropicBasis) -> list[dict[str, Any]]:
    models, seconds = _timed(product_series, samples, basis)
    return judge.rows(judge.materials, models[0].coefficients.size, label, joined(models), seconds)


def _exponentials(judge: _Judge, samples: list[Samples], label: str, basis: IsotropicBasis) -> list[dict[str, Any]]:
    models, seconds = _timed(exponential_series, samples, basis)
    return judge.rows(judge.materials, models[0].count, label, together(models), seconds)


def _lobes(judge: _Judge, samples: list[Samples], label: str) -> list[dict[str, Any]]:
    rows = []
    for name, one in zip(judge.materials, samples, strict=True):
        (model,), seconds = _timed(lambda one=one: [lobe(TEMPLATES[label](), one)])
        rows += judge.rows([name], numbers(model), label, model, seconds)
    return rows


def _published(config: Config, judge: _Judge) -> list[dict[str, Any]]:
    rows = []
    for label, (file, build) in PUBLISHED.items():
        parameters = read_parameters(local_path(config.fits) / file)
        for name in judge.materials:
            if name not in judge.measured:
                model = build(parameters[name])
                rows += judge.rows([name], numbers(model), label, model, None)
    return rows


def _networks(config: Config, judge: _Judge) -> list[dict[str, Any]]:
    """Only where they are not the truth themselves."""
    published = read_surrogates(local_path(config.networks))
    rows = []
    for name in judge.measured:
        network = published[name]

        def both_ways(wi, wo, network=network):
            return (Positive(network)(wi, wo) + Positive(network)(wo, wi)) / 2

        for label, brdf in {"network": network, "network, both ways": both_ways}.items():
            rows += judge.rows([name], WEIGHTS, label, brdf, None)
    return rows


def _report(config: Config, record: Record, rows: list[dict[str, Any]], glosses: dict[str, float]) -> None:
    medians = summary(rows)
    record.paragraph(
        f"{len(glosses)} materials: those measured in `{config.folder}` (RGL) and networks that stand in for MERL, "
        f"three channels. Compact models (`hshjax.fit_compact`, its defaults) are fitted to {config.shape[0]} x "
        f"{config.shape[1]} x {config.shape[2]} cells, in closed form. n counts all coefficients of the three "
        "channels; that of compact models leaves out which functions a material has chosen, the warp's scale and two "
        "bounds a channel. Weights and warp of compact models are of a recipe found on these materials by others; how "
        "functions are chosen, the grid and the ridge were settled on every fourth of the surrogates."
    )
    record.paragraph(
        f"Rivals. Series of products, HSH of order {config.hsh_order} and Zernike of order {config.zernike_order}: "
        "least squares weighted by the cosines, ∫∫ |Δρ|² cos cos dω dω, on a rule of degree "
        f"{config.degree}; marked log, series of ln ρ on the cells, bounded like compact models. Half-vector, linear, "
        f"{config.half_vector} functions of half and difference vector a channel: ρ itself, by the same weighted "
        "least squares on the cells, each material under the best of 26 warps; no warp: polynomials in cos θ_h. GGX "
        "(a diffuse part, one lobe, Schlick's factor: 8 numbers) and ABC (9) are fitted from many starts to the cells, "
        "in ln(1 + ρ cos cos). Published: parameters of Löw et al. 2012 and of Bagher et al. 2012 as they are, fitted "
        "by them to the measurements that the networks stand in for, on their own terms. Networks of the RGL materials "
        f"were published with {WEIGHTS} weights; both ways: their mean over the swap of the directions."
    )
    record.table("summary", medians, "Medians over materials, and the worst decile of the log error.", printed=True)
    record.figure("rate", draw(medians), "Log error against the number of coefficients: medians.")
    quarters = classes(rows, glosses)
    record.heading("Where each is the right choice")
    record.paragraph(said_of_classes(quarters, glosses))
    record.table(
        "classes", quarters,
        "Medians over the quarter of the materials with the least gloss and the quarter with the most; gloss: the "
        "largest value over the median one, of the mean of the channels.",
    )  # fmt: skip
    record.heading("Random pairs, as they were measured")
    pairs, holds = random_pairs(rows, config.coefficients[-2:])
    record.paragraph(said_of_pairs(holds))
    record.table("random pairs", pairs, "Log error on raw pairs, and whether compact models lie below the networks.")
    record.heading("Every fit")
    record.table(
        "table", rows,
        "log: 1000 x mean |Δ ln(1 + ρ cos)| over 90 x 30 x 12 cells of sqrt(θ_h), θ_d, φ_d below 80 degrees, both "
        "cosines. l2: relative, of ρ cos cos. psnr [dB]: mean of three spheres (three lamps, two environments), both "
        "directions below 80 degrees, the material made reciprocal, exposed alike, in sRGB, capped at 80. "
        "random_pairs_log: as log, on measured pairs as they are, not made reciprocal. max_albedo: directional, up to "
        "80 degrees, light from everywhere. seconds: of the fit, a material's share of the batch, on the machine at "
        "hand; none where parameters are given.",
    )  # fmt: skip
    for row in medians:
        record.metric(f"{row['database']}, {row['model']}, n = {row['n']}: log", row["log"], note="median")
        record.metric(f"{row['database']}, {row['model']}, n = {row['n']}: psnr", row["psnr"], "dB", "median")
    for claim, value in holds.items():
        record.metric(claim, value)
