"""Raw numbers of a file, checked against its size before any of them is read."""

import os
from collections.abc import Callable
from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io.errors import FileFormatError


def file_size(path: str | PathLike) -> int:
    """Bytes of a file; OSError for what cannot be opened as one, a directory for instance."""
    with Path(path).open("rb") as file:
        return os.fstat(file.fileno()).st_size


LARGEST = 2**31
"""Bytes of a file that is read as a whole: ten times the largest that databases have, and no more than memory holds."""


def whole_file(path: str | PathLike, begins: Callable[[bytes], None], head: int) -> bytes:
    """The content of a file. `begins` sees its first `head` bytes, and may raise, before the rest is read.

    **Raises:** FileFormatError for more than 2 GiB; OSError where it cannot be opened.
    """
    with Path(path).open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        first = file.read(head)
        begins(first)
        if size > LARGEST:
            raise FileFormatError(path, "size", f"at most {LARGEST} bytes", f"{size}")
        return first + file.read()


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
