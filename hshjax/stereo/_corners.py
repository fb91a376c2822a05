"""Heights at the corners of pixels: every pixel has four, and with them a normal, whatever the mask."""

import numpy as np

from hshjax._typing import Bool, Float
from hshjax.photographs import numbers


class Corners:
    """The corners of the pixels of a mask, row by row, and what is linear in heights there. Sparse matrices.

    - `used` `(rows + 1, columns + 1)`: corners of any pixel. - `pixels`, `count`: numbers of pixels and corners.
    - `right`, `up` `(pixels, count)`: slopes of a pixel, the means of those of its two edges in x and in y.
    - `middle` `(pixels, count)`: its height, the mean of its corners.
    - `second` `(differences, pixels)`: second differences of a function of pixels in x, y, and √2 times the mixed ones.

    Slopes belong to heights, so that they are integrable: of any 2 x 2 pixels, the x slopes of the upper two less those
    of the lower two are the y slopes of the right two less those of the left two.
    """

    def __init__(self, mask: Bool[np.ndarray, "rows columns"]):
        from scipy import sparse

        row, column = np.nonzero(mask)
        self.mask, self.pixels = mask, len(row)
        self.used = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), bool)
        around = [(row + down, column + right) for down in (0, 1) for right in (0, 1)]
        for place in around:
            self.used[place] = True
        number = numbers(self.used)
        self.count = int(self.used.sum())
        entries = np.stack([number[place] for place in around], axis=1).ravel()
        where = np.repeat(np.arange(self.pixels), 4), entries
        size = self.pixels, self.count
        self.right, self.up, self.middle = (
            sparse.csr_array((np.tile(shares, self.pixels), where), shape=size)
            for shares in ([-0.5, 0.5, -0.5, 0.5], [0.5, 0.5, -0.5, -0.5], [0.25] * 4)
        )
        self.second = _second_differences(mask)

    def slopes(self, heights: Float[np.ndarray, " corners"]) -> Float[np.ndarray, "pixels 2"]:
        """∂z/∂x and ∂z/∂y of every pixel, in heights per pixel."""
        return np.stack([self.right @ heights, self.up @ heights], axis=1)


def _second_differences(mask: Bool[np.ndarray, "rows columns"]):
    """One row for each place where all pixels that a difference needs are there."""
    from scipy import sparse

    number, (rows, columns) = numbers(mask), mask.shape
    root = np.sqrt(2)
    stencils = (
        (((0, 0), (0, 1), (0, 2)), (1, -2, 1)),
        (((0, 0), (1, 0), (2, 0)), (1, -2, 1)),
        (((0, 0), (0, 1), (1, 0), (1, 1)), (root, -root, -root, root)),
    )
    parts = []
    for places, factors in stencils:
        tall, wide = (max(place[axis] for place in places) for axis in (0, 1))
        if rows <= tall or columns <= wide:
            continue
        found = [number[down : rows - tall + down, right : columns - wide + right].ravel() for down, right in places]
        pixels = np.stack(found, axis=1)
        pixels = pixels[np.all(pixels >= 0, axis=1)]
        where = np.repeat(np.arange(len(pixels)), len(places)), pixels.ravel()
        shape = len(pixels), int(mask.sum())
        parts.append(sparse.csr_array((np.tile(np.asarray(factors, float), len(pixels)), where), shape=shape))
    return sparse.vstack([*parts, sparse.csr_array((0, int(mask.sum())))], format="csr")
