"""Images of one view, put together in one file that need not fit in memory."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io._images import read_image
from hshjax.io._replace import replacing
from hshjax.io.errors import FileFormatError


def stack_images(paths: Sequence[str | PathLike], out: str | PathLike) -> np.ndarray:
    """Images as one array `(pixels, images, channels)`, mapped from the .npy file `out`, which is written here.

    One image at a time is in memory, each is decoded once, and values are as stored (see `read_photographs` for what
    makes radiance of photographs). In the file, of shape `(images, rows * columns, channels)`, an image is in one
    piece, row by row. Written beside and renamed. To map it again: `np.load(out, mmap_mode="r").transpose(1, 0, 2)`.

    **Raises:** ValueError for no image; FileFormatError for one that differs from the first in shape or type, and as
    the reader of its kind; OSError where a file cannot be opened.
    """
    files = [Path(path) for path in paths]
    if not files:
        raise ValueError("a stack needs at least one image, got none")
    first = read_image(files[0])
    shape = len(files), first.shape[0] * first.shape[1], first.shape[2]
    with replacing(out) as beside, beside.open("xb") as file:
        header = {"descr": np.lib.format.dtype_to_descr(first.dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        for path in files:
            image = first if path == files[0] else read_image(path)
            if (image.shape, image.dtype) != (first.shape, first.dtype):
                expected = f"{first.shape} of {first.dtype}, as of {files[0].name}"
                raise FileFormatError(path, "pixels", expected, f"{image.shape} of {image.dtype}")
            file.write(np.ascontiguousarray(image).tobytes())
    return np.load(out, mmap_mode="r").transpose(1, 0, 2)
