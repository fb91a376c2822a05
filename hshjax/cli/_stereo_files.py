"""The files that `hshjax stereo` leaves, but for the report."""

import json
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from hshjax import plotting
from hshjax.cli._stereo_metrics import Solved, directions, strength
from hshjax.geometry import direction
from hshjax.io import save_model, write_exr, write_normals, write_ply
from hshjax.io.normals import Convention
from hshjax.lighting import DirectionalLight
from hshjax.stereo import Stereo, height_from_normals
from hshjax.surface import Surface, height_field


def write_files(folder: Path, solved: Solved, convention: Convention) -> None:
    """Everything but report.html into a folder that is there."""
    stereo = solved.stereo
    write_normals(folder / "normals.exr", stereo.image(stereo.normals), convention)
    write_normals(folder / "normals.png", stereo.image(stereo.normals), convention)
    colour = albedos(stereo)
    write_exr(folder / "albedo.exr", stereo.image(colour), _names(colour.shape[1]))
    shown = shown_albedo(stereo, colour)
    from matplotlib.image import imsave

    imsave(folder / "albedo.png", shown)
    save_model(folder / "model.hshjax", stereo.brdf)
    places: dict[str, Any] = {} if stereo.positions is None else {"positions": stereo.positions}
    np.savez_compressed(
        folder / "weights.npz", **places, weights=stereo.weights, mask=stereo.mask, deviation=stereo.deviation,
        outliers=stereo.outliers, shadows=stereo.shadows, stray=stereo.stray,
    )  # fmt: skip
    _write_shape(folder, stereo, shown)
    _write_lights(folder, stereo.lights)
    text = json.dumps(solved.metrics, indent=2, allow_nan=False)
    (folder / "metrics.json").write_text(text + "\n", encoding="utf-8")


def albedos(stereo: Stereo) -> np.ndarray:
    """`(pixels, channels)`: π ρ for light at 45 degrees and an eye on the normal, up to the scale of photographs.

    Lambert's albedo, and for other materials what colour is measured by: no highlight is in it, and photographs hold
    such pairs of directions, while an integral over all would extrapolate. Source: CIE 15:2018, geometry 45:0.
    """
    wi, wo = direction(jnp.radians(jnp.asarray([45.0, 0.0])), jnp.zeros(2))
    of_materials = np.pi * np.asarray(stereo.brdf(wi, wo), np.float32)
    return np.einsum("nkc,k->nc", stereo.weights, of_materials)


def shown_albedo(stereo: Stereo, colour: np.ndarray) -> np.ndarray:
    """Display values `(rows, columns, 3)`, white outside the mask."""
    image = np.full((*stereo.mask.shape, colour.shape[1]), np.nan)
    image[stereo.mask] = colour
    image = displayable(image)
    return plotting.display(image, plotting.exposure(image)) if np.any(colour > 0) else plotting.display(image, 1.0)


def displayable(image: np.ndarray) -> np.ndarray:
    """1 or 3 channels: of other numbers, the mean."""
    return image if image.shape[-1] in (1, 3) else image.mean(axis=-1, keepdims=True)


def _names(channels: int) -> tuple[str, ...] | None:
    return None if channels in (1, 3) else tuple(f"channel{k}" for k in range(channels))


def _write_shape(folder: Path, stereo: Stereo, shown: np.ndarray) -> None:
    """Heights, NaN where there are none, and a mesh of them: in pixels, or where something is nearby as found."""
    normals = stereo.image(stereo.normals).astype(float)
    if stereo.positions is None:
        heights = height_from_normals(normals, stereo.mask)
        points = height_field(np.where(np.isfinite(heights), heights, 0)).position
    else:
        points = jnp.asarray(stereo.image(stereo.positions))
        heights = np.where(stereo.mask, stereo.image(stereo.positions)[..., 2], np.nan)
    write_exr(folder / "heights.exr", heights)
    known = np.isfinite(heights)
    surface = Surface(jnp.asarray(np.where(known[..., None], normals, 0), points.dtype), points)
    write_ply(folder / "mesh.ply", surface, colours=np.rint(255 * shown).astype(np.uint8))


def _write_lights(folder: Path, lights: Any) -> None:
    """Directions or positions as a light file, intensities as a table, a line a light: R G B, or one number."""
    far = isinstance(lights, DirectionalLight)
    towards = directions(lights) if far else np.asarray(lights.position, float)
    lines = [
        str(len(towards)),
        *(f"light_{k:03d} {x:.9f} {y:.9f} {z:.9f}" for k, (x, y, z) in enumerate(towards, 1)),
    ]
    (folder / "lights.lp").write_text("\n".join(lines) + "\n", encoding="utf-8")
    np.savetxt(folder / "light_intensities.txt", strength(lights), fmt="%.9g")
