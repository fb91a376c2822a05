"""OpenEXR images, through the OpenEXR library: one part, half or float channels."""

from collections.abc import Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from hshjax.io._replace import replacing
from hshjax.io.errors import FileFormatError

MAGIC = b"\x76\x2f\x31\x01"
DENSEST = 4096
"""Pixels that a byte may stand for: no compression of a picture gets near."""

COLOUR_ORDER = ("R", "G", "B", "A")


def exr_channels(path: str | PathLike) -> tuple[str, ...]:
    """Names of the channels in the order of `read_exr`: R, G, B[, A] where these are all there is, else alphabetical.

    **Raises:** as `read_exr`.
    """
    part = _part(path, header_only=True)
    try:
        return _ordered(channel.name for channel in part.header["channels"])
    except UnicodeDecodeError as error:  # names are decoded where they are looked at
        raise FileFormatError(path, "header", "names of channels in UTF-8", f"{error}") from error


def read_exr(path: str | PathLike, channels: Sequence[str] | None = None) -> np.ndarray:
    """The pixels of the data window, `(height, width, channels)` float32, first row on top.

    `channels` picks channels by name, in that order; all of them, in the order of `exr_channels`, unless given.

    **Raises:** FileFormatError for anything but an intact image of one part with half or float channels of full
    resolution, or where a channel asked for is missing; OSError where the file cannot be opened.
    """
    found = _part(path, header_only=False).channels
    names = _ordered(found) if channels is None else tuple(channels)
    planes = []
    for name in names:
        if name not in found:
            raise FileFormatError(path, f"channel {name!r}", "this channel", ", ".join(map(repr, sorted(found))))
        pixels = found[name].pixels
        if not isinstance(pixels, np.ndarray) or pixels.dtype not in (np.float16, np.float32):
            got = getattr(pixels, "dtype", type(pixels).__name__)
            raise FileFormatError(path, f"channel {name!r}", "half or float pixels", str(got))
        if planes and pixels.shape != planes[0].shape:
            expected = f"shape {planes[0].shape}, that of channel {names[0]!r}"
            raise FileFormatError(path, f"channel {name!r}", expected, f"{pixels.shape}")
        planes.append(pixels)
    if not planes:
        raise FileFormatError(path, "channels", "at least 1", "none")
    return np.stack(planes, axis=-1).astype(np.float32)


def write_exr(
    path: str | PathLike, image: np.ndarray, channels: Sequence[str] | None = None, *, half: bool = False
) -> None:
    """Write `(height, width)` or `(height, width, channels)`, losslessly compressed (ZIP); written beside and renamed.

    Pixels are float32, exact for float32 images and rounded from float64; with `half` they are rounded to half.
    `channels` names them; unless given: Y for one channel, R G B for three, R G B A for four.

    **Raises:** ValueError for other shapes and types, names that do not fit, or finite values beyond the pixel type.
    """
    import OpenEXR  # imported where it is used: a slow import, and few programs touch images

    image = np.asarray(image)
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or 0 in image.shape or image.dtype.kind != "f":
        raise ValueError(
            "image must be a floating array (height, width) or (height, width, channels) without empty axes, "
            f"got {image.shape} of {image.dtype}"
        )
    names = _names(image.shape[-1], channels)
    dtype = np.float16 if half else np.float32
    with np.errstate(over="ignore"):
        pixels = image.astype(dtype)
    lost = np.isfinite(image) & ~np.isfinite(pixels)
    if lost.any():
        raise ValueError(
            f"values must not exceed {np.finfo(dtype).max} in {dtype.__name__} pixels, got {image[lost][0]}"
        )
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes: dict[str, Any] = {name: np.ascontiguousarray(pixels[..., k]) for k, name in enumerate(names)}
    with replacing(path) as beside:
        # The library reports a folder that does not exist as a RuntimeError; opening says so as an OSError.
        beside.touch(exist_ok=False)
        OpenEXR.File(header, planes).write(fspath(beside))


def _names(count: int, channels: Sequence[str] | None) -> tuple[str, ...]:
    if channels is None:
        defaults = {1: ("Y",), 3: COLOUR_ORDER[:3], 4: COLOUR_ORDER}
        if count not in defaults:
            raise ValueError(f"an image of {count} channels needs `channels`, one name each")
        return defaults[count]
    names = tuple(channels)
    if len(names) != count or len(set(names)) != count or not all(names):
        raise ValueError(f"channels must be {count} different names, got {names}")
    return names


def _ordered(names) -> tuple[str, ...]:
    names = set(names)
    colour = tuple(name for name in COLOUR_ORDER if name in names)
    return colour if names in ({*"RGB"}, {*"RGBA"}) else tuple(sorted(names))


def _check_window(path: str | PathLike, window: Any) -> None:
    """The library allocates what a header asks for before it looks at the pixels."""
    low, high = (np.asarray(corner, np.int64) for corner in window)
    width, height = (high - low + 1).tolist()
    most = max(2**20, DENSEST * Path(path).stat().st_size)
    if width * height > most:
        expected = f"at most {most} pixels, by the size of the file"
        raise FileFormatError(path, "header, dataWindow", expected, f"{width} x {height}")


def _part(path: str | PathLike, *, header_only: bool) -> Any:
    """The only part of an image."""
    import OpenEXR

    with Path(path).open("rb") as file:
        magic = file.read(len(MAGIC))
    if magic != MAGIC:
        raise FileFormatError(
            path, "byte 0", f"an OpenEXR file, beginning with {MAGIC!r}", repr(magic) if magic else "an empty file"
        )
    if not header_only:
        _check_window(path, _part(path, header_only=True).header["dataWindow"])
    try:
        # The library prints a warning about damaged pixels and then leaves their part out.
        parts = OpenEXR.File(fspath(path), separate_channels=True, header_only=header_only).parts
    except (RuntimeError, ValueError, TypeError, MemoryError, UnicodeDecodeError) as error:
        raise FileFormatError(path, "header", "an OpenEXR image", f"an error of the library: {error}") from error
    if not parts:
        raise FileFormatError(path, "pixels", "intact pixels", "truncated or corrupt ones")
    if len(parts) > 1:
        raise FileFormatError(path, "parts", "1", str(len(parts)))
    return parts[0]
