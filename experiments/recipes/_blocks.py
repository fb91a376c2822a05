"""Images cut into square blocks, to be averaged."""

import numpy as np


def square_blocks(image: np.ndarray, height: int) -> np.ndarray:
    """An image `(rows, columns, channels)` as `(height, block, width, block, channels)`.

    **Raises:** ValueError where blocks do not fit.
    """
    rows, columns, channels = image.shape
    block = rows // height
    if block == 0 or rows != block * height or columns % block:
        raise ValueError(f"height must divide the image into square blocks: {columns} x {rows}, height {height}")
    return image.reshape(height, block, columns // block, block, channels)
