"""The `hshjax` command: look at a measured material, fit it, keep the model."""

import sys
from pathlib import Path
from typing import Annotated, Literal

try:
    import typer
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text
except ModuleNotFoundError as missing:
    sys.exit(f"the hshjax command needs {missing.name}: pip install 'hshjax[experiments]'")

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    help="Compact, reciprocal reflectance: fit measured materials in closed form.",
    epilog="Examples:  hshjax info leather.bsdf  ·  hshjax fit leather.bsdf --order 8 --out leather.hshjax",
)
# No markup: paths and what files say of themselves may hold brackets.
console = Console(highlight=False, markup=False)
complaints = Console(highlight=False, markup=False, stderr=True)

File = Annotated[Path, typer.Argument(help="A measured material (RGL .bsdf) or a model that `hshjax fit` saved.")]
FAMILIES = {"hsh": "HSH", "zernike": "Zernike", "shr": "SHR"}


@app.command()
def info(file: File) -> None:
    """Say what a file holds: material, channels, range of values, albedo, how reciprocal it is."""
    brdf, facts = _read(file)
    table = Table(title=Text(str(file)), title_justify="left", show_header=False)
    for name, value in {**facts, **_figures(brdf)}.items():
        table.add_row(name, Text(value))
    console.print(table)


@app.command()
def fit(
    file: File,
    basis: Annotated[Literal["hsh", "zernike", "shr"], typer.Option(help="Family of the basis.")] = "hsh",
    order: Annotated[int, typer.Option(min=0, help="Order of the basis.")] = 8,
    norm: Annotated[
        Literal["A", "B", "C", "D", "E"],
        typer.Option(
            help="Norm of the fit. D: cosine-weighted in both directions; E: up to 80 degrees. See docs/norms.md."
        ),
    ] = "D",
    ridge: Annotated[
        float, typer.Option(min=0.0, help="Weight of the spectral prior, which damps fine detail; 0 for none.")
    ] = 1e-5,
    degree: Annotated[
        int | None,
        typer.Option(min=2, help="Degree of the rule that samples the material [default: 64, or 4 x order]."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Where to save the model, over what is there [default: FILE with suffix .hshjax]."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="PNG of a sphere: the measurement on the left, the fit right.")
    ] = None,
) -> None:
    """Fit a measured material by an isotropic reciprocal basis and save the model.

    The fit is a linear least-squares problem: there is nothing to tune but the basis, its order and the norm.
    """
    from hshjax import bases
    from hshjax.fitting import project, relative_error
    from hshjax.io import save_model
    from hshjax.quadrature import isotropic_pair_rule
    from hshjax.samples import Samples

    brdf, _ = _read(file)
    if out is None:
        out = file.with_suffix(".hshjax")
        if out.exists():
            raise _exit(f"{out} is there already: say where to save by --out (--out {out} to replace it)")
    for target in (out, picture):
        if target is not None and not target.absolute().parent.is_dir():
            raise _exit(f"{target}: there is no folder {target.absolute().parent}")
    pairs = bases.IsotropicBasis(getattr(bases, FAMILIES[basis])(order))
    try:
        with complaints.status("sampling and fitting"):
            rule = isotropic_pair_rule(max(64, 4 * order) if degree is None else degree)
            samples = Samples.from_function(brdf, rule)
            result = project(pairs, samples, norm=norm, ridge=ridge, prior="spectral" if ridge else None)
        save_model(out, result.model)
    except (OSError, ValueError) as error:
        raise _exit(str(error)) from error

    table = Table(title=f"{pairs.basis}, isotropic", title_justify="left", show_header=False)
    table.add_row("coefficients", f"{result.unknowns} x {samples.channels} channels")
    table.add_row("samples", f"{result.samples} on a rule of degree {rule.degree}")
    table.add_row(f"relative error, norm {norm}", _numbers(result.relative))
    table.add_row("relative error, norm E", _numbers(relative_error(result.model, samples, "E")))
    table.add_row("condition number", f"{float(result.condition):.3g} ({result.method})")
    for name, error in (("measured", result.reciprocity_before), ("fitted", result.reciprocity_after)):
        if error is not None:
            table.add_row(f"violation of reciprocity, {name}", f"{float(error.relative):.3g} ({error.pairs} pairs)")
    for name, value in _figures(result.model).items():
        table.add_row(name, value)
    console.print(table)
    console.print(f"model: {out}")
    if picture is not None:
        try:
            _save_spheres(picture, brdf, result.model)
        except (OSError, ValueError) as error:
            raise _exit(f"{picture}: {error}") from error
        console.print(f"picture: {picture}")


def _read(file: Path) -> tuple:
    """The BRDF of a measured file or a saved model, and what to say of it; exits with a message where it cannot."""
    from hshjax.brdfs import AbstractBRDF, LinearBRDF, RGLTable
    from hshjax.io import load_model, read_rgl

    try:
        with file.open("rb") as stream:
            head = stream.read(11)
        if head != b"tensor_file" and not head.startswith(b"{"):
            raise _exit(f"{file}: expected an RGL material (tensor_file) or a saved model, got a file of {head!r}...")
        brdf = read_rgl(file) if head == b"tensor_file" else load_model(file)
    except (OSError, ValueError) as error:
        raise _exit(str(error)) from error
    if not isinstance(brdf, AbstractBRDF):
        raise _exit(f"{file}: expected a BRDF, got a saved {type(brdf).__name__}")
    facts = {"kind": type(brdf).__name__}
    if isinstance(brdf, RGLTable):
        facts |= {"material": brdf.description, "channels": ", ".join(brdf.channel_names)}
    if isinstance(brdf, LinearBRDF):
        facts |= {
            "basis": str(brdf.basis),
            "coefficients": f"{brdf.basis.count} x {brdf.channels} channels",
            "the series stands for": brdf.target,
        }
    return brdf, facts


def _exit(message: str) -> Exception:
    complaints.print(Text("error:", style="bold red"), message, soft_wrap=True)
    return typer.Exit(2)


def _figures(brdf) -> dict[str, str]:
    """Report figures of a BRDF, over directions up to 80 degrees where that matters."""
    import jax.numpy as jnp

    from hshjax.geometry import direction
    from hshjax.metrics import albedo, hemispherical_albedo, negativity
    from hshjax.quadrature import hemisphere_rule, isotropic_pair_rule

    theta = jnp.deg2rad(jnp.asarray([0.0, 45.0, 75.0]))
    rule = hemisphere_rule(64)
    directional = albedo(brdf, direction(theta, jnp.zeros_like(theta)), rule)
    negative = negativity(brdf, isotropic_pair_rule(32))
    return {
        "albedo at 0, 45, 75 degrees": "   ".join(_numbers(a) for a in directional),
        "hemispherical albedo": _numbers(hemispherical_albedo(brdf, hemisphere_rule(32))),
        "smallest value": f"{float(negative.minimum):.3g} sr^-1",
        "negative share of the energy": f"{float(negative.share):.2g}",
    }


def _numbers(values) -> str:
    return " ".join(f"{float(v):.4f}" for v in values)


def _save_spheres(path: Path, measured, fitted) -> None:
    import numpy as np
    from matplotlib.image import imsave

    from hshjax import plotting

    images = [plotting.sphere(brdf) for brdf in (measured, fitted)]
    factor = plotting.exposure(images[0])
    imsave(path, np.concatenate([plotting.display(image, factor) for image in images], axis=1))


def main() -> None:
    """Entry point of the console script."""
    import jax

    # A command line owns its process, so it may choose: figures are computed in double precision.
    jax.config.update("jax_enable_x64", True)
    app()
