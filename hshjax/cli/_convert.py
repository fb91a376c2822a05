"""`hshjax convert`: the same material in another format."""

from pathlib import Path
from typing import Annotated

from hshjax.cli._console import Figures, Misuse, check_targets, complaints, console, failure, guarded, typer
from hshjax.cli._options import File, Force, Json, Negatives

SLICE = ".exr"
SLICED = "ρ over half and difference angle as an image"


@guarded
def convert(
    source: File,
    target: Annotated[Path, typer.Argument(help="Where to; the suffix says the format, unless --to does.")],
    to: Annotated[str | None, typer.Option(help="Format of the target: one of those below, by its suffix.")] = None,
    negatives: Negatives = "keep",
    degree: Annotated[
        int | None,
        typer.Option(
            min=2,
            max=512,
            help="Of the rule that samples a material, where samples are written; 64, of anisotropic ones 16.",
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write a material in another format.

    .binary (MERL), .bsdf (RGL), .csv (samples), .glsl (a function for shaders, of a fitted model), .hshjax (a model or
    a table), .exr (its slice over half and difference angle; alpha is 0 where nothing was measured). A single channel
    is grey, and becomes R, G and B where a format has only these; channels named by wavelengths ("650 nm") become a
    spectral .bsdf.

    Examples:

      hshjax convert leather.hshjax leather.binary --negatives clip

      hshjax convert leather.hshjax leather.glsl

      hshjax convert black_coating.txt coating.csv
    """
    import numpy as np

    from hshjax import plotting
    from hshjax.io import read_material
    from hshjax.io.write_material import WRITERS, write_material, writer_suffix
    from hshjax.samples import Samples

    sliced = (target.suffix.lower() if to is None else "." + to.lower().removeprefix(".")) == SLICE
    try:
        suffix = SLICE if sliced else writer_suffix(target, to)
    except ValueError as error:
        raise Misuse(f"{error}, {SLICE} ({SLICED})") from error
    check_targets(target, force=force, sources=(source,))
    with complaints.status("reading"):
        data, found = read_material(source, negatives=negatives)
    figures, notes = Figures(), ()
    with complaints.status("writing"):
        if not sliced:
            notes = write_material(target, data, found=found, to=suffix, degree=degree, negatives=negatives)
        elif isinstance(data, Samples):
            raise failure(
                f"{source}: scattered samples have no value between them; hshjax fit it, and convert the model"
            )
        else:
            image = plotting.slice_image(data)
            endless = int(np.isinf(image).any(axis=-1).sum())
            if endless:
                raise failure(f"{source}: an image of it needs finite values, {endless} pixels have none")
            plotting.write_picture(target, image, suffix=SLICE)
    figures.add("format", suffix, words=f"{suffix}, {SLICED if sliced else WRITERS[suffix].words}")
    figures.add("bytes", target.stat().st_size)
    if notes:
        figures.add("notes", notes, words="\n".join(notes))
    figures.show(f"{source.name} → {target.name}", as_json=as_json)
    if not as_json:
        console.print(f"file: {target}", soft_wrap=True)
