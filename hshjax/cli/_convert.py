"""`hshjax convert`: the same material in another format."""

from pathlib import Path
from typing import Annotated

from hshjax.cli._console import Figures, Misuse, check_targets, complaints, console, guarded, typer
from hshjax.cli._options import File, Force, Json, Negatives


@guarded
def convert(
    source: File,
    target: Annotated[Path, typer.Argument(help="Where to; the suffix says the format, unless --to does.")],
    to: Annotated[str | None, typer.Option(help="Format of the target: one of those below, by its suffix.")] = None,
    negatives: Negatives = "keep",
    degree: Annotated[
        int, typer.Option(min=2, max=512, help="Of the rule that samples a model, where samples are written.")
    ] = 64,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write a material in another format.

    .binary (MERL), .bsdf (RGL), .csv (samples), .glsl (a shader function), .exr (slices), .hshjax (a model or a table).
    """
    from hshjax.io import read_material
    from hshjax.io.write_material import WRITERS, write_material, writer_suffix

    try:
        suffix = writer_suffix(target, to)
    except ValueError as error:
        raise Misuse(str(error)) from error
    check_targets(target, force=force, sources=(source,))
    with complaints.status("reading"):
        data, _ = read_material(source, negatives=negatives)
    figures = Figures()
    with complaints.status("writing"):
        write_material(target, data, to=suffix, degree=degree)
    figures.add("format", suffix, words=f"{suffix}, {WRITERS[suffix].words}")
    figures.add("bytes", target.stat().st_size)
    figures.show(f"{source.name} → {target.name}", as_json=as_json)
    if not as_json:
        console.print(f"file: {target}", soft_wrap=True)
