"""Parts of a source that is read one after the other: how errors name the one that they are of."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np


class PartError(ValueError):
    """A part that cannot be used, or that is missing; `what` parts are, and the number from 0."""

    what: ClassVar[str]

    def __init__(self, number: int, message: str):
        super().__init__(number, message)
        self.number, self.message = number, message

    def __str__(self) -> str:
        return f"{self.what} {self.number}: {self.message}"


@contextmanager
def naming(part: str) -> Iterator[None]:
    """What reading raises tells at which part, unless it does so itself."""
    try:
        yield
    except PartError:
        raise
    except Exception as error:
        error.add_note(f"while {part} was read")
        raise


def native(array: Any) -> np.ndarray:
    """An array in the order of bytes of the machine, as jax takes it; float64 where it has more digits."""
    array = np.asarray(array)
    if array.dtype.kind == "f" and array.dtype.itemsize > 8:
        return array.astype(np.float64)
    return array.astype(array.dtype.newbyteorder("="), copy=False)
