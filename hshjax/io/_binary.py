"""Raw numbers of a file, checked against its size before any of them is read."""

import os
from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io.errors import FileFormatError


def file_size(path: str | PathLike) -> int:
    """Bytes of a file; OSError for what cannot be opened as one, a directory for instance."""
    with Path(path).open("rb") as file:
        return os.fstat(file.fileno()).st_size


def finite_doubles(path: str | PathLike, offset: int, count: int) -> np.ndarray:
    """`count` little-endian doubles from byte `offset` on, which the caller has seen to be there.

    **Raises:** FileFormatError for the first one that is not finite, or where the file ends before them all the same.
    """
    numbers = np.fromfile(path, "<f8", count, offset=offset).astype(np.float64, copy=False)
    if numbers.size != count:
        raise FileFormatError(path, f"byte {offset}", f"{count} numbers", f"the end of the file after {numbers.size}")
    # One pass without a mask: any NaN or infinity makes the sum one, or else the sum of so many has overflowed.
    with np.errstate(over="ignore", invalid="ignore"):
        suspect = not np.isfinite(numbers.sum())
    if suspect and not np.isfinite(numbers).all():
        first = int(np.argmin(np.isfinite(numbers)))
        raise FileFormatError(path, f"byte {offset + 8 * first}, value {first}", "a finite number", f"{numbers[first]}")
    return numbers
