"""What happens to binary files: cut off, bits flipped, counts that lie, numbers that are none, gigabytes of nothing."""

import struct
import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from hshjax.io import FileFormatError

PARTS = 64
SPARSE = 5 * 10**9
SECONDS, BYTES = 1.0, 500e6
"""Of processor time and of memory, that a reader may take to refuse a file."""


def binary_variants(
    content: bytes, *, counts: Mapping[str, int] = {}, numbers: Sequence[int] = (), code: str = "<d", flips: int = 64
) -> dict[str, bytes]:
    """Variants of a good file, by what was done to it.

    `counts`: offsets of integers of four bytes by name, which become 2^31 - 1, -1, 0 and byte-swapped; `numbers`:
    offsets of numbers of type `code`, which become NaN and infinite.
    """
    rng = np.random.default_rng(0)
    variants = {"empty": b"", "twice": 2 * content, "a byte more": content + b"\0", "zeros": bytes(len(content))}
    variants |= {f"cut at {k}/{PARTS}": content[: k * len(content) // PARTS] for k in range(1, PARTS)}
    for place in rng.choice(8 * len(content), flips, replace=False).tolist():
        changed = bytearray(content)
        changed[place // 8] ^= 1 << place % 8
        variants[f"bit {place % 8} of byte {place // 8}"] = bytes(changed)
    for name, at in counts.items():
        (swapped,) = struct.unpack_from(">i", content, at)
        for value in (2**31 - 1, -1, 0, swapped):
            variants[f"{name} = {value}"] = replaced(content, at, "<i", value)
    for at in numbers:
        for value in (float("nan"), float("inf")):
            variants[f"{value} at byte {at}"] = replaced(content, at, code, value)
    return variants


def replaced(content: bytes, at: int, code: str, *values: float) -> bytes:
    new = struct.pack(code, *values)
    return content[:at] + new + content[at + len(new) :]


def refused(read: Callable[[Path], object], path: Path) -> FileFormatError | None:
    """The FileFormatError that a reader raises, or None where it reads the file; any other exception passes through.

    It must be one sentence that names the file and both sides, and take little time and memory.
    """
    tracemalloc.start()
    begin = time.process_time()
    error = None
    try:
        read(path)
    except FileFormatError as caught:
        error = caught
        message = str(caught)
        assert message.startswith(f"{path}: ")
        assert "expected" in message
        assert "\n" not in message
        assert len(message) < 1000
    taken, (_, peak) = time.process_time() - begin, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    if error is not None:
        assert taken < SECONDS, message
        assert peak < BYTES
    return error


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def sparse(path: Path, content: bytes, size: int = SPARSE) -> Path:
    """`content`, then a hole up to `size` bytes."""
    path.write_bytes(content)
    with path.open("r+b") as file:
        file.truncate(size)
    return path
