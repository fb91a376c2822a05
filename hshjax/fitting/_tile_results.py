"""Where the results of tiles go: memory, an array of the caller's, or a file that has its name when it is whole."""

import math
import os
import shutil
from os import PathLike
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from hshjax.fitting._tiles import Tile, TileError

PART = "coefficients.npy"
"""In the folder of what is unfinished."""

OTHERS = (".zarr", ".h5", ".hdf5")
"""Suffixes of arrays that callers make; a .npy file of that name would mislead."""

LONGEST = 255
"""Bytes of a name, where file systems end them."""


class TileResults:
    """`(pixels, functions, channels)`, written tile by tile.

    - `out`: None for memory; anything with `shape` that takes `out[start:stop] = array`; or a path, beside which what
      is not whole yet lies in the folder `unfinished`.
    - `array`: what has been written to, None before.

    **Raises:** ValueError for a path that is a folder, has the suffix of another format, or too long a name; TypeError
    for what has no shape.
    """

    def __init__(self, out: Any):
        self.path = Path(out) if isinstance(out, str | PathLike) else None
        if self.path is not None and self.path.is_dir():
            raise ValueError(f"out must be the path of a file, and {self.path} is a folder")
        if self.path is not None and self.path.suffix.lower() in OTHERS:
            raise ValueError(
                f"a path as out becomes a .npy file, got {self.path}: make the {self.path.suffix} array, give it as out"
            )
        self.array: Any = None if self.path is not None else out
        self.unfinished = None if self.path is None else self.path.with_name(f".{self.path.name}.unfinished")
        if self.array is not None and not hasattr(self.array, "shape"):
            raise TypeError(f"out must be an array, a path or None, got {type(out).__name__}")
        self._parts: list[np.ndarray] | None = [] if out is None else None
        size = 0 if self.unfinished is None else len(os.fsencode(self.unfinished.name))
        if self.unfinished is not None and size > LONGEST:
            raise ValueError(
                f"the file name of out must leave room for {self.unfinished.name}, which has {size} bytes, "
                f"{LONGEST} at most"
            )

    def create(self, shape: tuple[int | None, int, int], dtype: np.dtype, *, anew: bool) -> None:
        """Begins a file, where it is to be one, unless it is there. `anew`: whether nothing was done before.

        **Raises:** ValueError for a file of unknown length, or one that is gone.
        """
        if self.path is None or self.unfinished is None:
            return
        # One of another kind is of a call that ended before anything of it was kept.
        if (self.unfinished / PART).exists() and (not anew or _kind(self.unfinished / PART) == (shape, dtype)):
            return
        if shape[0] is None:
            raise ValueError("a file needs to know the number of pixels: give it beside a source without shape")
        if not anew:
            there = "is there" if self.path.exists() else "is not there"
            raise ValueError(
                f"{self.unfinished} says that tiles are done and lacks {PART}, which was lost, or renamed when it was "
                f"whole, to {self.path}, which {there}: remove the folder to begin anew"
            )
        beside = self.unfinished / "new.npy"  # a header must be whole, too
        np.lib.format.open_memmap(beside, "w+", dtype, (shape[0], *shape[1:])).flush()  # a hole, as long as the result
        os.replace(beside, self.unfinished / PART)

    def open(self, shape: tuple[int | None, int, int]) -> None:
        """To be called before the first tile; ValueError for an array of another shape."""
        if self._parts is not None:
            return
        pixels, functions, channels = shape
        if self.unfinished is not None:
            self.array = _File(self.unfinished / PART)
        got = tuple(int(size) for size in self.array.shape)
        if got != (got[0] if pixels is None else pixels, functions, channels):
            raise ValueError(f"out must be (pixels, functions, channels), {shape} here, got {got}")
        dtype = getattr(self.array, "dtype", None)
        dtype = getattr(dtype, "numpy_dtype", dtype)  # of tensorstore
        if dtype is not None and not jnp.issubdtype(dtype, jnp.floating):
            raise ValueError(f"out must hold floating values, got {dtype}")

    @property
    def anew(self) -> str:
        """What to do where what is done is not to be gone on with."""
        return f"remove {self.unfinished or 'the checkpoint'} to begin anew"

    def check(self, tile: Tile, coefficients: np.ndarray, conditions: np.ndarray) -> None:
        """TileError where `out` has other coefficients of a tile that is done, beyond rounding at the condition numbers
        of its pixels, or NaN elsewhere."""
        there = np.asarray(self.array[tile.start : tile.start + len(coefficients)])
        step = max(float(jnp.finfo(one.dtype).eps) for one in (there, coefficients))
        known = np.isfinite(conditions)
        sizes = np.max(np.abs(coefficients), axis=(1, 2))
        usual = np.median(sizes[known]) if known.any() else 0.0  # one that is ill-determined does not speak for others
        limits = np.maximum(step**0.5, conditions[known] * step) * np.maximum(sizes[known], usual)
        if (
            there.shape != coefficients.shape
            or not np.isnan(there[~known]).all()
            or not np.all(np.abs(there[known] - coefficients[known]) <= limits[:, None, None])
        ):
            raise TileError(tile.number, f"was done, and out does not hold its fit: {self.anew}")

    def write(self, tile: Tile, coefficients: np.ndarray) -> None:
        """The coefficients of a tile in their place; TileError for pixels beyond the end."""
        if self._parts is not None:
            self._parts.append(coefficients)
            return
        stop, pixels = tile.start + len(coefficients), self.array.shape[0]
        if stop > pixels:
            raise TileError(tile.number, f"expected {pixels} pixels in all, got {stop} with this tile")
        try:
            self.array[tile.start : stop] = coefficients
        except Exception as error:
            error.add_note(f"while the coefficients of tile {tile.number} were written")
            raise

    def flush(self) -> None:
        """Onto the disk, where the array has a way to say so."""
        flush = getattr(self.array, "flush", None)
        if flush is not None:
            flush()

    def publish(self) -> None:
        """Gives a file its name."""
        if self._parts is not None:
            self.array = np.concatenate(self._parts)
        self.flush()
        if self.path is not None and self.unfinished is not None:
            if not self.array.is_at(self.unfinished / PART):  # where nobody looks after two runs with one path
                raise ValueError(f"{self.unfinished / PART} is of another run by now: give each an out of its own")
            self.array = None  # no handle of the unfinished file is left
            os.replace(self.unfinished / PART, self.path)

    def clear(self) -> None:
        """Removes the folder of what was unfinished."""
        if self.unfinished is not None:
            shutil.rmtree(self.unfinished)


def _kind(path: Path) -> tuple[tuple[int, ...], np.dtype]:
    mapped = np.load(path, mmap_mode="r", allow_pickle=False)
    return mapped.shape, mapped.dtype


class _File:
    """A .npy file that slices are written to: unlike those of a map, its pages never count as memory of the process."""

    def __init__(self, path: Path):
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        self.shape, self.dtype, self._offset = mapped.shape, mapped.dtype, mapped.offset
        self._file = path.open("r+b")

    def __setitem__(self, rows: slice, values: np.ndarray) -> None:
        size = math.prod(self.shape[1:]) * self.dtype.itemsize
        self._file.seek(self._offset + rows.start * size)
        self._file.write(np.ascontiguousarray(values, self.dtype).data)

    def __getitem__(self, rows: slice) -> np.ndarray:
        size = math.prod(self.shape[1:]) * self.dtype.itemsize
        self._file.seek(self._offset + rows.start * size)
        got = self._file.read((rows.stop - rows.start) * size)
        return np.frombuffer(got, self.dtype).reshape(-1, *self.shape[1:])

    def is_at(self, path: Path) -> bool:
        """Whether this is the file of that name."""
        return path.exists() and os.path.samestat(os.fstat(self._file.fileno()), path.stat())

    def flush(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())

    def __del__(self):
        self._file.close()
