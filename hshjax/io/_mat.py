"""Arrays of numbers in MATLAB files of version 5 to 7.

Not by scipy.io.loadmat: a damaged file makes it read beyond its memory, which ends the process (scipy 1.17).
Source: The MathWorks, MAT-File Format, chapter 1, "Level 5 MAT-File Format".
"""

import struct
import zlib
from collections.abc import Iterator
from os import PathLike

import numpy as np

from hshjax.io._binary import whole_file
from hshjax.io._expansion import allowed, check_expansion
from hshjax.io.errors import FileFormatError

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
ORDERS = {b"IM": "<", b"MI": ">"}
MATRIX, COMPRESSED = 14, 15
COMPLEX = 0x0800
FLOATS = {6: np.float64, 7: np.float32}
"""Classes of arrays."""


def read_mat_floats(path: str | PathLike, name: str) -> np.ndarray:
    """The full array `name` of real floats, in its shape.

    **Raises:** FileFormatError for other files, without that array, where it is of another class, and where sizes do
    not fit; OSError where the file cannot be opened.
    """

    def begins(head: bytes) -> None:
        if head[126:128] not in ORDERS or head[124:126] not in (b"\x00\x01", b"\x01\x00"):
            got = repr(head[:20]) if head else "an empty file"
            raise FileFormatError(path, "header", "a MATLAB file of version 5 to 7", got)

    content = whole_file(path, begins, 128)
    order, others = ORDERS[content[126:128]], []
    try:
        for kind, body in _elements(content[128:], order):
            if kind == COMPRESSED:
                kind, body = next(_elements(_decompressed(path, body), order))
            if kind == MATRIX:
                array = _floats(body, order, name, others)
                if array is not None:
                    return array
    except (ValueError, StopIteration, struct.error, zlib.error) as error:
        raise FileFormatError(path, "data", "elements whose types and sizes fit", f"others: {error}") from error
    got = ", ".join(map(repr, others[:3])) if others else "none at all"
    raise FileFormatError(path, f"field {name!r}", "this field", got)


def _decompressed(path: str | PathLike, body: bytes) -> bytes:
    """The content of a compressed element, and no more of it than `check_expansion` allows."""
    stream = zlib.decompressobj()
    content = stream.decompress(body, allowed(len(body)) + 1)
    check_expansion(path, "compressed element", len(content), len(body))
    if not stream.eof:
        raise ValueError("a compressed element that is cut off")
    return content


def _elements(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Types and bodies of the elements in a row."""
    start = 0
    while start < len(content):
        kind, size = struct.unpack_from(order + "II", content, start)
        body = start + 8
        if kind >> 16:  # a small one: size and type share four bytes, and the body has the other four
            kind, size, body = kind & 0xFFFF, kind >> 16, start + 4
            if size > 4:
                raise ValueError(f"{size} bytes in the space of 4")
        if body + size > len(content):
            raise ValueError(f"{size} bytes where {len(content) - body} are left")
        yield kind, content[body : body + size]
        end = body + size
        start = end if kind == COMPRESSED else end + -end % 8


def _floats(body: bytes, order: str, name: str, others: list[str]) -> np.ndarray | None:
    """The array in a matrix element; None if its name is another, which goes to `others`."""
    parts = _elements(body, order)
    (_, flags), (kind, sizes), (_, called) = next(parts), next(parts), next(parts)
    if called != name.encode():
        others.append(called.decode("latin-1"))
        return None
    (flag,) = struct.unpack_from(order + "I", flags)
    dtype = FLOATS.get(flag & 0xFF)
    if dtype is None or flag & COMPLEX or kind != 5:
        raise ValueError(f"{name} is of class {flag & 0xFF}, not of real floats")
    shape = tuple(int(size) for size in np.frombuffer(sizes, order + "i4"))
    kind, numbers = next(parts)  # which may be stored as integers, where they are
    if kind not in NUMBERS:
        raise ValueError(f"numbers of type {kind}")
    found = np.frombuffer(numbers, order + NUMBERS[kind])
    if min(shape, default=0) < 0 or found.size != np.prod(shape, dtype=object):
        raise ValueError(f"{found.size} numbers for shape {shape}")
    return found.reshape(shape, order="F").astype(dtype)
