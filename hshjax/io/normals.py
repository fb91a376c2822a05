"""Normal maps, in the conventions of other programs: OpenEXR and PNG.

| convention | x | y | z | used by |
|---|---|---|---|---|
| "opengl" | right | up | towards the viewer | this library, Blender, OpenGL |
| "directx" | right | down | towards the viewer | Direct3D: green is flipped |
| "camera" | right | down | away from the viewer | OpenCV and what builds on it |
"""

from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from hshjax._typing import Float
from hshjax.io._images import read_image, write_png
from hshjax.io.errors import FileFormatError
from hshjax.io.exr import write_exr

Convention = Literal["opengl", "directx", "camera"]

SIGNS = {"opengl": (1, 1, 1), "directx": (1, -1, 1), "camera": (1, -1, -1)}
"""What x, y and z of this library are multiplied with; and back again."""

LENGTH = 0.1
"""How far from 1 the length of a normal that is read may be: 8 bits explain 0.01, smoothed edges more."""


def write_normals(
    path: str | PathLike,
    normals: Float[np.ndarray, "rows columns 3"],
    convention: Convention = "opengl",
    *,
    bits: Literal[8, 16] = 16,
) -> None:
    """Write unit normals (x right, y up, z towards the viewer) in R, G, B; by the suffix `.exr` or `.png`.

    OpenEXR holds the numbers themselves as float32, and 0 0 0 where nothing is known. PNG holds (n + 1) / 2 of the
    range of 8 or 16 `bits`, rounded: normals to 0.4 or 0.0015 degrees; black where nothing is known: where a
    normal is zero or NaN.

    **Raises:** ValueError for other shapes and suffixes, other lengths than 0 and 1 (to 1e-3), unknown conventions and
    bits; ImportError for PNG without the extra `photographs`.
    """
    path, sign = Path(path), _signs(convention)
    if bits not in (8, 16):
        raise ValueError(f"bits must be 8 or 16, got {bits}")
    if normals.ndim != 3 or normals.shape[-1] != 3 or normals.dtype.kind != "f":
        raise ValueError(f"normals must be floats (rows, columns, 3), got {normals.shape} of {normals.dtype}")
    unknown = np.all(np.isnan(normals), axis=-1) | np.all(normals == 0, axis=-1)
    length = np.linalg.norm(np.where(unknown[..., None], (0, 0, 1), normals), axis=-1)
    wrong = ~(np.abs(length - 1) <= 1e-3)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise ValueError(
            f"normals must have length 1, or be zero or NaN: {int(wrong.sum())} have not, the first "
            f"{normals[row, column].tolist()} at row {row}, column {column}"
        )
    turned = np.where(unknown[..., None], 0, normals * sign)
    if path.suffix.lower() == ".exr":
        write_exr(path, turned.astype(np.float32), ("R", "G", "B"))
    elif path.suffix.lower() == ".png":
        top = 2**bits - 1
        levels = np.rint((np.clip(turned, -1, 1) + 1) / 2 * top)  # lengths of 1 + 1e-3 may leave the range
        levels[unknown] = 0
        write_png(path, levels.astype(np.uint8 if bits == 8 else np.uint16))
    else:
        raise ValueError(f"normals are written as .exr or .png, got {path.name!r}")


def read_normals(path: str | PathLike, convention: Convention = "opengl") -> np.ndarray:
    """Unit normals `(rows, columns, 3)`, float32: x right, y up, z towards the viewer. The kind of file is its own.

    NaN where nothing is known: where the length in the file is further than 0.1 from 1, as that of black, white and
    grey is.

    **Raises:** FileFormatError for other channels than three, no normals at all, and where most point away from the
    viewer, which tells another convention; OSError where the file cannot be opened; ValueError for an unknown one.
    """
    sign = _signs(convention)
    pixels = read_image(path)
    if pixels.shape[-1] != 3:
        raise FileFormatError(path, "channels", "3", str(pixels.shape[-1]))
    normals = pixels.astype(np.float32)
    if pixels.dtype.kind == "u":
        normals = normals / np.float32(np.iinfo(pixels.dtype).max) * 2 - 1
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    known = np.isfinite(length) & (np.abs(length - 1) <= LENGTH)
    if not known.any():
        raise FileFormatError(path, "pixels", f"vectors of length 1, to {LENGTH}", "none")
    normals = np.where(known, normals / np.where(known, length, 1) * np.asarray(sign, np.float32), np.float32(np.nan))
    behind = int(np.sum(normals[..., 2] < 0))
    if behind > known.sum() / 2:
        expected = f"normals towards the viewer by the convention {convention!r}"
        raise FileFormatError(path, "pixels", expected, f"{behind} of {int(known.sum())} that point away")
    return normals


def _signs(convention: str) -> tuple[int, int, int]:
    if convention not in SIGNS:
        raise ValueError(f"convention must be one of {', '.join(SIGNS)}, got {convention!r}")
    return SIGNS[convention]
