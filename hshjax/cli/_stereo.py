"""`hshjax stereo`: from photographs to normals, materials, a mesh and a report."""

import inspect
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from hshjax.cli._console import Misuse, Text, check_targets, complaints, console, failure, guarded, typer

SOLVERS = {"known": "solve_calibrated", "unknown-intensities": "solve_semi_calibrated", "unknown": "solve_uncalibrated"}
"""What is known of the lights, and the function of `hshjax.stereo` for it."""


@guarded
def stereo(
    path: Annotated[
        Path,
        typer.Argument(
            help="Photographs of one object by a camera that stands still, each under one light: a folder in "
            "the layout of DiLiGenT, a folder of images with a light file (*.lp), that file, an archive .npz, or an "
            "OpenEXR image of many layers. See docs/photographs.md."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results; made, unless it is there and empty.")],
    lights: Annotated[
        Literal["known", "unknown-intensities", "unknown"],
        typer.Option(
            help="What is known of the lights. known: directions and intensities. unknown-intensities: directions. "
            "unknown: nothing; lights that the files tell then serve for comparison only."
        ),
    ] = "known",
    materials: Annotated[
        int, typer.Option(min=1, max=5, help="How many BRDFs the surface is mixed of, pixel by pixel.")
    ] = 2,
    encoding: Annotated[
        Literal["linear", "srgb"],
        typer.Option(help="Of values of 8 and 16 bits: linear in light, or sRGB, as most JPEG from a camera are."),
    ] = "linear",
    saturated: Annotated[
        Literal["drop", "keep"],
        typer.Option(help="Values at the top of the range: drop them as unknown, or keep them as they are."),
    ] = "drop",
    near: Annotated[
        float | None,
        typer.Option(
            help="The light file's vectors, times this, are positions of lights nearby, in the unit of the scene; "
            "their origin is where the middle of the image meets the object's mean depth. Wants --image-height."
        ),
    ] = None,
    image_height: Annotated[
        float | None,
        typer.Option(
            help="What the image spans from top to bottom at the object's mean depth, in the unit of the scene. With "
            "lights or a camera nearby.",
            show_default="its pixels, where only the camera is nearby",
        ),
    ] = None,
    field_of_view: Annotated[
        float | None,
        typer.Option(help="Of a camera nearby, from top to bottom of the image, in degrees; else it is far away."),
    ] = None,
    convention: Annotated[
        Literal["opengl", "directx", "camera"],
        typer.Option(help="Of the normal maps written: y up; y down; y down and z away from the viewer."),
    ] = "opengl",
    rounds: Annotated[
        int | None,
        typer.Option(min=0, help="Of learning materials; fewer are quicker.", show_default="the solver's"),
    ] = None,
    sweeps: Annotated[
        int | None,
        typer.Option(min=0, help="Of handing normals on between neighbours; 0 for none.", show_default="the solver's"),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the choice of pixels that materials are learned from.")] = 0,
    force: Annotated[
        bool, typer.Option("--force", help="Write into a folder that is not empty, over files of the same names.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print metrics.json, and nothing else, on standard output.")
    ] = False,
) -> None:
    """Find normals, materials and heights in photographs under many lights.

    The folder --out gets, when all is done:

    - report.html: look at this one first. metrics.json: its figures.

    - normals and albedo (.exr, .png), heights.exr, mesh.ply.

    - model.hshjax: a BRDF for each material, see `hshjax info`.

    - weights.npz: of materials, pixel by pixel. lights.lp and light_intensities.txt.

    Example:  hshjax stereo ballPNG --out ball

    Without lights:  hshjax stereo ballPNG --lights unknown --out ball2

    More is in docs/photometric_stereo.md.
    """
    from hshjax.cli._stereo_camera import with_camera
    from hshjax.cli._stereo_files import write_files
    from hshjax.cli._stereo_metrics import Solved
    from hshjax.cli._stereo_report import write_report
    from hshjax.io import read_photographs
    from hshjax.io._replace import replacing_folder

    _check_paths(path, out, force)
    chosen = {"rounds": rounds, "sweeps": sweeps}
    options = {
        "materials": materials,
        "seed": seed,
        **{key: value for key, value in chosen.items() if value is not None},
    }
    solve = _solver(lights, options)
    photographs = read_photographs(path, encoding=encoding, saturated=saturated, near=near)
    if photographs.lights is None and lights != "unknown":
        files = "a light file (*.lp) or light_directions.txt"
        raise ValueError(f"{path}: nothing is known of the lights; give {files}, or --lights unknown")
    given = with_camera(_hidden(photographs, lights), image_height, field_of_view)
    begin = time.perf_counter()
    with _display() as progress:
        found = solve(given, progress=progress, **options)
    solved = Solved.of(photographs, found, lights, time.perf_counter() - begin)
    with complaints.status("writing"), replacing_folder(out) as beside:
        write_files(beside, solved, convention)
        write_report(beside / "report.html", solved, path.absolute().name, {**options, "lights": lights})
    if as_json:
        typer.echo((out / "metrics.json").read_text(encoding="utf-8"), nl=False)
        return
    table = Table(title=Text(f"{path.absolute().name}: lights {lights}"), title_justify="left", show_header=False)
    for name, value in solved.words().items():
        table.add_row(name, Text(value))
    console.print(table)
    console.print(f"report: {out / 'report.html'}", soft_wrap=True)


def _check_paths(path: Path, out: Path, force: bool) -> None:
    """Exits where there is nothing to read, and where results cannot or must not be written: before any work."""
    if not path.exists():
        raise failure(f"{path}: there is no such file or folder")
    if out.exists() and out.resolve() in (path.resolve(), path.resolve().parent):
        raise failure(f"{out} holds the photographs: results go into another folder")
    check_targets(force=force, folder=out)


def _solver(lights: str, options: dict[str, Any]) -> Callable:
    """The solver for what is known of the lights; Misuse where this version has none or it has no such option."""
    import hshjax.stereo

    solve = getattr(hshjax.stereo, SOLVERS[lights], None)
    if solve is None:
        raise Misuse(f"--lights {lights} needs hshjax.stereo.{SOLVERS[lights]}, which this version does not have")
    parameters = inspect.signature(solve).parameters
    handed_on = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    for name in options:
        if name not in parameters and not handed_on:  # else to solve_calibrated, which has them all
            raise Misuse(f"--{name} means nothing with --lights {lights}")
    return solve


def _hidden(photographs, lights: str):
    """The photographs without what a solver is to find out by itself."""
    import dataclasses

    import jax
    import jax.numpy as jnp

    from hshjax.lighting import DirectionalLight, PointLight

    ones = jnp.ones(photographs.count)
    if lights == "unknown":
        return dataclasses.replace(photographs, lights=None)
    if lights == "unknown-intensities" and isinstance(photographs.lights, DirectionalLight):
        return dataclasses.replace(photographs, lights=jax.vmap(DirectionalLight)(photographs.lights.direction, ones))
    if lights == "unknown-intensities" and isinstance(photographs.lights, PointLight):
        return dataclasses.replace(photographs, lights=jax.vmap(PointLight)(photographs.lights.position, ones))
    return photographs


@contextmanager
def _display() -> Iterator[Callable[[str, int, int], None]]:
    """A live line for each stage; gives `progress`."""
    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
    )  # fmt: skip
    bars = Progress(*columns, console=complaints, transient=True)
    tasks: dict[str, Any] = {}

    def progress(stage: str, done: int, total: int) -> None:
        bars.start()  # not before: an error that comes first has the screen to itself
        if stage not in tasks:
            tasks[stage] = bars.add_task(stage, total=total)
        bars.update(tasks[stage], completed=done, total=total)

    try:
        yield progress
    finally:
        bars.stop()
