"""Images exactly as they are stored: PNG of 8 and 16 bits, JPEG, OpenEXR. Kind by the first bytes, not by the name.

PNG goes through imagecodecs: Pillow and what builds on it read 16-bit RGB as 8-bit without a word. JPEG goes through
Pillow: imagecodecs fills in the rest of a truncated file.
"""

import io
import os
import struct
from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io import exr
from hshjax.io._expansion import check_expansion
from hshjax.io.errors import FileFormatError

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
JPEG_MAGIC = b"\xff\xd8\xff"
LARGEST = 2**30
"""Bytes of a file that is read as a whole: more than any camera writes."""

ORIENTATION = 0x0112
"""Tag of EXIF (CIPA DC-008)."""

SUFFIXES = (".png", ".jpg", ".jpeg", ".exr")


def read_image(path: str | PathLike) -> np.ndarray:
    """Pixels as stored, `(rows, columns, channels)`: uint8, uint16, or float32 of OpenEXR. Row 0 on top.

    Nothing is applied: no gamma, no profile, no orientation of EXIF. Palettes are looked up. An alpha channel of PNG
    is left out if it is opaque throughout.

    **Raises:** FileFormatError for other kinds, broken and truncated files, and transparent pixels; OSError where the
    file cannot be opened; ImportError without the extra `photographs`.
    """
    pixels, alpha = _with_alpha(Path(path))
    transparent = 0 if alpha is None else int(np.sum(alpha != np.iinfo(alpha.dtype).max))
    if transparent:
        raise FileFormatError(path, "alpha channel", "opaque pixels", f"{transparent} that are not")
    return pixels


def _with_alpha(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Pixels as stored, without the alpha channel of a PNG, and that `(rows, columns)`, should it have one."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > LARGEST:
            raise FileFormatError(path, "file", f"an image of at most {LARGEST} bytes", f"{size}")
        content = file.read()
    if content.startswith(exr.MAGIC):
        return exr.read_exr(path), None
    pixels = _decoded(path, content)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    return (pixels[..., :-1], pixels[..., -1]) if pixels.shape[-1] in (2, 4) else (pixels, None)


def orientation(path: str | PathLike) -> int:
    """How EXIF wants a JPEG to be turned before it is shown: 1 for as it is stored, and for other kinds of files.

    **Raises:** FileFormatError where that cannot be read; OSError where the file cannot be opened.
    """
    from PIL import Image

    path = Path(path)
    with path.open("rb") as file:
        if file.read(len(JPEG_MAGIC)) != JPEG_MAGIC:
            return 1
        file.seek(0)
        try:
            with Image.open(file) as image:
                return int(image.getexif().get(ORIENTATION, 1))
        except (OSError, ValueError, TypeError, SyntaxError, struct.error) as error:
            raise FileFormatError(
                path, "header", "an intact JPEG image", f"an error of the library: {error}"
            ) from error


def read_mask(path: str | PathLike) -> np.ndarray:
    """Which pixels of an image count, bool `(rows, columns)`: where the mean of channels is above half its largest.
    What is transparent counts as black.

    **Raises:** as `read_image`; FileFormatError for OpenEXR and for a mask that leaves nothing.
    """
    pixels, alpha = _with_alpha(Path(path))
    if pixels.dtype.kind != "u":
        raise FileFormatError(path, "pixels", "8 or 16 bits", str(pixels.dtype))
    grey = pixels.mean(axis=-1)
    if alpha is not None:
        grey = grey * (alpha / np.iinfo(alpha.dtype).max)
    mask = grey > grey.max() / 2  # files of 0 and 1 are about, beside those of 0 and 255
    if not mask.any():
        raise FileFormatError(path, "mask", "pixels that see the object, above 0", "none")
    return mask


def write_png(path: str | PathLike, pixels: np.ndarray) -> None:
    """Write uint8 or uint16 pixels, `(rows, columns)` or `(rows, columns, 3)`, exactly."""
    import imagecodecs

    from hshjax.io._replace import replacing

    content = imagecodecs.png_encode(np.ascontiguousarray(pixels))
    with replacing(path) as beside:
        beside.write_bytes(content)


def _decoded(path: Path, content: bytes) -> np.ndarray:
    import imagecodecs  # imported where it is used: optional

    if content.startswith(PNG_MAGIC):
        decode = imagecodecs.png_decode
        _check_png(path, content)
    elif content.startswith(JPEG_MAGIC):
        decode = _jpeg
    else:
        got = repr(content[:8]) if content else "an empty file"
        raise FileFormatError(path, "byte 0", "an image: PNG, JPEG or OpenEXR", got)
    try:
        return decode(content)
    except (RuntimeError, ValueError, OSError, MemoryError, OverflowError, SyntaxError) as error:
        raise FileFormatError(path, "pixels", "an intact image", f"an error of the library: {error}") from error


def _check_png(path: Path, content: bytes) -> None:
    """That pixels of the size that the header declares are worth unpacking (PNG specification, section 11.2.2)."""
    if len(content) < 26 or content[12:16] != b"IHDR":
        return  # which the library refuses
    columns, rows, bits, kind = struct.unpack_from(">IIBB", content, 16)
    channels = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}.get(kind, 4)  # a palette of colours is looked up
    check_expansion(path, "header", columns * rows * channels * max(1, bits // 8), len(content))


def _jpeg(content: bytes) -> np.ndarray:
    from PIL import Image

    with Image.open(io.BytesIO(content)) as image:
        if image.mode not in ("L", "RGB"):
            raise ValueError(f"colours {image.mode}, neither grey nor RGB")
        return np.asarray(image)
