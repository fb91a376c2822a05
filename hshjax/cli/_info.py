"""`hshjax info`: what a file holds."""

from typing import Annotated

from hshjax.cli._console import Figures, complaints, guarded, typer
from hshjax.cli._describe import describe_coverage, describe_energy, describe_file, describe_model
from hshjax.cli._options import File, Json


@guarded
def info(
    file: File,
    energy: Annotated[
        bool | None,
        typer.Option(
            help="Evaluate the BRDF as well: albedo, smallest value [default: of models, not of measured files]."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what a file holds: of a measured material its format, angles, channels, units, and what is wrong with it.

    Of a saved model: its kind and size, albedo, smallest value.

    Examples:

      hshjax info leather_rgb.bsdf

      hshjax info black_coating.txt --json

      hshjax info leather.hshjax
    """
    from hshjax.io import coverage, read_material
    from hshjax.samples import Samples

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
