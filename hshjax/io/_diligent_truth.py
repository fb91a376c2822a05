"""True normals as folders in the layout of DiLiGenT keep them."""

import warnings
from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io._folder_files import FolderFiles
from hshjax.io._mat import read_mat_floats
from hshjax.io.errors import FileFormatError

FIELD = "Normal_gt"
MAT, TEXT, PICTURE = f"{FIELD}.mat", "normal.txt", f"{FIELD}.png"
"""The first two hold the same. The picture shows it in 8 bits, half a degree apart: no truth, and no photograph."""


def true_normals(files: FolderFiles, shape: tuple[int, int], mask: np.ndarray) -> tuple[np.ndarray | None, str]:
    """Normals `(rows, columns, 3)` as they stand in the file, and the name of that; None and "" without one.

    **Raises:** FileFormatError for a file that is damaged or of another size.
    """
    if path := files.get(MAT):
        normals = read_mat_floats(path, FIELD)
        if normals.shape != (*shape, 3):
            raise FileFormatError(path, f"field {FIELD!r}", f"shape {(*shape, 3)}, as the mask", str(normals.shape))
        return normals, path.name
    if path := files.get(TEXT):
        return _of_lines(path, numbers_of_lines(path, 3), mask), path.name
    return None, ""


def _of_lines(path: Path, table: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """A line a pixel, row by row: of the whole image, or of the mask."""
    if len(table) == mask.size:
        return table.reshape(*mask.shape, 3)
    if len(table) != mask.sum():
        expected = f"{mask.size}, one for each pixel of {mask.shape[0]} x {mask.shape[1]}, or {mask.sum()} of the mask"
        raise FileFormatError(path, "lines", expected, str(len(table)))
    normals = np.zeros((*mask.shape, 3))
    normals[mask] = table
    return normals


def numbers_of_lines(path: str | PathLike, *columns: int) -> np.ndarray:
    """A table with so many numbers a line, between blanks or commas; lines that begin with # are left out.

    **Raises:** FileFormatError for anything else; OSError where the file cannot be opened.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file is refused by who counts its lines
            table = np.loadtxt(text_of(path).replace(",", " ").splitlines(), ndmin=2)
    except ValueError as error:
        raise FileFormatError(path, "lines", f"{_words(columns)} each", str(error)) from error
    if len(table) and table.shape[1] not in columns:
        raise FileFormatError(path, "lines", f"{_words(columns)} each", f"{len(table)} lines of {table.shape[1]}")
    return table


def text_of(path: str | PathLike) -> str:
    """All of a text file. **Raises:** FileFormatError for other bytes than UTF-8."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(path, f"byte {error.start}", "text in UTF-8", "other bytes") from error


def _words(columns: tuple[int, ...]) -> str:
    return " or ".join({1: "one number", 3: "three numbers"}[count] for count in columns)
