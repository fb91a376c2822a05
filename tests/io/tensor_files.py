"""Writes the `tensor_file` container, and a small material in it, independently of the reader."""

import struct

import numpy as np

CODES = {
    "uint8": 1, "int8": 2, "uint16": 3, "int16": 4, "uint32": 5, "int32": 6,
    "uint64": 7, "int64": 8, "float16": 9, "float32": 10, "float64": 11,
}  # fmt: skip


def packed(tensors: dict[str, np.ndarray]) -> bytes:
    """The bytes of a `tensor_file`, data after the header."""
    offset = 18 + sum(2 + len(name.encode()) + 11 + 8 * t.ndim for name, t in tensors.items())
    header, data = b"tensor_file\0\1\0" + struct.pack("<I", len(tensors)), b""
    for name, t in tensors.items():
        raw = name.encode()
        header += (
            struct.pack("<H", len(raw)) + raw + struct.pack("<HBQ", t.ndim, CODES[t.dtype.name], offset + len(data))
        )
        header += struct.pack(f"<{t.ndim}Q", *t.shape)
        data += t.astype(t.dtype.newbyteorder("<")).tobytes()
    return header + data


def material(slices: int = 3, seed: int = 0) -> dict[str, np.ndarray]:
    """A small isotropic RGB material with random tables, the mask with 5 set bits."""
    rng = np.random.default_rng(seed)

    def positive(*shape):
        return rng.uniform(0.5, 2, shape).astype(np.float32)

    mask = np.zeros(slices * 4 * 5, np.uint8)
    mask[[0, 7, 8, 20, -1]] = 1
    return {
        "description": np.frombuffer("Kupfer, gebürstet".encode(), np.uint8),
        "phi_i": np.zeros(1, np.float32),
        "theta_i": np.linspace(0, np.pi / 2, slices).astype(np.float32),
        "sigma": np.repeat(positive(1, 8), 2, axis=0),
        "ndf": np.repeat(positive(1, 8), 2, axis=0),
        "vndf": positive(1, slices, 7, 6),
        "rgb": positive(1, slices, 3, 4, 5),
        "jacobian": np.ones(1, np.uint8),
        "valid": np.packbits(mask),
    }
