"""Commands on materials: say what a file holds, fit it, keep the model."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from hshjax.cli._console import Text, complaints, console, failure, typer

File = Annotated[Path, typer.Argument(help="A measured material (RGL .bsdf) or a model that `hshjax fit` saved.")]
FAMILIES = {"hsh": "HSH", "zernike": "Zernike", "shr": "SHR"}


def info(file: File) -> None:
    """Say what a file holds: material, channels, range of values, albedo, how reciprocal it is."""
    brdf, facts = _read(file)
    table = Table(title=Text(str(file)), title_justify="left", show_header=False)
    for name, value in {**facts, **_figures(brdf)}.items():
        table.add_row(name, Text(value))
    console.print(table)


def fit(
    file: File,
    model: Annotated[
        Literal["linear", "compact", "exp", "cook-torrance", "ggx"],
        typer.Option(
            help="linear: a series in the basis, in closed form. compact: a positive one in the half vector, in closed "
            "form, for highlights too. exp: the exponential of a series in the basis, which is positive. "
            "cook-torrance, ggx: that lobe and a diffuse part, from many starts."
        ),
    ] = "linear",
    basis: Annotated[Literal["hsh", "zernike", "shr"], typer.Option(help="Family of the basis.")] = "hsh",
    order: Annotated[int, typer.Option(min=0, help="Order of the basis.")] = 8,
    coefficients: Annotated[
        int, typer.Option(min=3, help="Of a compact model, all channels together; basis and order do not matter to it.")
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
            help="Weight of the spectral prior, which damps fine detail; 0 for none. exp: relative to the energy.",
        ),
    ] = 1e-5,
    valid: Annotated[
        bool,
        typer.Option("--valid", help="Linear: never negative, albedo at most 1, with a certificate of it."),
    ] = False,
    degree: Annotated[
        int | None,
        typer.Option(min=2, help="Degree of the rule that samples the material [default: 64, or 4 x order]."),
    ] = None,
    max_steps: Annotated[int, typer.Option(min=1, help="Limit of steps of an iterative fit.")] = 100,
    out: Annotated[
        Path | None,
        typer.Option(help="Where to save the model, over what is there [default: FILE with suffix .hshjax]."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="PNG of a sphere: the measurement on the left, the fit right.")
    ] = None,
) -> None:
    """Fit a measured material and save the model.

    By default by an isotropic reciprocal basis: a linear least-squares problem, with nothing to tune but the basis, its
    order and the norm. Other models are fitted step by step, with a display of the loss.
    """
    from hshjax import bases
    from hshjax.fitting import relative_error
    from hshjax.io import save_model
    from hshjax.quadrature import isotropic_pair_rule
    from hshjax.samples import Samples

    brdf, _ = _read(file)
    if valid and model != "linear":
        raise failure(f"--valid is for the linear model; {model} is positive by construction")
    if out is None:
        out = file.with_suffix(".hshjax")
        if out.exists():
            raise failure(f"{out} is there already: say where to save by --out (--out {out} to replace it)")
    for target in (out, picture):
        if target is not None and not target.absolute().parent.is_dir():
            raise failure(f"{target}: there is no folder {target.absolute().parent}")
    pairs = bases.IsotropicBasis(getattr(bases, FAMILIES[basis])(order))
    rule = isotropic_pair_rule(max(64, 4 * order) if degree is None else degree)
    try:
        with complaints.status("sampling"):
            samples = Samples.from_function(brdf, rule)
        if model == "linear":
            fitted, facts = _linear(pairs, samples, norm, ridge, valid)
        elif model == "compact":
            fitted, facts = _compact(brdf, coefficients)
        elif model == "exp":
            fitted, facts = _exponential(pairs, samples, ridge, max_steps)
        else:
            fitted, facts = _parametric(model, samples, max_steps)
        save_model(out, fitted)
    except (OSError, ValueError) as error:
        raise failure(str(error)) from error

    table = Table(title=f"{file.name}: {model}", title_justify="left", show_header=False)
    facts |= {
        "samples": f"{samples.size} on a rule of degree {rule.degree}",
        f"relative error, norm {norm}": _numbers(relative_error(fitted, samples, norm)),
        "relative error, norm E": _numbers(relative_error(fitted, samples, "E")),
    }
    for name, value in (facts | _figures(fitted)).items():
        table.add_row(name, value)
    console.print(table)
    console.print(f"model: {out}")
    if picture is not None:
        try:
            _save_spheres(picture, brdf, fitted)
        except (OSError, ValueError) as error:
            raise failure(f"{picture}: {error}") from error
        console.print(f"picture: {picture}")


def _linear(pairs, samples, norm: str, ridge: float, valid: bool) -> tuple[Any, dict[str, str]]:
    from hshjax.fitting import project

    with complaints.status("fitting"):
        result = project(
            pairs, samples, norm=norm, ridge=ridge, prior="spectral" if ridge else None,
            constraints=("non_negative", "energy") if valid else (),
        )  # fmt: skip
    facts = {
        "basis": f"{pairs.basis}, isotropic",
        "coefficients": f"{result.unknowns} x {samples.channels} channels",
        "condition number": f"{float(result.condition):.3g} ({result.method})",
    }
    if result.certificate is not None:
        smallest, largest = float(result.certificate.smallest.min()), float(result.certificate.albedo.max())
        verdict = "holds" if result.certificate.holds else "DOES NOT HOLD"
        facts["certificate"] = f"{verdict}: smallest value {smallest:.2g} sr^-1, largest albedo {largest:.7f}"
    for name, error in (("measured", result.reciprocity_before), ("fitted", result.reciprocity_after)):
        if error is not None:
            facts[f"violation of reciprocity, {name}"] = f"{float(error.relative):.3g} ({error.pairs} pairs)"
    return result.model, facts


def _compact(brdf, coefficients: int) -> tuple[Any, dict[str, str]]:
    from hshjax.fitting import fit_compact
    from hshjax.metrics import reciprocity_error

    with complaints.status("fitting"):
        result = fit_compact(brdf, coefficients)
    facts = {
        "fitted to": f"{result.samples} samples that follow the highlight",
        "log error": f"{1e3 * result.log_error:.3g} / 1000, mean |Δ ln(1 + ρ cos θ)| over them",
        "violation of reciprocity, measured": f"{float(reciprocity_error(brdf).relative):.3g}; fitted: 0",
        "largest albedo": f"{result.albedo:.4f}, up to 80 degrees",
        "below the floor": f"{result.floored:.2%} of their values",
    }
    return result.model, _series(result.model) | facts


def _exponential(pairs, samples, ridge: float, max_steps: int) -> tuple[Any, dict[str, str]]:
    import equinox as eqx
    import jax.numpy as jnp

    from hshjax.brdfs import ExpBRDF
    from hshjax.fitting import CosineWeighted, SampleMisfit, Smoothness, fit as fit_model, positive_start

    found = []
    with _display(max_steps) as channel:
        for k in range(samples.channels):  # channels do not touch: each is a fit of its own
            one = eqx.tree_at(lambda s: s.value, samples, samples.value[:, k : k + 1])
            start = positive_start(ExpBRDF, pairs, one)
            energy = jnp.sum(one.weight * (one.wi[:, 2] * one.wo[:, 2] * one.value[:, 0]) ** 2)
            objective = {"data": SampleMisfit(one, CosineWeighted()), "smooth": ridge * energy * Smoothness()}
            on_step = channel(f"channel {k + 1} of {samples.channels}")
            found.append(fit_model(start, objective, max_steps=max_steps, throw=False, on_step=on_step))
    model = ExpBRDF(pairs, jnp.concatenate([one.model.coefficients for one in found], axis=1))
    facts = {"basis": f"{pairs.basis}, isotropic", "coefficients": f"{pairs.count} x {samples.channels} channels"}
    return model, facts | _endings(found)


def _parametric(name: str, samples, max_steps: int) -> tuple[Any, dict[str, str]]:
    import jax.numpy as jnp

    from hshjax.brdfs import GGX, CookTorrance, Lambert
    from hshjax.fitting import CosineWeighted, SampleMisfit, fit as fit_model, initial_guesses, multi_start

    colour = jnp.zeros(samples.channels)
    template = (
        CookTorrance(colour, colour, jnp.asarray(0.3))
        if name == "cook-torrance"
        else Lambert(colour) + GGX(colour, jnp.asarray(0.3))
    )
    objective = {"data": SampleMisfit(samples, CosineWeighted())}
    with complaints.status("looking for a start"):
        ahead = multi_start(initial_guesses(template, samples), objective, max_steps=1, throw=False).best.model
    with _display(max_steps) as line:
        found = fit_model(ahead, objective, max_steps=max_steps, throw=False, on_step=line(name))
    parameters = {key: _numbers(value.ravel()) for key, value in _parameters(found.model).items()}
    return found.model, parameters | _endings([found])


def _parameters(model) -> dict[str, Any]:
    """The arrays of a model by their names."""
    import jax

    from hshjax.fitting._bounds import path_name

    return {path_name(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(model)}


def _endings(found: list) -> dict[str, str]:
    """How iterative fits ended, in words, the same ones once."""
    return {
        "fit": "; ".join(dict.fromkeys(one.message for one in found)),
        "steps": " ".join(str(int(one.steps)) for one in found),
    }


@contextmanager
def _display(max_steps: int) -> Iterator[Callable[[str], Callable[[Any, Any], None]]]:
    """A live line a fit: its steps, its loss, the time that is left at most. Called with a name it gives `on_step`."""
    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(),
        TextColumn("loss {task.fields[loss]}", markup=False), TextColumn("at most"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=complaints, transient=True) as bars:

        def on_step(step, loss):  # one function for all lines: it is a part of the compiled program
            bars.update(bars.task_ids[-1], completed=int(step) + 1, loss=f"{float(loss):.4g}")

        def line(name: str) -> Callable[[Any, Any], None]:
            bars.add_task(name, total=max_steps, loss="-")
            return on_step

        yield line


def _read(file: Path) -> tuple:
    """The BRDF of a measured file or a saved model, and what to say of it; exits with a message where it cannot."""
    from hshjax.brdfs import AbstractBRDF, AbstractPositiveBRDF, LinearBRDF, LogLinearBRDF, RGLTable
    from hshjax.io import load_model, read_rgl

    try:
        with file.open("rb") as stream:
            head = stream.read(11)
        if head != b"tensor_file" and not head.startswith(b"{"):
            raise failure(f"{file}: expected an RGL material (tensor_file) or a saved model, got a file of {head!r}...")
        brdf = read_rgl(file) if head == b"tensor_file" else load_model(file)
    except (OSError, ValueError) as error:
        raise failure(str(error)) from error
    if not isinstance(brdf, AbstractBRDF):
        raise failure(f"{file}: expected a BRDF, got a saved {type(brdf).__name__}")
    facts = {"kind": type(brdf).__name__}
    if isinstance(brdf, RGLTable):
        facts |= {"material": brdf.description, "channels": ", ".join(brdf.channel_names)}
    if isinstance(brdf, LogLinearBRDF):
        facts |= _series(brdf)
    if isinstance(brdf, LinearBRDF | AbstractPositiveBRDF):
        facts |= {"basis": str(brdf.basis), "coefficients": " x ".join(map(str, brdf.coefficients.shape))}
    if isinstance(brdf, LinearBRDF):
        facts["the series stands for"] = brdf.target
    return brdf, facts


def _series(brdf) -> dict[str, str]:
    """What there is to say of a `LogLinearBRDF`."""
    from hshjax.bases import AnisotropicHalfVectorBasis, HalfVectorBasis
    from hshjax.bases._warp import AbstractScaledWarp

    parts = [str(int((brdf.terms[:, 1] == j).sum())) for j in range(brdf.mixing.shape[0])]
    facts = {"coefficients": f"{brdf.count}: {' + '.join(parts)}, of {brdf.basis.count} functions each"}
    if isinstance(brdf.basis, HalfVectorBasis | AnisotropicHalfVectorBasis):
        warps = {"scale of the warp": brdf.basis.warp, "scale of the difference warp": brdf.basis.difference_warp}
        for name, warp in warps.items():
            if isinstance(warp, AbstractScaledWarp):
                facts[name] = f"{float(warp.alpha):.3g} ({type(warp).__name__})"
    return facts


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
