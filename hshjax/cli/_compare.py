"""`hshjax compare`: how far two materials are from one another."""

from pathlib import Path
from typing import Annotated

from hshjax.cli._console import Figures, check_targets, complaints, console, guarded, typer
from hshjax.cli._describe import describe_log_error, numbers
from hshjax.cli._options import Force, Json, Negatives


@guarded
def compare(
    reference: Annotated[Path, typer.Argument(help="A measured material or a saved model: errors are relative to it.")],
    candidate: Annotated[Path, typer.Argument(help="Another one, in the same channels.")],
    degree: Annotated[
        int, typer.Option(min=2, max=512, help="Of the rule, where neither holds scattered samples.")
    ] = 64,
    negatives: Negatives = "keep",
    picture: Annotated[
        Path | None, typer.Option(help="PNG of spheres, the reference on the left; of tables and models.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Errors of one material against another, in all norms: a fit against its measurement, a table against a model.

    Scattered samples are compared where they were measured, tables and models all over both hemispheres.

    Examples:

      hshjax compare leather_rgb.bsdf leather.hshjax --picture both.png

      hshjax compare black_coating.txt coating.hshjax --json
    """
    from hshjax.cli._spheres import save_spheres
    from hshjax.fitting import compare as compare_materials
    from hshjax.io import read_material
    from hshjax.samples import Samples

    check_targets(picture, force=force, sources=(reference, candidate))
    with complaints.status("reading"):
        a, b = (read_material(path, negatives=negatives).data for path in (reference, candidate))
    with complaints.status("comparing"):
        found = compare_materials(a, b, degree=degree)
    figures = Figures()
    figures.add("samples", found.samples)
    for name, value in found.errors.items():
        figures.add(f"relative_error_{name}", value, f"relative error, norm {name}", numbers(value))
    describe_log_error(figures, found.log_error)
    figures.add("largest_difference", found.largest, "largest |Δρ| cos θ_i cos θ_o [sr^-1]", numbers(found.largest))
    for key, label, rows in (
        ("reference_albedo", "albedo at 0, 45, 75 degrees, reference", found.reference_albedo),
        ("candidate_albedo", "albedo, candidate", found.albedo),
    ):
        if rows is not None:
            figures.add(key, rows, label, "   ".join(map(numbers, rows)))
    if picture is not None:
        save_spheres(picture, *(side for side in (a, b) if not isinstance(side, Samples)))
    figures.show(f"{candidate.name} against {reference.name}", as_json=as_json)
    if picture is not None and not as_json:
        console.print(f"picture: {picture}", soft_wrap=True)
