"""`hshjax render`: a picture of a material on a sphere or a mesh."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hshjax.cli._console import Figures, Misuse, check_targets, complaints, console, failure, guarded, typer
from hshjax.cli._options import File, Force, Json

MARGIN = 1.05
"""Height of the image over that of what it shows."""


@guarded
def render(
    file: File,
    out: Annotated[Path, typer.Option(help="x.exr: linear radiance, in float32, with alpha; x.png: exposed, in sRGB.")],
    light: Annotated[
        str,
        typer.Option(
            help="x,y,z: towards a light far away that gives the irradiance 1, in the frame of the image (x right, y "
            "up, z to the viewer). A file .exr: an environment map, up along y. furnace: 1 from everywhere, which "
            "shows the albedo."
        ),
    ] = "-0.5,0.5,0.7",
    mesh: Annotated[
        Path | None, typer.Option(help="A mesh (.ply, .obj, .stl ...) in place of the sphere; seen along -z, y up.")
    ] = None,
    size: Annotated[int, typer.Option(min=1, max=8192, help="Rows and columns of the picture.")] = 256,
    samples: Annotated[
        int, typer.Option(min=2, help="Directions a pixel, under light from all around: noise falls with their root.")
    ] = 256,
    seed: Annotated[int, typer.Option(min=0, help="Of these directions.")] = 0,
    exposure: Annotated[
        float | None,
        typer.Option(help="Factor of the radiance.", show_default="1 in EXR, one that fits in PNG"),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """A picture of a material: on a sphere or a mesh, under a light, a map of surroundings, or in a furnace.

    Scattered samples have no value between them: fit them first.

    Examples:

      hshjax render leather.hshjax --out leather.png

      hshjax render leather_rgb.bsdf --light venice.exr --samples 1024 --out leather.exr

      hshjax render leather.hshjax --light furnace --mesh bunny.ply --out albedo.png
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    from hshjax import plotting, surface
    from hshjax.camera import OrthographicCamera
    from hshjax.cli._spheres import displayable
    from hshjax.io import read_material
    from hshjax.reflectance import picture
    from hshjax.samples import Samples

    if out.suffix.lower() not in (".exr", ".png"):
        raise Misuse(f"--out {out}: a picture ends in .exr or .png")
    if exposure is not None and not (exposure > 0 and np.isfinite(exposure)):
        raise Misuse(f"--exposure must be a finite number above 0, got {exposure}")
    shining = _light(light)
    check_targets(out, force=force, sources=(file, mesh, _map(light)))
    with complaints.status("reading"):
        brdf, _ = read_material(file)
    if isinstance(brdf, Samples):
        raise failure(f"{file}: scattered samples have no value between them; hshjax fit {file}, and render the model")
    if mesh is None:
        camera = OrthographicCamera(
            (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), height=jnp.asarray(2 * MARGIN), resolution=(size, size)
        )
        seen = surface.sphere(camera)
    else:
        seen, camera = _mesh(mesh, size)
    with _progress() as progress:
        image = picture(brdf, shining, seen, camera, samples=samples, key=jax.random.key(seed), progress=progress)
    figures = Figures()
    figures.add("picture", str(out))
    figures.add("pixels", int(np.isfinite(image.radiance[..., 0]).sum()), "pixels on the shape")
    figures.add("mean_radiance", np.nanmean(image.radiance, axis=(0, 1)), "mean radiance [W m^-2 sr^-1]")
    if image.deviation is not None:
        noise = float(np.nanmean(image.deviation) / np.nanmean(np.abs(image.radiance)))
        figures.add("noise", noise, "noise, of the mean", f"{noise:.2%}")
    with complaints.status("writing"):
        if out.suffix.lower() == ".exr":
            plotting.write_picture(out, image.radiance, factor=exposure)
        else:
            shown = displayable(image.radiance)
            factor = plotting.exposure(shown) if exposure is None else exposure
            plotting.write_picture(out, shown, factor=factor)
            figures.add("exposure", factor)
    figures.show(f"{file.name} under {light}", as_json=as_json)
    if not as_json:
        console.print(f"picture: {out}", soft_wrap=True)


def _map(text: str) -> Path | None:
    """The file of an environment map, if an option names one."""
    return Path(text) if text.lower().endswith(".exr") else None


def _light(text: str) -> Any:
    """The light that an option names."""
    import jax.numpy as jnp
    import numpy as np

    from hshjax.io import read_exr
    from hshjax.lighting import DirectionalLight, EnvironmentMap
    from hshjax.reflectance import furnace

    if text == "furnace":
        return furnace()
    if _map(text) is not None:
        image = read_exr(text)
        if image.shape[-1] == 4:
            image = image[..., :3]  # alpha is no light
        if not np.isfinite(image).all():
            raise failure(f"{text}: an environment map needs finite pixels, {np.sum(~np.isfinite(image))} are not")
        return EnvironmentMap(jnp.asarray(image, float), up="y")
    try:
        direction = [float(part) for part in text.split(",")]
    except ValueError:
        direction = []
    if len(direction) != 3 or not np.isfinite(direction).all() or not np.any(direction):
        raise Misuse(f"--light {text}: three numbers x,y,z that are not all 0, a file .exr, or furnace")
    return DirectionalLight(jnp.asarray(direction), jnp.ones(()))


def _mesh(path: Path, size: int) -> tuple[Any, Any]:
    """What a camera on +z sees of a mesh, all of it in the image."""
    import jax.numpy as jnp
    import numpy as np

    from hshjax import surface
    from hshjax.camera import OrthographicCamera
    from hshjax.io import read_mesh

    vertices, faces = read_mesh(path)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    height = MARGIN * float(np.max((high - low)[:2]))
    if not height > 0:
        raise failure(f"{path}: seen along -z the mesh has no extent")
    centre = tuple(float(c) for c in (low + high) / 2)
    camera = OrthographicCamera(
        (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), centre=centre, height=jnp.asarray(height), resolution=(size, size)
    )
    return surface.mesh(camera, vertices, faces), camera


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """A live line of blocks of pixels."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=complaints, transient=True) as bar:
        task = bar.add_task("pixels", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
