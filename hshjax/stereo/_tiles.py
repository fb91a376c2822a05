"""Pixels in tiles: memory is that of a tile, and tiles of few lengths share compiled programs."""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array

STEP = 512
"""Lengths of the tile of a small object are multiples of this: objects of like size share programs."""


def tile_length(count: int, longest: int) -> int:
    """Of the tiles of so many pixels."""
    return min(longest, -(-count // STEP) * STEP)


def slices(count: int, length: int) -> Iterator[slice]:
    """Which of so many pixels each tile is of; the last one may be shorter."""
    for begin in range(0, count, length):
        yield slice(begin, min(begin + length, count))


def filled(array: Array | np.ndarray, length: int) -> Array:
    """An array `(pixels of a tile, ...)`, filled up with zeros."""
    return jnp.pad(jnp.asarray(array), ((0, length - len(array)), *((0, 0),) * (array.ndim - 1)))
