"""Parts of a source that are finished: whether they come again as they were when a run goes on."""

import zlib
from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np

Verify = Literal["last", "all"]
"""Which finished parts are read once more."""


def check_verify(verify: str) -> None:
    """ValueError for another word than `Verify` has."""
    if verify not in get_args(Verify):
        raise ValueError(f"verify must be one of {', '.join(get_args(Verify))}, got {verify!r}")


def mark_of(*arrays: Any) -> int:
    """CRC-32 of arrays, row by row: one change in 4e9 is missed, of those that nobody has made against it."""
    found = 0
    for array in arrays:
        found = zlib.crc32(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data, found)
    return found


class Finished:
    """The parts that one process had finished when its run goes on, by their `marks`, in order.

    `begin`: the number of the first part that was not finished.
    """

    def __init__(self, verify: Verify, marks: Sequence[int], begin: int):
        self.begin = begin
        self._all, self._marks = verify == "all", list(marks)
        self._next = 0 if self._all else max(len(marks) - 1, 0)

    def wanted(self, number: int) -> bool:
        """Whether a part is to be read: because it is not finished, or to be compared."""
        return self._all or number >= self.begin - 1

    def comes_again(self, mark: int) -> bool:
        """Whether a finished part is the same as before. To be asked of all that are wanted, in order."""
        self._next += 1
        return self._marks[self._next - 1] == mark

    @property
    def missing(self) -> bool:
        """Whether one of them has not come."""
        return self._next < len(self._marks)
