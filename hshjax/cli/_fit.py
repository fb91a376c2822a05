"""`hshjax fit`: from a measured material to a saved model, in numbers and pictures."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Annotated, Any, Literal

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hshjax.cli._console import Figures, Misuse, check_targets, complaints, console, failure, guarded, typer
from hshjax.cli._describe import (
    describe_coverage,
    describe_energy,
    describe_file,
    describe_log_error,
    describe_model,
    numbers,
)
from hshjax.cli._options import File, Force, Json, Negatives

FILES = ("model.hshjax", "metrics.json", "spheres.png")
"""In the folder of a result."""

FAMILIES = {"hsh": "HSH", "zernike": "Zernike", "shr": "SHR"}


@guarded
def fit(
    file: File,
    model: Annotated[
        Literal["linear", "compact", "inferred", "exp", "cook-torrance", "ggx"],
        typer.Option(
            help="linear: a series in the basis, in closed form. compact: a positive one in the half vector, in closed "
            "form, for highlights too. inferred: such a one from few, scattered or noisy samples, without ringing. "
            "exp: the exponential of a series in the basis, which is positive. cook-torrance, ggx: that lobe and a "
            "diffuse part, from many starts."
        ),
    ] = "linear",
    basis: Annotated[Literal["hsh", "zernike", "shr"], typer.Option(help="Family of the basis.")] = "hsh",
    order: Annotated[int, typer.Option(min=0, max=64, help="Order of the basis.")] = 8,
    coefficients: Annotated[
        int,
        typer.Option(
            min=3,
            max=1000,
            help="Of a compact model, all channels together; functions of an inferred one. Basis and order do not "
            "matter to these two.",
        ),
    ] = 150,
    norm: Annotated[
        Literal["A", "B", "C", "D", "E"],
        typer.Option(
            help="Norm of the linear fit (the others: D). D: cosine-weighted in both directions; E: up to 80 degrees. "
            "See docs/norms.md."
        ),
    ] = "D",
    ridge: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="Weight of the spectral prior, which damps fine detail and holds angles that were not measured; 0 for "
            "none. exp: relative to the energy.",
        ),
    ] = 1e-5,
    valid: Annotated[
        bool,
        typer.Option("--valid", help="Linear: never negative, albedo at most 1, with a certificate of it."),
    ] = False,
    degree: Annotated[
        int | None,
        typer.Option(min=2, max=512, help="Of the rule that samples a table [default: 64, or 4 x order]."),
    ] = None,
    negatives: Negatives = "keep",
    max_steps: Annotated[int, typer.Option(min=1, help="Limit of steps of an iterative fit.")] = 100,
    out: Annotated[
        Path | None,
        typer.Option(
            help="A folder for model.hshjax, metrics.json and spheres.png; or a name that ends in .hshjax, for the "
            "model alone [default: FILE with suffix .hshjax]."
        ),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="PNG of spheres: the measurement, where it is a table, and the fit.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Fit a measured material and save the model.

    By default by an isotropic reciprocal basis: a linear least-squares problem, with nothing to tune but the basis, its
    order and the norm. Other models are fitted step by step, with a display of the loss. Angles that were not measured
    are extrapolated; which were is said.

    Examples:

      hshjax fit leather_rgb.bsdf --order 8 --out leather

      hshjax fit black_coating.txt --model inferred --out coating.hshjax

      hshjax fit plastic.binary --model compact --coefficients 100 --out plastic --json

    More is in docs/fit_a_material.md.
    """
    from hshjax import bases
    from hshjax.fitting import compare, fit_material
    from hshjax.io import coverage, read_material, save_model
    from hshjax.io._replace import replacing, replacing_folder
    from hshjax.samples import Samples

    if valid and model != "linear":
        raise Misuse(f"--valid is for the linear model; {model} is positive by construction")
    target = file.with_suffix(".hshjax") if out is None else out
    folder = target.suffix != ".hshjax"
    if out is None and target == file:
        raise failure(f"{file} is a model: say by --out where to save another")
    if folder:
        check_targets(picture, force=force, sources=(file,), folder=target, names=FILES)
    else:
        check_targets(target, picture, force=force, sources=(file,))

    figures = Figures()
    with complaints.status("reading"):
        data, found = read_material(file, negatives=negatives)
    if found is not None:
        describe_file(figures, found)
    beyond = None
    if isinstance(data, Samples):
        covered = coverage(data)
        describe_coverage(figures, covered)
        limits = f"beyond θ_i {covered.theta_i[1]:.4g} and θ_o {covered.theta_o[1]:.4g} degrees"
        beyond = f"values {limits} and between incidences are extrapolated"
    pairs = bases.IsotropicBasis(getattr(bases, FAMILIES[basis])(order))
    with _display(max_steps) as begin, complaints.status("fitting") if model in CLOSED else nullcontext():
        result = fit_material(
            data, model, basis=pairs, coefficients=coefficients, norm=norm, ridge=ridge,
            constraints=("non_negative", "energy") if valid else (),
            degree=max(64, 4 * order) if degree is None else degree, max_steps=max_steps, on_step=begin,
        )  # fmt: skip
    with complaints.status("measuring errors"):
        figures.add("model", model)
        describe_model(figures, result.model)
        where = "" if result.samples.degree is None else f" on a rule of degree {result.samples.degree}"
        figures.add("samples", result.samples.size, words=f"{result.samples.size}{where}")
        figures.add("fit_notes", result.notes, "decisions of the fit", "\n".join(result.notes) or "none")
        _details(figures, result.details)
        errors = compare(result.samples, result.model)
        for name, value in errors.errors.items():
            figures.add(f"relative_error_{name}", value, f"relative error, norm {name}", numbers(value))
        describe_log_error(figures, errors.log_error)
        describe_energy(figures, result.model)
        if beyond is not None:
            figures.add("extrapolated", beyond)
            if model == "linear":
                figures.add("advice", "a series rings between few incidences; --model inferred, or compact, does not")
    # Everything is written under hidden names first: what stops this leaves all as it was, and not a part of the files.
    with complaints.status("writing"), ExitStack() as last:
        if folder:
            beside = last.enter_context(replacing_folder(target))
            save_model(beside / "model.hshjax", result.model)
            (beside / "metrics.json").write_text(figures.json(), encoding="utf-8")
            save_spheres(beside / "spheres.png", *_shown(data, result.model))
        else:
            save_model(last.enter_context(replacing(target)), result.model)
        if picture is not None:
            save_spheres(last.enter_context(replacing(picture)), *_shown(data, result.model))
    figures.show(f"{file.name}: {model}", as_json=as_json)
    if not as_json:
        console.print(f"folder: {target}" if folder else f"model: {target}", soft_wrap=True)
        if picture is not None:
            console.print(f"picture: {picture}", soft_wrap=True)


CLOSED = ("linear", "compact", "inferred")
"""Models that are found in one go, without steps to show."""


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


@contextmanager
def _display(max_steps: int) -> Iterator[Callable[[str], Callable[[Any, Any], None]]]:
    """A live line a fit: its steps, its loss, the time that is left at most. Called with a name it gives `on_step`."""
    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(),
        TextColumn("loss {task.fields[loss]}", markup=False), TextColumn("at most"), TimeRemainingColumn(),
    )  # fmt: skip
    bars = Progress(*columns, console=complaints, transient=True)

    def on_step(step, loss):  # one function for all lines: it is a part of the compiled program
        bars.update(bars.task_ids[-1], completed=int(step) + 1, loss=f"{float(loss):.4g}")

    def begin(name: str) -> Callable[[Any, Any], None]:
        bars.start()  # not before: a fit in closed form has no steps
        bars.add_task(name, total=max_steps, loss="-")
        return on_step

    try:
        yield begin
    finally:
        if bars.live.is_started:  # to stop what has not begun prints an empty line
            bars.stop()


def _shown(data: Any, fitted: Any) -> list[Any]:
    """What spheres can show: scattered samples have no value everywhere."""
    from hshjax.samples import Samples

    return [fitted] if isinstance(data, Samples) else [data, fitted]


def save_spheres(path: Path, *brdfs: Any) -> None:
    """Spheres side by side, all exposed as the first one; of other than 1 or 3 channels the middle one, in grey."""
    import numpy as np

    from hshjax import plotting
    from hshjax.io._images import write_png

    images = [displayable(plotting.sphere(brdf)) for brdf in brdfs]
    shown = plotting.display(np.concatenate(images, axis=1), plotting.exposure(images[0]))
    write_png(path, np.rint(255 * shown).astype(np.uint8))


def displayable(image: Any) -> Any:
    """An image of 1 or 3 channels: of another number the middle one."""
    middle = image.shape[-1] // 2
    return image if image.shape[-1] in (1, 3) else image[..., middle : middle + 1]
