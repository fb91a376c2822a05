"""Where the results of tiles go: memory, an array of the caller's, or a file that has its name when it is whole."""

import math
import os
import shutil
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from hshjax.fitting._tiles import Tile, TileError

PART = "coefficients.npy"
"""In the folder of what is unfinished."""


class TileResults:
    """`(pixels, functions, channels)`, written tile by tile.

    - `out`: None for memory; anything with `shape` that takes `out[start:stop] = array`; or a path, beside which what
      is not whole yet lies in the folder `unfinished`.
    - `array`: what has been written to, None before.
    """

    def __init__(self, out: Any):
        self.path = Path(out) if isinstance(out, str | PathLike) else None
        self.array: Any = None if self.path is not None else out
        self.unfinished = None if self.path is None else self.path.with_name(f".{self.path.name}.unfinished")
        self._parts: list[np.ndarray] | None = [] if out is None else None

    def create(self, shape: tuple[int | None, int, int], dtype: np.dtype, *, anew: bool) -> None:
        """Begins a file, where it is to be one, unless it is there. `anew`: whether nothing was done before.

        **Raises:** ValueError for a file of unknown length, or one that is gone.
        """
        if self.unfinished is None or (self.unfinished / PART).exists():
            return
        if shape[0] is None:
            raise ValueError("a file needs to know the number of pixels: give it beside a source without shape")
        if not anew:
            raise ValueError(
                f"{self.unfinished} says that tiles are done and lacks {PART}, which was lost, or renamed when it was "
                "whole: remove the folder to begin anew"
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
            self.array = None  # no handle of the unfinished file is left
            os.replace(self.unfinished / PART, self.path)

    def clear(self) -> None:
        """Removes the folder of what was unfinished."""
        if self.unfinished is not None:
            shutil.rmtree(self.unfinished)


class _File:
    """A .npy file that slices are written to: unlike those of a map, its pages never count as memory of the process."""

    def __init__(self, path: Path):
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        self.shape, self._dtype, self._offset = mapped.shape, mapped.dtype, mapped.offset
        self._file = path.open("r+b")

    def __setitem__(self, rows: slice, values: np.ndarray) -> None:
        size = math.prod(self.shape[1:]) * self._dtype.itemsize
        self._file.seek(self._offset + rows.start * size)
        self._file.write(np.ascontiguousarray(values, self._dtype).data)

    def flush(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())

    def __del__(self):
        self._file.close()
