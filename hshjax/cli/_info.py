"""`hshjax info`: what a file holds."""

from pathlib import Path
from typing import Annotated

from rich.table import Table
from rich.text import Text

from hshjax.cli._console import Figures, Misuse, complaints, console, guarded, typer
from hshjax.cli._describe import describe_coverage, describe_energy, describe_file, describe_model
from hshjax.cli._options import Json


@guarded
def info(
    file: Annotated[
        Path,
        typer.Argument(
            help="A measured material in any format that is read, a model that `hshjax fit` saved, or a folder of them."
        ),
    ],
    energy: Annotated[
        bool | None,
        typer.Option(
            help="Evaluate the BRDF as well: albedo, smallest value.",
            show_default="of models, not of measured files",
        ),
    ] = None,
    recursive: Annotated[bool, typer.Option("--recursive", help="Of a folder: look into folders within it.")] = False,
    as_json: Json = False,
) -> None:
    """Say what a file holds: of a measured material its format, angles, channels, units, and what is wrong with it.

    Of a saved model: its kind and size, albedo, smallest value. Of a folder: which of its files are materials, by their
    first bytes, and why the others are none.

    Examples:

      hshjax info leather_rgb.bsdf

      hshjax info black_coating.txt --json

      hshjax info leather.hshjax

      hshjax info database/
    """
    from hshjax.io import coverage, read_material
    from hshjax.samples import Samples

    if file.is_dir():
        if energy is not None:
            raise Misuse("--energy and --no-energy are for one material")
        _list(file, recursive=recursive, as_json=as_json)
        return
    if recursive:
        raise Misuse(f"--recursive is for a folder; {file} is none")
    figures = Figures()
    with complaints.status("reading"):
        data, found = read_material(file)
    if found is not None:
        describe_file(figures, found)
    if isinstance(data, Samples):
        describe_coverage(figures, coverage(data))
        figures.add("samples", data.size)
    else:
        describe_model(figures, data)
        if energy or (energy is None and found is None):
            with complaints.status("integrating"):
                describe_energy(figures, data)
    figures.show(str(file), as_json=as_json)


def _list(folder: Path, *, recursive: bool, as_json: bool) -> None:
    """What there is in a folder, a line each."""
    from hshjax.io import list_materials

    listed = list_materials(folder, recursive=recursive)
    materials = sum(one.kind == "material" for one in listed)
    figures = Figures()
    figures.add("materials", materials)
    figures.add("entries", [{"name": x.name, "kind": x.kind, "format": x.format, "reason": x.reason} for x in listed])
    if as_json:
        figures.show(str(folder), as_json=True)
        return
    table = Table(title=Text(f"{folder}: {materials} materials of {len(listed)} entries"), title_justify="left")
    for heading in ("name", "kind", "format, or why it is none"):
        table.add_column(heading, overflow="fold")
    for one in listed:
        table.add_row(Text(one.name), one.kind, Text(one.format or one.reason))
    console.print(table)
