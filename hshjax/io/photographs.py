"""Photographs from whatever they are kept in."""

from os import PathLike
from pathlib import Path

from hshjax.io._photographs import Encoding, Saturated
from hshjax.io.diligent import is_diligent, read_diligent
from hshjax.io.errors import FileFormatError
from hshjax.io.exr import MAGIC as EXR
from hshjax.io.light_positions import is_light_file, read_photograph_folder
from hshjax.io.photograph_layers import read_photograph_layers
from hshjax.io.photographs_npz import read_photographs_npz
from hshjax.photographs import Photographs

ZIP = b"PK\x03\x04"


def read_photographs(
    path: str | PathLike,
    *,
    encoding: Encoding = "linear",
    saturated: Saturated = "drop",
    near: float | None = None,
) -> Photographs:
    """Photographs by the reader that fits what `path` holds; their `notes` say which, and what was found.

    | `path` | reader |
    |---|---|
    | a folder with `light_directions.txt`, or another file of DiLiGenT and no light file | `read_diligent` |
    | another folder, or a light file `*.lp` | `read_photograph_folder` |
    | an archive of arrays (.npz) | `read_photographs_npz` |
    | an OpenEXR image, with a light file of the same name | `read_photograph_layers` |

    `encoding`, `saturated` and `near` as in these.

    **Raises:** FileFormatError for anything else, and as the readers; ValueError for an `encoding` or `near` that the
    kind of file has no use for.
    """
    path = Path(path)
    if path.is_dir():
        if is_diligent(path):
            _refuse(path, "the DiLiGenT layout", "linear", near, near_known=True)
            return read_diligent(path, saturated=saturated, encoding=encoding)
        return read_photograph_folder(path, encoding=encoding, saturated=saturated, near=near)
    if is_light_file(path):
        return read_photograph_folder(path, encoding=encoding, saturated=saturated, near=near)
    with path.open("rb") as file:
        start = file.read(4)
    if start == EXR:
        _refuse(path, "OpenEXR", encoding, near, near_known=False)
        return read_photograph_layers(path, near=near)
    if start == ZIP:
        _refuse(path, "an archive of arrays", "linear", near, near_known=True)
        return read_photographs_npz(path, encoding=encoding, saturated=saturated)
    expected = "a folder of images, a light file (*.lp), an archive of arrays (.npz) or an OpenEXR image"
    raise FileFormatError(path, "byte 0", expected, repr(start) if start else "an empty file")


def _refuse(path: Path, kind: str, encoding: str, near: float | None, *, near_known: bool) -> None:
    """ValueError for options that a kind of file leaves no choice about."""
    if encoding == "srgb":
        raise ValueError(f'{path}: {kind} is linear in light, got encoding="srgb"')
    if near_known and near is not None:
        raise ValueError(f"{path}: {kind} says itself where lights are, got near={near}")
