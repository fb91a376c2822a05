"""What recipes share about materials; `quickstart` and `material_fit`: one against several bases and orders."""

from typing import Annotated, Any, Literal

import equinox as eqx
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

import hshjax
from experiments.config import Section
from experiments.record import Record
from hshjax import plotting
from hshjax._typing import PairFunction

FAMILIES = {"HSH": hshjax.HSH, "Zernike": hshjax.Zernike, "SHR": hshjax.SHR}
Family = Literal["HSH", "Zernike", "SHR"]
Norm = Literal["A", "B", "C", "D", "E"]


class Exchanged(eqx.Module):
    """ρ(wo, wi): what a renderer that starts at the eye makes of a table that is not reciprocal."""

    brdf: PairFunction

    def __call__(self, wi, wo):
        return self.brdf(wo, wi)


class FitSection(Section):
    """How a material is sampled and fitted."""

    families: Annotated[tuple[Family, ...], Field(min_length=1, description="bases to compare")] = (
        "HSH",
        "Zernike",
        "SHR",
    )
    orders: Annotated[tuple[int, ...], Field(min_length=1, description="orders of each basis")] = (2, 4, 8)
    norm: Annotated[Norm, Field(description="norm that is minimised, see docs/norms.md")] = "D"
    ridge: Annotated[float, Field(ge=0, description="weight of the spectral prior; 0 for none")] = 0.0
    degree: Annotated[int, Field(ge=2, description="degree of the rule that samples the material")] = 64


class PictureSection(Section):
    """What the report shows."""

    incidence: Annotated[tuple[float, ...], Field(min_length=1, description="angles of incidence [degrees]")] = (
        30.0,
        60.0,
    )
    light: Annotated[
        tuple[float, float, float], Field(description="towards the light; x right, y up, z to the eye")
    ] = (
        -0.5,
        0.5,
        0.7,
    )
    size: Annotated[int, Field(ge=16, le=1024, description="pixels across the sphere")] = 192


def study(
    record: Record, name: str, brdf: Any, fit: FitSection, pictures: PictureSection
) -> dict[tuple[str, int], dict[str, Any]]:
    """Fits `brdf` by every basis at every order, and shows the outcome; rows of the table by (family, order)."""
    samples = hshjax.Samples.from_function(brdf, hshjax.isotropic_pair_rule(fit.degree))
    truth = plotting.sphere(brdf, pictures.light, size=pictures.size)
    factor = plotting.exposure(truth)

    rows, models = {}, {}
    cases = [(family, order) for family in fit.families for order in fit.orders]
    for family, order in record.progress(cases, f"{name}: fits"):
        pairs = hshjax.IsotropicBasis(FAMILIES[family](order))
        kept = record.stage(f"{name} {family} {order}", _fitted, pairs, samples, fit)
        model = hshjax.LinearBRDF(pairs, jnp.asarray(kept["coefficients"]), hshjax.NORMS[fit.norm].target)
        image = plotting.sphere(model, pictures.light, size=pictures.size)
        models[family, order] = (model, image)
        rows[family, order] = {
            "basis": family,
            "order": order,
            "coefficients": kept["unknowns"],
            f"error, norm {fit.norm}": kept["error"],
            "error, norm E": kept["error_e"],
            "sphere PSNR [dB]": plotting.psnr(image, truth, factor),
            "smallest value up to 80° [1/sr]": kept["minimum"],
            "negative energy": kept["negative"],
        }
    record.table(
        f"{name} errors",
        list(rows.values()),
        f"{name}: relative errors, all channels together, of isotropic reciprocal fits. Coefficients are per channel. "
        f"Fitted in norm {fit.norm} ({hshjax.NORMS[fit.norm].meaning}) on {samples.size} pairs of directions"
        + (f", spectral prior of weight {fit.ridge:g}." if fit.ridge else ".")
        + " Norm E counts pairs up to 80° only, under the weight cos θi cos θo.",
    )
    largest = max(fit.orders)
    record.figure(
        f"{name} errors by order",
        _error_figure(rows, f"error, norm {fit.norm}"),
        f"{name}: error of the fit in norm {fit.norm}, by order and by number of coefficients per channel.",
    )
    record.figure(
        f"{name} incident plane",
        _plane_figure(brdf, {family: models[family, largest][0] for family in fit.families}, pictures.incidence),
        f"{name}: BRDF in the plane of incidence, fits of order {largest}. Radius: ρ [1/sr], first channel.",
    )
    record.image(
        f"{name} spheres",
        np.concatenate(
            [plotting.display(i, factor) for i in [truth, *(models[f, largest][1] for f in fit.families)]], 1
        ),
        f"{name}: sphere under one directional light. From the left: the material, then "
        + ", ".join(f"{family} of order {largest}" for family in fit.families)
        + ". Same exposure, sRGB.",
    )
    for family in fit.families:
        row = rows[family, largest]
        record.metric(f"{name} {family} error {fit.norm}", row[f"error, norm {fit.norm}"], note=f"order {largest}")
        record.metric(f"{name} {family} sphere PSNR", row["sphere PSNR [dB]"], "dB", f"order {largest}")
    return rows


def verdict(name: str, rows: dict[tuple[str, int], dict[str, Any]], norm: str) -> str:
    """Which basis wins at the largest order, and which at a like number of coefficients, in a sentence or two."""
    key = f"error, norm {norm}"
    largest = max(order for _, order in rows)
    at_order = {family: row for (family, order), row in rows.items() if order == largest}
    best = min(at_order.values(), key=lambda row: row[key])
    text = (
        f"**{name}**: at order {largest} the smallest error in norm {norm} is {best[key]:.3g}, by {best['basis']} with "
        f"{best['coefficients']} coefficients per channel"
    )
    others = [
        f"{row['basis']} {row[key]:.3g} with {row['coefficients']}" for row in at_order.values() if row is not best
    ]
    return text + (f" ({'; '.join(others)})." if others else ".")


def _fitted(pairs: hshjax.IsotropicBasis, samples: hshjax.Samples, fit: FitSection) -> dict[str, Any]:
    prior = "spectral" if fit.ridge else None
    result = hshjax.project(pairs, samples, norm=fit.norm, ridge=fit.ridge, prior=prior, reciprocity=False)
    value = np.asarray(result.model(samples.wi, samples.wo))
    shown = np.asarray(hshjax.NORMS["E"].judge_weight(samples.wi, samples.wo)) > 0
    return {
        "coefficients": np.asarray(result.model.coefficients),
        "unknowns": result.unknowns,
        "error": joint_error(value, samples, fit.norm),
        "error_e": joint_error(value, samples, "E"),
        "minimum": float(value[shown].min()),
        "negative": negative_share(value, samples),
    }


def hsh_series(brdf: PairFunction, order: int, degree: int) -> hshjax.LinearBRDF:
    """An isotropic BRDF as a series of HSH: least squares in norm A on a rule of some degree."""
    samples = hshjax.Samples.from_function(brdf, hshjax.isotropic_pair_rule(degree))
    return hshjax.project(hshjax.IsotropicBasis(hshjax.HSH(order)), samples, norm="A").model


def negative_share(value: np.ndarray, samples: hshjax.Samples) -> float:
    """The share of ∫∫ |ρ| z_i z_o, all channels together, that is negative; `value` at the nodes of `samples`."""
    energy = np.asarray(samples.weight * samples.wi[:, 2] * samples.wo[:, 2])[:, None] * value
    return float(np.maximum(-energy, 0).sum() / np.abs(energy).sum())


def joint_error(value: np.ndarray, samples: hshjax.Samples, norm: str) -> float:
    """The relative error over all channels at once, where `hshjax.relative_error` has one a channel."""
    weight = np.asarray(samples.weight * hshjax.NORMS[norm].judge_weight(samples.wi, samples.wo))[:, None]
    truth = np.asarray(samples.value)
    return float(np.sqrt(np.sum(weight * (value - truth) ** 2) / np.sum(weight * truth**2)))


def _error_figure(rows: dict[tuple[str, int], dict[str, Any]], key: str) -> Any:
    figure, panels = plt.subplots(1, 2, figsize=(8, 3.2), sharey=True, layout="constrained")
    families = list(dict.fromkeys(family for family, _ in rows))
    for colour, family in zip(plotting.COLOURS, families, strict=False):
        series = [row for (f, _), row in rows.items() if f == family]
        for axes, x in zip(panels, ("order", "coefficients"), strict=True):
            axes.plot([r[x] for r in series], [r[key] for r in series], "o-", color=colour, label=family, ms=4)
    for axes, label in zip(panels, ("order", "coefficients per channel"), strict=True):
        axes.set(xlabel=label, yscale="log")
        axes.grid(alpha=0.3, which="both")
    panels[1].set_xscale("log")
    panels[0].set_ylabel("relative error")
    panels[0].legend(frameon=False)
    return figure


def _plane_figure(brdf: Any, models: dict[str, Any], incidence: tuple[float, ...]) -> Any:
    figure, panels = plt.subplots(
        1, len(incidence), figsize=(4.2 * len(incidence), 3.4), subplot_kw={"projection": "polar"}
    )
    for axes, angle in zip(np.atleast_1d(panels), incidence, strict=True):
        plotting.incident_plane(axes, {"material": brdf, **models}, np.radians(angle))
        axes.set_title(f"θi = {angle:g}°", fontsize=10)
        axes.legend(fontsize=7, frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0.12), ncols=3)
    return figure
