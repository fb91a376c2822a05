"""`hshjax fit`: from a measured material to a saved model, in numbers and pictures."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Annotated, Any, Literal

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hshjax.cli._console import Figures, Misuse, check_targets, complaints, console, failure, guarded, typer
from hshjax.cli._fit_figures import describe_data, describe_fit
from hshjax.cli._options import Force, Json, Negatives
from hshjax.cli._spheres import save_spheres, shown

FILES = ("model.hshjax", "metrics.json", "spheres.png")
"""In the folder of a result."""

FAMILIES = {"hsh": "HSH", "zernike": "Zernike", "shr": "SHR"}


@guarded
def fit(
    file: Annotated[
        Path,
        typer.Argument(
            help="A measured material in any format that is read, or a model that `hshjax fit` saved; or a folder of "
            "them, with --out."
        ),
    ],
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
        typer.Option(min=2, max=512, help="Of the rule that samples a table.", show_default="64, or 4 x order"),
    ] = None,
    negatives: Negatives = "keep",
    max_steps: Annotated[int, typer.Option(min=1, help="Limit of steps of an iterative fit.")] = 100,
    out: Annotated[
        Path | None,
        typer.Option(
            help="A folder for model.hshjax, metrics.json and spheres.png; or a name that ends in .hshjax, for the "
            "model alone. Of a folder: a folder for one such folder a file, and summary.csv, summary.json, "
            "report.html.",
            show_default="FILE with suffix .hshjax",
        ),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="PNG of spheres: the measurement, where it is a table, and the fit.")
    ] = None,
    recursive: Annotated[bool, typer.Option("--recursive", help="Of a folder: look into folders within it.")] = False,
    devices: Annotated[
        int,
        typer.Option(
            min=1, help="Of a folder: so many GPUs, which the materials go round over; on a CPU, so many threads."
        ),
    ] = 1,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Fit a measured material and save the model.

    By default by an isotropic reciprocal basis: a linear least-squares problem, with nothing to tune but the basis, its
    order and the norm. Other models are fitted step by step, with a display of the loss. Angles that were not measured
    are extrapolated; which were is said.

    Of a folder every material is fitted. Given again, the command goes on with what is missing; --force fits anew what
    was made with other options, or of another content of the file.

    Examples:

      hshjax fit leather_rgb.bsdf --order 8 --out leather

      hshjax fit black_coating.txt --model inferred --out coating.hshjax

      hshjax fit plastic.binary --model compact --coefficients 100 --out plastic --json

      hshjax fit database/ --model compact --out fits

    More is in docs/fit_a_material.md.
    """
    from hshjax import bases
    from hshjax.fitting import compare, fit_material
    from hshjax.io import read_material, save_model
    from hshjax.io._replace import replacing, replacing_folder

    if valid and model != "linear":
        raise Misuse(f"--valid is for the linear model; {model} is positive by construction")
    settings: dict[str, Any] = {
        "model": model, "basis": bases.IsotropicBasis(getattr(bases, FAMILIES[basis])(order)),
        "coefficients": coefficients, "norm": norm, "ridge": ridge,
        "constraints": ("non_negative", "energy") if valid else (),
        "degree": max(64, 4 * order) if degree is None else degree, "max_steps": max_steps,
    }  # fmt: skip
    if file.is_dir():
        from hshjax.cli._fit_folder import fit_all

        if picture is not None:
            raise Misuse("--picture is for one material; the results of a folder have spheres.png")
        more = {"negatives": negatives, "recursive": recursive, "force": force}
        fit_all(file, out, settings | more, devices=devices, as_json=as_json)
        return
    if recursive or devices > 1:
        raise Misuse(f"--recursive and --devices are for a folder of materials; {file} is none")
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
    beyond = describe_data(figures, data, found)
    with _display(max_steps) as begin, complaints.status("fitting") if model in CLOSED else nullcontext():
        result = fit_material(data, **settings, on_step=begin)
    with complaints.status("measuring errors"):
        describe_fit(figures, model, result, compare(result.samples, result.model), beyond)
    # Everything is written under hidden names first: what stops this leaves all as it was, and not a part of the files.
    with complaints.status("writing"), ExitStack() as last:
        if folder:
            beside = last.enter_context(replacing_folder(target))
            save_model(beside / "model.hshjax", result.model)
            (beside / "metrics.json").write_text(figures.json(), encoding="utf-8")
            save_spheres(beside / "spheres.png", *shown(data, result.model))
        else:
            save_model(last.enter_context(replacing(target)), result.model)
        if picture is not None:
            save_spheres(last.enter_context(replacing(picture)), *shown(data, result.model))
    figures.show(f"{file.name}: {model}", as_json=as_json)
    if not as_json:
        console.print(f"folder: {target}" if folder else f"model: {target}", soft_wrap=True)
        if picture is not None:
            console.print(f"picture: {picture}", soft_wrap=True)


CLOSED = ("linear", "compact", "inferred")
"""Models that are found in one go, without steps to show."""


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
