"""Pixels in tiles, from arrays of which a slice at a time is read, or from whatever yields them."""

import operator
from collections.abc import Callable, Iterator
from itertools import chain
from os import PathLike
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from hshjax.fitting._parts import PartError, naming, native


class TileError(PartError):
    """A tile of pixels that cannot be used, or that is missing: `tile` is its number from 0."""

    what = "tile"

    @property
    def tile(self) -> int:
        return self.number


class Tile(NamedTuple):
    """Some pixels: their number, the place of the first, and their values `(pixels, lights, channels)`."""

    number: int
    start: int
    values: np.ndarray


class Tiles:
    """Photographs in tiles of pixels, each read when it is its turn.

    - `source`: anything with `shape` that gives an array for `source[start:stop]`, cut into tiles of `rows` pixels; or
      anything that yields tiles, of which all are gone through. - `lights`: how many there are.
    - `pixels`: how many there are, None where that is not known. - `rows`: of a tile. - `channels`, `dtype`: of all,
      and `kind`, in words.

    **Raises:** ValueError for a shape that is not (pixels, lights, channels), and for rows < 1; TypeError for a path,
    and for what is no source; TileError for the first tile, see `read`.
    """

    def __init__(self, source: Any, rows: int, lights: int):
        rows = operator.index(rows)
        if rows < 1:
            raise ValueError(f"rows of a tile must be at least 1, got {rows}")
        if isinstance(source, str | PathLike):
            raise TypeError(f'photographs must be an array, got a path: np.load({str(source)!r}, "r") opens it')
        if not hasattr(source, "shape") and not hasattr(source, "__iter__"):
            raise TypeError(f"photographs must be an array, or yield tiles of one, got {type(source).__name__}")
        self._source, self.rows, self._lights = source, rows, lights
        self.pixels: int | None = None
        if hasattr(source, "shape"):
            shape = tuple(int(size) for size in source.shape)
            if len(shape) != 3 or shape[1] != lights or 0 in shape:
                raise ValueError(f"photographs must be (pixels, {lights} lights, channels), got {shape}")
            self.pixels = shape[0]
            with naming("tile 0 of pixels"):
                first = _values(source[0:1])
        else:
            self._tiles = iter(source)
            with naming("tile 0 of pixels"):
                first = _values(next(self._tiles, np.zeros((0, lights, 0))))
            self._tiles = chain([first], self._tiles)
        self._check(0, first, None)
        self.channels, self.dtype = first.shape[2], first.dtype
        self.kind = _kind(first)

    def __len__(self) -> int:
        """Of a source with a shape."""
        assert self.pixels is not None  # or it is not known
        return -(-self.pixels // self.rows)

    def read(self, wanted: Callable[[int], bool]) -> Iterator[Tile]:
        """The tiles that are wanted, in order.

        **Raises:** TileError for one of another shape, or of other channels or dtype than the first. What reading
        raises gets a note that names the tile.
        """
        for tile in self._yielded(wanted) if self.pixels is None else self._cut(self.pixels, wanted):
            self._check(tile.number, tile.values, self.kind)
            yield tile

    def _check(self, number: int, values: np.ndarray, kind: str | None) -> None:
        if values.ndim != 3 or values.shape[1] != self._lights or 0 in values.shape:
            raise TileError(number, f"expected (pixels, {self._lights} lights, channels), got {values.shape}")
        if values.dtype.kind not in "fiu":
            raise TileError(number, f"expected real numbers, got {values.dtype}")
        if kind not in (None, _kind(values)):
            raise TileError(number, f"expected {kind} as of the first, got {_kind(values)}")

    def _cut(self, pixels: int, wanted: Callable[[int], bool]) -> Iterator[Tile]:
        for number in filter(wanted, range(len(self))):
            start = number * self.rows
            stop = min(start + self.rows, pixels)
            with naming(f"tile {number} of pixels"):
                values = _values(self._source[start:stop])
            if len(values) != stop - start:  # a file may have become shorter than its header says
                raise TileError(number, f"expected {stop - start} pixels from {start} on, got {len(values)}")
            yield Tile(number, start, values)

    def _yielded(self, wanted: Callable[[int], bool]) -> Iterator[Tile]:
        number = start = 0
        while True:
            with naming(f"tile {number} of pixels"):
                try:
                    values = _values(next(self._tiles))
                except StopIteration:
                    return
            if wanted(number):
                yield Tile(number, start, values)
            start += len(values)
            number += 1


def _values(part: Any) -> np.ndarray:
    """Pixels as they are computed with: what is masked is NaN, of integers in jax's default dtype."""
    if isinstance(part, np.ma.MaskedArray) and part.dtype.kind in "fiu":
        part = np.ma.filled(part.astype(part.dtype if part.dtype.kind == "f" else jnp.zeros(()).dtype), np.nan)
    return native(part)


def _kind(values: np.ndarray) -> str:
    return f"{values.shape[2]} channels of {values.dtype.name}"


def known_values(tile: Tile, dtype: np.dtype, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The values in `dtype`, and which lights are known in which pixels `(pixels, lights)`: those that are NaN in no
    channel, whatever lights are `used`.

    **Raises:** TileError for values that are infinite in that dtype, under a light that is used.
    """
    with np.errstate(over="ignore"):  # what is infinite then is told
        values = tile.values.astype(dtype)
    if tile.values.dtype.kind != "f":
        return values, np.ones(values.shape[:2], bool)
    known = np.asarray(np.isfinite(values).all(axis=2))
    if not known.all():
        infinite = np.isinf(values).any(axis=2) & used
        if infinite.any():
            pixel, light = np.argwhere(infinite)[0]
            raise TileError(
                tile.number,
                f"{infinite.sum()} values are infinite in {dtype}, the first of pixel {tile.start + pixel} under light "
                f"{light}: make them NaN where nothing is known, or give that light the weight 0",
            )
    return values, known
