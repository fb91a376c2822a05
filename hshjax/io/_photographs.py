"""What all readers of photographs share: from decoded images and vectors of lights to `Photographs` and its notes."""

from collections.abc import Iterable
from os import PathLike
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Bool, Float
from hshjax.io.errors import FileFormatError
from hshjax.lighting import AbstractLighting, DirectionalLight, PointLight
from hshjax.photographs import Photographs

Saturated = Literal["drop", "keep"]
Encoding = Literal["linear", "srgb"]

UNIT = 1e-3
"""Deviation from length 1 that rounding to four digits explains."""

PILE = 100
"""So many values at the maximum are mentioned if they are five times those in the hundredth below it."""


def check_options(saturated: str, encoding: str = "linear") -> None:
    """ValueError for words that are not known."""
    if saturated not in ("drop", "keep"):
        raise ValueError(f'saturated must be "drop" or "keep", got {saturated!r}')
    if encoding not in ("linear", "srgb"):
        raise ValueError(f'encoding must be "linear" or "srgb", got {encoding!r}')


def assemble(
    images: Iterable[tuple[str | PathLike, np.ndarray]],
    count: int,
    *,
    lights: AbstractLighting | None,
    mask: Bool[np.ndarray, "rows columns"] | None,
    mask_file: str | PathLike = "mask",
    truth: Float[np.ndarray, "rows columns 3"] | None = None,
    saturated: Saturated = "drop",
    encoding: Encoding = "linear",
    notes: Iterable[str] = (),
) -> Photographs:
    """Photographs from `count` images, each with the name for messages, decoded one at a time.

    Integers are divided by the top of their range, then decoded from sRGB where `encoding` says so. The top itself is
    saturated: NaN where it is dropped. Floats are taken as they are, NaN where they are not finite.

    **Raises:** FileFormatError for images that differ from the first in size, channels or type, for a mask of another
    size, and where no image shows any light.
    """
    check_options(saturated, encoding)
    values: np.ndarray | None = None
    first: tuple[str | PathLike, np.ndarray] | None = None
    lost, dark, blind = 0, [], []
    for k, (file, pixels) in enumerate(images):
        if first is None or values is None:
            first = file, pixels
            if pixels.dtype.kind == "f" and encoding == "srgb":
                raise ValueError(f'encoding "srgb" is one of integers, and {file} holds {pixels.dtype}')
            if mask is None:
                mask = np.ones(pixels.shape[:2], bool)
            elif mask.shape != pixels.shape[:2]:
                expected = f"(rows, columns) = {pixels.shape[:2]}, those of {file}"
                raise FileFormatError(mask_file, "size", expected, str(mask.shape))
            if truth is not None and truth.shape[:2] != mask.shape:
                expected = f"(rows, columns) = {mask.shape}, those of {file}"
                raise FileFormatError(file, "true normals", expected, str(truth.shape[:2]))
            values = np.empty((int(mask.sum()), count, pixels.shape[2]), np.float32)
        if pixels.shape != first[1].shape or pixels.dtype != first[1].dtype:
            expected = f"(rows, columns, channels) = {first[1].shape} of {first[1].dtype}, as {first[0]}"
            raise FileFormatError(file, "image", expected, f"{pixels.shape} of {pixels.dtype}")
        values[:, k], bad = _linear(pixels[mask], encoding, drop=saturated == "drop")
        lost += bad
        if np.all(np.isnan(values[:, k])):
            blind.append(str(file))
        elif not np.nanmax(values[:, k]) > 0:
            dark.append(str(file))
    if first is None or values is None or mask is None:
        raise FileFormatError(mask_file, "images", "at least 1", "none")
    if len(dark) + len(blind) == count:
        raise FileFormatError(first[0], "images", "light in at least one of them", f"none in {count}")
    found = [*notes, *_found(values, first[1], lost, saturated, encoding)]
    if dark:
        found.append(f"No light inside the mask in {len(dark)} photographs: {_few(dark)}.")
    if blind:
        found.append(f"Nothing is known of any pixel in {len(blind)} photographs: {_few(blind)}.")
    if count == 1:
        found.append("One photograph: by itself it does not determine normals.")
    normals = None if truth is None else _unit_or_nan(truth[mask])
    return Photographs(values, mask, lights, None, normals, tuple(found))


def make_lights(
    file: str | PathLike, vectors: np.ndarray, irradiance: np.ndarray | None = None, *, near: float | None = None
) -> tuple[AbstractLighting, list[str]]:
    """Lights of vectors `(lights, 3)` in the world (x right, y up, z towards the viewer), and what there is to say.

    - `irradiance` `(lights,)` or `(lights, channels)`: None for 1; the radiant intensity of lights nearby.
    - `near`: None for lights far away, whose directions are brought to unit length; else what the vectors are to be
      multiplied with to be positions in the unit of the scene.

    **Raises:** FileFormatError for vectors that are zero or not finite; ValueError for `near` that is not above 0.
    """
    if near is not None and not (np.isfinite(near) and near > 0):
        raise ValueError(f"near must be a finite number above 0, got {near}")
    length = np.linalg.norm(vectors, axis=-1)
    for k in np.flatnonzero(~(np.isfinite(length) & (length > 0)))[:1]:
        raise FileFormatError(file, f"light {k + 1}", "a finite vector that is not zero", str(vectors[k].tolist()))
    strength = jnp.ones(len(vectors)) if irradiance is None else jnp.asarray(irradiance, float)
    notes = []
    below = int(np.sum(vectors[:, 2] <= 0))
    if below:
        notes.append(f"{below} of {len(vectors)} lights are not in front of the object (z <= 0): kept.")
    if near is not None:
        notes.append(f"Lights are nearby, at {near:g} times the positions of {file}, in the world of the object.")
        return jax.vmap(PointLight)(jnp.asarray(near * vectors, float), strength), notes
    other = np.abs(length - 1) > UNIT
    if other.any():
        notes.append(
            f"{int(other.sum())} of {len(vectors)} directions had lengths from {length.min():.4g} to "
            f"{length.max():.4g}: brought to 1; lights are taken as far away."
        )
    return jax.vmap(DirectionalLight)(jnp.asarray(vectors / length[:, None], float), strength), notes


def _linear(inside: np.ndarray, encoding: Encoding, *, drop: bool) -> tuple[np.ndarray, int]:
    """Values linear in light, float32, and the number of those that are saturated or not finite."""
    if inside.dtype.kind == "f":
        bad = ~np.isfinite(inside)
        return np.where(bad, np.float32(np.nan), inside.astype(np.float32)), int(bad.sum())
    top = np.iinfo(inside.dtype).max
    table = np.arange(top + 1) / top
    if encoding == "srgb":
        table = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    bad = int(np.sum(inside == top))
    if drop:
        table[top] = np.nan
    return table.astype(np.float32)[inside], bad


def _found(values: np.ndarray, pixels: np.ndarray, lost: int, saturated: Saturated, encoding: Encoding) -> list[str]:
    count, channels = values.shape[1:]
    rows, columns = pixels.shape[:2]
    share = f"{lost} of {values.size} values ({lost / values.size:.2%})"
    notes = [
        f"{count} photographs of {rows} x {columns} pixels, {len(values)} of them in the mask, channels: {channels}."
    ]
    if pixels.dtype.kind == "f":
        return [*notes, f"Floating-point values, as they are. Not finite, NaN here: {share}."]
    top = np.iinfo(pixels.dtype).max
    meaning = "as linear in light" if encoding == "linear" else "as encoded by sRGB, and decoded"
    notes.append(f"{8 * pixels.dtype.itemsize}-bit values, divided by {top}, taken {meaning}.")
    notes.append(f"Saturated, at {top}: {share}, {'NaN here' if saturated == 'drop' else 'kept'}.")
    # 10, 12 or 14 bits in 16: a camera may have saturated below the top of the file's range.
    if lost == 0:
        most = values.max()
        pile, below = int(np.sum(values == most)), int(np.sum((values < most) & (values >= 0.99 * most)))
        if pile >= max(PILE, 5 * below):
            notes.append(
                f"The largest value, {most:.5f} of the range, occurs {pile} times: if the camera saturates there, "
                "make these NaN."
            )
    return notes


def _unit_or_nan(normals: np.ndarray) -> np.ndarray:
    """Unit normals `(pixels, 3)`; NaN where the vector is nowhere near a unit one: nothing is known there."""
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    known = np.isfinite(length) & (length > 0.5)
    return np.where(known, normals / np.where(known, length, 1), np.nan)


def _few(names: list[str]) -> str:
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
