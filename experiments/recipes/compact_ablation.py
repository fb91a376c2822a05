"""What each ingredient of compact fits brings, and to which materials: mirrors, dark ones, paints, a retro-reflector.

One ingredient at a time is taken away or changed; all else stays as it is.
"""

from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from pydantic import Field

from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._compact_metrics import (
    Folded,
    Positive,
    cells,
    evaluated,
    largest_albedo,
    log_error,
    table,
)
from experiments.recipes._surrogate import read_surrogates
from experiments.record import Record
from hshjax import Samples, direction, fit_compact, fit_compact_all, half_vector_samples
from hshjax.io import read_rgl

TUNED = 4
"""Every so many surrogates were looked at while choices were made: they are left out."""

GROUPS = {
    "mirrors": ("chrome-steel", "ss440", "steel", "black-obsidian", "hematite", "two-layer-silver"),
    "dark": ("black-fabric", "black-soft-plastic", "black-oxidized-steel", "neoprene-rubber"),
    "colour-changing": ("color-changing-paint1", "color-changing-paint2", "vch_golden_yellow_rgb"),
}
"""Materials with a name for being hard."""

GRAZING = tuple(np.radians([83, 86, 88]).tolist())
"""Angles of the eye beyond what is judged otherwise [radians]."""

INGREDIENTS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "weights of the first round": {"rounds": 0},
    "one scale for all, α = 0.01": {"alphas": (0.01,)},
    "no warp of θ_d": {"betas": ()},
    "dark = 0.01": {"dark": 0.01},
    "dark = 0.3": {"dark": 0.3},
    "no flat weight (everywhere = 0.001)": {"everywhere": 0.001},
    "ridge = 1e-7": {"ridge": 1e-7},
    "ridge = 1e-4": {"ridge": 1e-4},
    "albedo not held": {"energy": False},
    "nothing beyond 80 degrees": {"grazing": 0.0},
}


class Config(RecipeConfig):
    recipe: Literal["compact_ablation"]
    folder: Annotated[DataPath, Field(description="folder of *.bsdf files")]
    surrogates: Annotated[DataPath, Field(description="file of networks that stand in for measured materials")]
    tape: Annotated[DataPath, Field(description="retro-reflector: ALTA text, ISOTROPIC_TL_TV_PROJ_DPHI, one value")]
    every: Annotated[int, Field(ge=1, description="take every n-th of the surrogates that were not tuned on")] = 3
    coefficients: Annotated[tuple[int, ...], Field(min_length=1, description="of the models")] = (25, 50, 150)
    shape: Annotated[tuple[int, int, int], Field(description="cells of the grid that is fitted")] = (92, 24, 6)


def run(config: Config, record: Record) -> None:
    networks = read_surrogates(local_path(config.surrogates))
    others = [name for k, name in enumerate(networks) if k % TUNED][:: config.every]
    measured = {path.stem: read_rgl(path) for path in sorted(local_path(config.folder).glob("*.bsdf"))}
    known = {**measured, **networks}
    groups = {"surrogates": others, **GROUPS, "measured": list(measured)}
    names = list(dict.fromkeys(name for group in groups.values() for name in group))
    brdfs = {name: Positive(known[name]) for name in names}
    truth = record.stage("truth", _truth, brdfs)
    tape = _tape(config, record)
    rows = []
    for count in record.progress(config.coefficients, "numbers of coefficients"):
        for label, settings in INGREDIENTS.items():
            found = record.stage(f"{label}, {count}", _fitted, config, brdfs, truth, settings, count)
            found["tape"] = record.stage(f"tape, {label}, {count}", _fitted_tape, *tape, settings, count)
            rows.append(_row(groups, names, label, count, found))
    record.paragraph(
        f"{len(others)} networks that stand in for MERL, none of those that choices were made on, the four measured "
        "materials, and some with a name for being hard, which may be among either. Compact models (`fit_compact`) "
        f"of three channels, on {' x '.join(map(str, config.shape))} cells. Medians of the log error: 1000 x mean "
        "|Δ ln(1 + ρ cos)| over 90 x 30 x 12 cells below 80 degrees. The tape is a retro-reflector measured at three "
        "angles of incidence: the same error of one channel, on 30 % of its samples, which the fit did not see. "
        "Grazing: the largest albedo of a model at 83, 86 and 88 degrees over that of its material, the worst of all."
    )
    record.table("ingredients", rows, "Median log errors, one ingredient changed at a time.", printed=True)
    for row in rows:
        record.metric(f"{row['ingredient']}, n = {row['n']}: surrogates", row["surrogates"], note="median log error")


def _truth(brdfs: dict[str, Any]) -> dict[str, Any]:
    return {
        "tables": {name: table(brdf) for name, brdf in brdfs.items()},
        "albedos": {name: largest_albedo(Folded(brdf), GRAZING) for name, brdf in brdfs.items()},
    }


def _fitted(config: Config, brdfs: dict, truth: dict, settings: dict[str, Any], count: int) -> dict[str, Any]:
    sampling, settings = _divided(settings)
    samples = [half_vector_samples(brdf, shape=config.shape, **sampling) for brdf in brdfs.values()]
    fits = fit_compact_all(samples, count, **settings)
    places = cells()
    errors = [
        log_error(truth["tables"][name], evaluated(fit.model, places.wi, places.wo), places.wi, places.wo)
        for name, fit in zip(brdfs, fits, strict=True)
    ]
    rise = [
        float(np.max(largest_albedo(fit.model, GRAZING) / truth["albedos"][name]))
        for name, fit in zip(brdfs, fits, strict=True)
    ]
    return {"errors": errors, "grazing": max(rise)}


def _tape(config: Config, record: Record) -> tuple[Samples, Samples]:
    """Its samples, those to fit and those to judge by."""
    # Lines are θ_l, θ_v cos Δφ, θ_v sin Δφ [radians] and the value; # begins a comment.
    theta_l, x, y, value = np.loadtxt(local_path(config.tape), comments="#").T
    theta_v = np.hypot(x, y)
    seen = np.maximum(theta_l, theta_v) < np.radians(89)
    judge = record.rng("tape").uniform(size=value.size) < 0.3
    wi = direction(jnp.asarray(theta_l), jnp.zeros(value.size))
    wo = direction(jnp.asarray(theta_v), jnp.asarray(np.arctan2(y, x)))
    parts = (np.flatnonzero(seen & part) for part in (~judge, judge))
    fitted, judged = (
        Samples.scattered(wi[part], wo[part], jnp.asarray(value[part, None]), isotropic=True) for part in parts
    )
    return fitted, judged


def _fitted_tape(fitted: Samples, judged: Samples, settings: dict[str, Any], count: int) -> float:
    model = fit_compact(fitted, count, **_divided(settings)[1]).model
    wi, wo = np.asarray(judged.wi), np.asarray(judged.wo)
    return log_error(np.asarray(judged.value), np.asarray(model(judged.wi, judged.wo)), wi, wo)


def _divided(settings: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """What concerns the sampling of a BRDF, and what its fit."""
    sampling = {key: value for key, value in settings.items() if key == "grazing"}
    return sampling, {key: value for key, value in settings.items() if key not in sampling}


def _row(groups: dict[str, Any], names: list[str], label: str, count: int, found: dict[str, Any]) -> dict[str, Any]:
    errors = dict(zip(names, found["errors"], strict=True))
    medians = {group: float(np.median([errors[name] for name in members])) for group, members in groups.items()}
    worst = float(np.quantile([errors[name] for name in groups["surrogates"]], 0.9))
    return {"n": count, "ingredient": label, "surrogates": medians.pop("surrogates"), "worst decile": worst} | {
        **medians, "tape": found["tape"], "grazing": found["grazing"],
    }  # fmt: skip
