"""What happens to binary files beside that: counts that lie, numbers that are none, gigabytes of nothing."""

import struct
import tracemalloc
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from hshjax.io import FileFormatError
from tests.io.hostile import hostile_variants, outcome

SPARSE = 5 * 10**9
BYTES = 500e6
"""Of memory, that a reader may take to refuse a file."""


def placed_variants(
    content: bytes, *, counts: Mapping[str, int] = {}, numbers: Sequence[int] = (), code: str = "<d", flips: int = 64
) -> dict[str, bytes]:
    """`hostile_variants`, and those of a layout that is known.

    `counts`: offsets of integers of four bytes by name, which become 2^31 - 1, -1, 0 and byte-swapped; `numbers`:
    offsets of numbers of type `code`, which become NaN and infinite.
    """
    variants = {**hostile_variants(content, flips=flips), "a byte more": content + b"\0"}
    for name, at in counts.items():
        (swapped,) = struct.unpack_from(">i", content, at)
        for value in (2**31 - 1, -1, 0, swapped):
            variants[f"{name} = {value}"] = replaced(content, at, "<i", value)
    for at in numbers:
        for value in (float("nan"), float("inf")):
            variants[f"{value} at byte {at}"] = replaced(content, at, code, value)
    return variants


def blind_variants(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Counts and numbers that make no sense, wherever a reader may look for one; another byte order."""
    for width, words in ((4, (2**31 - 1, 2**32 - 1, 2**31)), (8, (2**63 - 1, 2**64 - 1))):
        for at in range(0, min(len(content) - width, 160), width):
            for word in words:
                number = word.to_bytes(width, "little")
                yield f"{word} of {width} bytes at {at}", content[:at] + number + content[at + width :]
        whole = len(content) - len(content) % width
        swapped = np.frombuffer(content[:whole], f"<u{width}").byteswap().tobytes()
        yield f"other byte order in words of {width} bytes", swapped + content[whole:]
    for value in (np.nan, np.inf, -np.inf, 3e38, -3e38):
        for code in ("<f", "<d"):
            number = struct.pack(code, value)
            for part in (0.5, 0.75, 1.0):
                at = int(part * (len(content) - len(number))) // len(number) * len(number)
                yield f"{value} at {at}, {code}", content[:at] + number + content[at + len(number) :]


def replaced(content: bytes, at: int, code: str, *values: float) -> bytes:
    new = struct.pack(code, *values)
    return content[:at] + new + content[at + len(new) :]


def refused(read: Callable[[Path], object], path: Path) -> FileFormatError | None:
    """The `outcome` where it is a FileFormatError, for little memory, or None where the file is read."""
    tracemalloc.start()
    try:
        found = outcome(read, path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    if not isinstance(found, FileFormatError):
        return None
    assert peak < BYTES
    return found


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def sparse(path: Path, content: bytes, size: int = SPARSE) -> Path:
    """`content`, then a hole up to `size` bytes."""
    path.write_bytes(content)
    with path.open("r+b") as file:
        file.truncate(size)
    return path
