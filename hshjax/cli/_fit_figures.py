"""What there is to say of a fitted material, by one command and in the folder of many."""

from typing import Any

from hshjax.cli._console import Figures
from hshjax.cli._describe import (
    describe_coverage,
    describe_energy,
    describe_file,
    describe_log_error,
    describe_model,
    numbers,
)

RINGING = 0.05
"""Share of the energy that is negative, from which a series misses what it is to show; some percent are noise."""

REFLECTED = 1.05
"""Albedo that no surface has; databases err by some percent."""


def describe_data(figures: Figures, data: Any, found: Any) -> str | None:
    """The file and its angles; of samples which values of a fit are extrapolated."""
    from hshjax.io import coverage
    from hshjax.samples import Samples

    if found is not None:
        describe_file(figures, found)
    if not isinstance(data, Samples):
        return None
    covered = coverage(data)
    describe_coverage(figures, covered)
    limits = f"beyond θ_i {covered.theta_i[1]:.4g} and θ_o {covered.theta_o[1]:.4g} degrees"
    return f"values {limits} and between incidences are extrapolated"


def describe_fit(figures: Figures, model: str, result: Any, errors: Any, beyond: str | None) -> None:
    """A `MaterialFit` by the name of its model, and its `Comparison`; `beyond`: from `describe_data`."""
    figures.add("model", model)
    describe_model(figures, result.model)
    where = "" if result.samples.degree is None else f" on a rule of degree {result.samples.degree}"
    figures.add("samples", result.samples.size, words=f"{result.samples.size}{where}")
    figures.add("fit_notes", result.notes, "decisions of the fit", "\n".join(result.notes) or "none")
    _details(figures, result.details)
    for name, value in errors.errors.items():
        figures.add(f"relative_error_{name}", value, f"relative error, norm {name}", numbers(value))
    describe_log_error(figures, errors.log_error)
    energy = describe_energy(figures, result.model)
    advice = []
    if beyond is not None:
        figures.add("extrapolated", beyond)
        if model == "linear":
            advice.append("a series rings between few incidences; --model inferred, or compact, does not")
    elif model == "linear" and energy.negative > RINGING:
        advice.append(
            f"the series rings, {energy.negative:.0%} of its energy is negative: the highlight is narrower than it can "
            "follow; --model compact follows it and is positive"
        )
    if energy.albedo > REFLECTED:
        advice.append(
            f"more light is reflected than received (hemispherical albedo {energy.albedo:.3g}): values in another unit "
            "than sr^-1, an outlier, or angles that were not measured"
        )
    if advice:
        figures.add("advice", "; ".join(advice), words="\n".join(advice))


def _details(figures: Figures, details: Any) -> None:
    """What the fit says of itself."""
    from hshjax.fitting import CompactFit, CompactPosterior, Fit

    if isinstance(details, Fit):
        _linear(figures, details)
    elif isinstance(details, CompactFit):
        figures.add("fitted_samples", details.samples, "fitted to", f"{details.samples} samples")
        log = f"{1e3 * details.log_error:.3g} / 1000, mean |Δ ln(1 + ρ cos θ)| over them"
        figures.add("fit_log_error", details.log_error, "log error", log)
        figures.add("largest_albedo", details.albedo, words=f"{details.albedo:.4f}, up to 80 degrees")
        figures.add("floored_share", details.floored, "below the floor", f"{details.floored:.2%} of their values")
    elif isinstance(details, CompactPosterior):
        figures.add("noise", details.noise, "noise, relative", f"{float(details.noise):.3g}")
        figures.add("dark", details.dark, "noise counts as constant below", f"{float(details.dark):.3g} sr^-1")
        factor = float(details.factor)
        figures.add("deviation_factor", factor, "error bars scaled by", f"{factor:.3g}")
    else:
        figures.add("fit", list(dict.fromkeys(one.message for one in details)))
        figures.add("steps", [int(one.steps) for one in details])
        if len(details) == 1:
            for name, value in _parameters(details[0].model).items():
                figures.add(f"parameter {name}", value, name, numbers(value.ravel()))


def _linear(figures: Figures, found: Any) -> None:
    figures.add("unknowns", found.unknowns)
    figures.add("condition_number", found.condition, words=f"{float(found.condition):.3g} ({found.method})")
    if found.certificate is not None:
        smallest, largest = float(found.certificate.smallest.min()), float(found.certificate.albedo.max())
        verdict = "holds" if found.certificate.holds else "DOES NOT HOLD"
        words = f"{verdict}: smallest value {smallest:.2g} sr^-1, largest albedo {largest:.7f}"
        figures.add("certificate_holds", bool(found.certificate.holds), "certificate", words)
    for name, error in (("measured", found.reciprocity_before), ("fitted", found.reciprocity_after)):
        if error is not None:
            words = f"{float(error.relative):.3g} ({error.pairs} pairs)"
            figures.add(f"reciprocity_{name}", error.relative, f"violation of reciprocity, {name}", words)


def _parameters(model: Any) -> dict[str, Any]:
    """The arrays of a model by their names."""
    import jax

    from hshjax.fitting._bounds import path_name

    return {path_name(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(model)}
