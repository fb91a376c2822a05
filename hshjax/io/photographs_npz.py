"""Photographs in one numpy archive (.npz), without pickle."""

import os
import struct
import tokenize
import zipfile
import zlib
from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io._expansion import check_expansion
from hshjax.io._photographs import Encoding, Saturated, assemble, check_options, make_lights
from hshjax.io.errors import FileFormatError
from hshjax.photographs import Photographs

KEYS = ("images", "mask", "lights", "positions", "irradiance", "normals")


DAMAGES = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, KeyError, NotImplementedError, OSError, RuntimeError,
    MemoryError, OverflowError, SyntaxError, TypeError, tokenize.TokenError,
)  # fmt: skip
"""What zipfile and numpy raise for damaged archives, beside ValueError."""


def read_photographs_npz(
    path: str | PathLike, *, encoding: Encoding = "linear", saturated: Saturated = "drop"
) -> Photographs:
    """Photographs of an archive with these arrays, of which only `images` is required:

    - `images` `(lights, rows, columns)` or `(lights, rows, columns, channels)`: uint8, uint16, or a float type whose
      values are linear in light, NaN where nothing is known. Row 0 on top.
    - `mask` `(rows, columns)`, bool or integers: which pixels see the object, those that are not 0. Without: all.
    - `lights` `(lights, 3)`: directions towards lights far away, x right, y up, z towards the viewer; or `positions`
      `(lights, 3)` of lights nearby, in the unit of the scene. Without: nothing is known of them.
    - `irradiance` `(lights,)` or `(lights, channels)`: of a surface that faces the light, the radiant intensity of
      lights nearby. Without: 1.
    - `normals` `(rows, columns, 3)`: true ones, for comparison; zero or NaN where they are not known.

    `encoding` and `saturated` are for integers, as in `read_photograph_folder`.

    **Raises:** FileFormatError for other shapes and types, values that are not finite where they must be, and archives
    that are damaged or hold Python objects; OSError where the file cannot be opened.
    """
    check_options(saturated, encoding)
    with Path(path).open("rb") as file:  # the library would leave it open where it refuses
        try:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise FileFormatError(path, "byte 0", "an archive of arrays (.npz)", "one array")
            assert archive.zip is not None  # it is open
            members = archive.zip.infolist()  # numpy reads no more of a member than is declared there
            for one in members:
                check_expansion(path, f"archive, {one.filename!r}", one.file_size, one.compress_size)
            check_expansion(path, "archive", sum(one.file_size for one in members), os.fstat(file.fileno()).st_size)
            others = [key for key in archive.files if key not in KEYS]
            arrays = {key: _array(path, key, archive[key]) for key in KEYS if key in archive.files}
        except FileFormatError:
            raise
        except ValueError as error:  # objects, and what is no array at all
            raise FileFormatError(path, "archive", "arrays of numbers (.npz), without pickle", _said(error)) from error
        except DAMAGES as error:
            raise FileFormatError(path, "archive", "an intact one (.npz)", _said(error)) from error
    fields = _Arrays(path, arrays)
    images = fields.get("images", "uf", (3, 4))
    if images is None:
        raise FileFormatError(path, "array 'images'", "this array", f"{sorted([*arrays, *others])}")
    if images.dtype.kind == "u" and images.dtype.itemsize > 2:
        raise FileFormatError(path, "array 'images'", "8 or 16 bits, or floats", str(images.dtype))
    images = images[..., None] if images.ndim == 3 else images
    if 0 in images.shape:
        raise FileFormatError(path, "array 'images'", "no empty axis", str(images.shape))
    count, rows, columns, channels = images.shape
    mask = fields.get("mask", "bui", (2,), (rows, columns))
    if mask is not None and not mask.any():
        raise FileFormatError(path, "array 'mask'", "pixels that see the object, not 0", "none")
    directions = fields.get("lights", "fiu", (2,), (count, 3))
    positions = fields.get("positions", "fiu", (2,), (count, 3))
    if directions is not None and positions is not None:
        raise FileFormatError(path, "arrays", "'lights' far away or 'positions' of lights nearby", "both")
    irradiance = fields.get("irradiance", "fiu", (1, 2), (count,), (count, 1), (count, channels))
    if irradiance is not None and not np.all(np.isfinite(irradiance) & (irradiance > 0)):
        raise FileFormatError(path, "array 'irradiance'", "finite numbers above 0", "others")
    notes = [f"Archive of arrays: {', '.join(arrays)}."]
    if others:
        notes.append(f"Arrays that are not read: {', '.join(others)}.")
    lights, vectors = None, directions if positions is None else positions
    if vectors is None:
        if irradiance is not None:
            raise FileFormatError(path, "array 'irradiance'", "directions or positions beside it", "neither")
        notes.append("No array 'lights' or 'positions': nothing is known of the lights.")
    else:
        near = None if positions is None else 1.0
        lights, said = make_lights(path, vectors.astype(float), irradiance, near=near)
        notes += said
    if mask is None:
        notes.append("No array 'mask': every pixel is taken to see the object.")
    normals = fields.get("normals", "f", (3,), (rows, columns, 3))
    return assemble(
        ((f"{path}: images[{k}]", image) for k, image in enumerate(images)),
        count,
        lights=lights,
        mask=None if mask is None else mask != 0,
        mask_file=path,
        truth=normals,
        saturated=saturated,
        encoding=encoding,
        notes=notes,
    )


def _array(path: str | PathLike, key: str, member: object) -> np.ndarray:
    """A member of an archive, which numpy gives as bytes where they do not begin as an array does."""
    if not isinstance(member, np.ndarray):
        raise FileFormatError(path, f"array {key!r}", "an array of numpy (.npy)", "other bytes")
    return member


class _Arrays:
    """The arrays of an archive, each checked where it is asked for."""

    def __init__(self, path: str | PathLike, arrays: dict[str, np.ndarray]):
        self.path, self.arrays = path, arrays

    def get(self, key: str, kinds: str, dimensions: tuple[int, ...], *shapes: tuple[int, ...]) -> np.ndarray | None:
        """An array whose dtype is of these kinds, with one of these numbers of axes and, where given, shapes."""
        if key not in self.arrays:
            return None
        array = self.arrays[key]
        if array.dtype.kind not in kinds:
            names = {"b": "bool", "u": "unsigned integers", "i": "integers", "f": "floats"}
            expected = " or ".join(names[kind] for kind in kinds)
            raise FileFormatError(self.path, f"array {key!r}", expected, str(array.dtype))
        if array.ndim not in dimensions or (shapes and array.shape not in shapes):
            expected = " or ".join(map(str, shapes)) if shapes else f"{' or '.join(map(str, dimensions))} axes"
            raise FileFormatError(self.path, f"array {key!r}", expected, f"shape {array.shape}")
        return array


def _said(error: Exception) -> str:
    """What a library says, or what it calls that."""
    return str(error) or type(error).__name__
