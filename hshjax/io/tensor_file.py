"""The `tensor_file` container, version 1.0: named tensors, little-endian, first index slowest.

    "tensor_file\\0"  version: 2 x u8  fields: u32
    per field:  length: u16  name  dimensions: u16  type: u8  offset: u64  shape: dimensions x u64

`offset` counts from the start of the file. The layout is that of the files of the RGL material database (Dupuy and
Jakob, An Adaptive Parameterization for Efficient Material Acquisition and Rendering, ACM TOG 37(6), 2018).
"""

import math
import struct
from collections.abc import Mapping
from os import PathLike

import numpy as np

from hshjax.io._binary import whole_file
from hshjax.io._replace import replacing
from hshjax.io.errors import FileFormatError

MAGIC = b"tensor_file\0"
VERSION = (1, 0)
MAX_DIMENSIONS = 32
MAX_EMPTY = 2**31
"""Elements that an empty tensor would have if its empty axes had length 1."""

DTYPES = {
    1: "u1", 2: "i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8",
}  # fmt: skip
"""numpy type of each type code; code 0 means invalid."""

CODES = {np.dtype(dtype): code for code, dtype in DTYPES.items()}

SMALLEST_FIELD = 2 + 2 + 1 + 8

ALIGNMENT = 8
"""Bytes to which data are aligned when written: readers may map them."""


def read_tensor_file(path: str | PathLike) -> dict[str, np.ndarray]:
    """The tensors of a file by name, in file order: read-only views of one buffer, so memory is that of the file.

    **Raises:** FileFormatError where the header or a tensor does not fit the file, or the file has more than 2 GiB;
    OSError where it cannot be opened.
    """

    def begins(magic: bytes) -> None:
        if magic != MAGIC:
            raise FileFormatError(
                path, "byte 0", f"a tensor_file, beginning with {MAGIC!r}", repr(magic) if magic else "an empty file"
            )

    data = whole_file(path, begins, len(MAGIC))
    cursor = _Cursor(path, data)
    cursor.position = len(MAGIC)
    version = cursor.take("BB", "version")
    if version != VERSION:
        raise FileFormatError(path, f"byte {len(MAGIC)}, version", "1.0", f"{version[0]}.{version[1]}")
    (count,) = cursor.take("I", "number of fields")
    if count * SMALLEST_FIELD > len(data) - cursor.position:
        raise FileFormatError(
            path,
            f"byte {cursor.position - 4}, number of fields",
            f"at most {(len(data) - cursor.position) // SMALLEST_FIELD} (the file has {len(data)} bytes)",
            str(count),
        )
    entries = {}
    for index in range(count):
        start = cursor.position
        name, entry = _field(cursor, index)
        if name in entries:
            raise FileFormatError(path, f"byte {start}, field {index}", "a new name", f"{name!r} again")
        entries[name] = entry
    return {name: _tensor(path, data, cursor.position, name, *entry) for name, entry in entries.items()}


def write_tensor_file(path: str | PathLike, tensors: Mapping[str, np.ndarray]) -> None:
    """The tensors under their names, in their order; written beside and renamed.

    **Raises:** ValueError for types that the container lacks, names of more than 65535 bytes, or too many dimensions.
    """
    arrays = {name: np.asarray(tensor) for name, tensor in tensors.items()}
    entries = []
    for name, array in arrays.items():
        little = array.dtype.newbyteorder("<")
        raw = name.encode()
        if little not in CODES or len(raw) > 0xFFFF or array.ndim > MAX_DIMENSIONS:
            raise ValueError(
                f"a tensor must be of integers or floats of at most {MAX_DIMENSIONS} dimensions and have a name of at "
                f"most 65535 bytes, got {array.dtype} of {array.ndim} dimensions named {name[:40]!r}"
            )
        entries.append((raw, array.astype(little, copy=False), CODES[little]))
    head = MAGIC + bytes(VERSION) + struct.pack("<I", len(entries))
    end = len(head) + sum(SMALLEST_FIELD + len(raw) + 8 * array.ndim for raw, array, _ in entries)
    offsets = []
    for _, array, _ in entries:
        end += -end % ALIGNMENT
        offsets.append(end)
        end += array.nbytes
    with replacing(path) as beside, beside.open("xb") as file:
        file.write(head)
        for (raw, array, code), offset in zip(entries, offsets, strict=True):
            file.write(struct.pack("<H", len(raw)) + raw + struct.pack("<HBQ", array.ndim, code, offset))
            file.write(struct.pack(f"<{array.ndim}Q", *array.shape))
        for (_, array, _), offset in zip(entries, offsets, strict=True):
            file.write(bytes(offset - file.tell()))
            file.write(array.tobytes())


class _Cursor:
    """Walks the header and never past the end of the file."""

    def __init__(self, path: str | PathLike, data: bytes):
        self.path, self.data, self.position = path, data, 0

    def take_bytes(self, size: int, what: str) -> bytes:
        left = len(self.data) - self.position
        if size > left:
            raise FileFormatError(self.path, f"byte {self.position}, {what}", f"{size} bytes", f"the end after {left}")
        self.position += size
        return self.data[self.position - size : self.position]

    def take(self, layout: str, what: str) -> tuple[int, ...]:
        layout = "<" + layout
        return struct.unpack(layout, self.take_bytes(struct.calcsize(layout), what))


def _field(cursor: _Cursor, index: int) -> tuple[str, tuple[np.dtype, int, tuple[int, ...]]]:
    """Name and (type, offset, shape) of the header entry at the cursor."""
    (length,) = cursor.take("H", f"field {index}, length of the name")
    at = cursor.position
    raw = cursor.take_bytes(length, f"field {index}, name")
    try:
        name = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileFormatError(cursor.path, f"byte {at}, field {index}, name", "UTF-8", repr(raw)) from error
    at = cursor.position
    dimensions, code, offset = cursor.take("HBQ", f"field {name!r}")
    if dimensions > MAX_DIMENSIONS:
        raise FileFormatError(
            cursor.path, f"byte {at}, field {name!r}, dimensions", f"at most {MAX_DIMENSIONS}", str(dimensions)
        )
    if code not in DTYPES:
        raise FileFormatError(
            cursor.path, f"byte {at + 2}, field {name!r}, type", f"a code from 1 to {max(DTYPES)}", str(code)
        )
    shape = cursor.take(f"{dimensions}Q", f"field {name!r}, shape")
    return name, (np.dtype(DTYPES[code]), offset, shape)


def _tensor(
    path: str | PathLike, data: bytes, header: int, name: str, dtype: np.dtype, offset: int, shape: tuple[int, ...]
) -> np.ndarray:
    """The tensor as a view of `data`. Python integers: the products below cannot overflow."""
    count = math.prod(shape)
    # An empty axis hides the others from that product, and numpy refuses absurd ones: they are bounded as well.
    absurd = count == 0 and math.prod(max(n, 1) for n in shape) > MAX_EMPTY
    if not header <= offset <= len(data) - count * dtype.itemsize or absurd:
        raise FileFormatError(
            path,
            f"field {name!r}",
            f"data between the end of the header at byte {header} and the end of the file at byte {len(data)}",
            f"shape {shape} of {dtype.name} from byte {offset}",
        )
    return np.frombuffer(data, dtype, count, offset).reshape(shape)
