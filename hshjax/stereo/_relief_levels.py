"""Coarse to fine: photographs at half the resolution, and heights at twice."""

import numpy as np

from hshjax._typing import Bool, Float
from hshjax.stereo._corners import Corners, numbers
from hshjax.stereo._relief_energy import Target, flattened, flattening
from hshjax.stereo._relief_solve import factored

COARSEST = 24
"""Root of the number of pixels, above which there is a coarser level."""

UNBENT, UNMOVED = 1e-3, 1e-8
"""How much bending counts in the interpolation, and what makes it unique where nothing bends."""

STEEP = 0.999
"""Longest x and y of an interpolated normal."""


def levels(target: Target) -> list[Target]:
    """The target and ever coarser ones."""
    found = [target]
    while found[-1].mask.sum() > COARSEST**2:
        found.append(_halved(found[-1]))
    return found


def _halved(target: Target) -> Target:
    """Means over 2 x 2 pixels of what is known of them; a pixel is there where any of them is."""
    sums = {name: _sums(target.mask, array) for name, array in _weighted(target).items()}
    mask = _sums(target.mask, np.ones((len(target.values), 1)))[..., 0] > 0
    known, count = sums["known"][mask], sums["count"][mask]
    values = sums["values"][mask] / np.where(known > 0, known, 1)
    return Target(values, np.minimum(known, 1), sums["albedo"][mask] / count, mask)


def _weighted(target: Target) -> dict[str, np.ndarray]:
    return {
        "values": target.values * target.known, "known": target.known, "albedo": target.albedo,
        "count": np.ones_like(target.values),
    }  # fmt: skip


def _sums(mask: Bool[np.ndarray, "rows columns"], array: np.ndarray) -> np.ndarray:
    rows, columns = (size + size % 2 for size in mask.shape)
    full = np.zeros((rows, columns, *array.shape[1:]))
    full[: mask.shape[0], : mask.shape[1]][mask] = array
    return full.reshape(rows // 2, 2, columns // 2, 2, *array.shape[1:]).sum(axis=(1, 3))


def finer(heights: Float[np.ndarray, " corners"], coarse: Corners, fine: Corners) -> Float[np.ndarray, " finer"]:
    """Heights at twice the resolution, in its pixels, of nearly the same normals.

    Heights between corners would do for these, but not for how they bend, of which steps of slopes from pixel to pixel
    make a lot: the x and y of normals are interpolated (of those that have the coarse ones as means over 2 x 2 pixels,
    those that bend least), and heights follow by least squares of how much normals turn.
    """
    from scipy import sparse

    row, column = np.nonzero(fine.mask)
    parent = numbers(coarse.mask)[row // 2, column // 2]
    shares = 1 / np.bincount(parent)[parent]
    means = sparse.csr_array((shares, (parent, np.arange(fine.pixels))), shape=(coarse.pixels, fine.pixels))
    copied = flattened(coarse.slopes(heights))[parent]
    bending = fine.second.T @ fine.second
    # A change with a mean of 0 over 2 x 2 pixels, or nearly so.
    matrix = means.T @ means + UNBENT * bending + UNMOVED * sparse.eye_array(fine.pixels)
    flat = copied - factored(matrix).solve(UNBENT * (bending @ copied))
    length = np.linalg.norm(flat, axis=1, keepdims=True)
    flat = flat * np.minimum(1, STEEP / np.maximum(length, STEEP))
    slopes = -flat / np.sqrt(1 - np.sum(flat**2, axis=1, keepdims=True))
    between = _between(heights, coarse, fine)
    turn = flattening(slopes)
    change = np.einsum("nij,nj->ni", turn, slopes - fine.slopes(between))
    rows = [
        sparse.diags_array(turn[:, k, 0]) @ fine.right + sparse.diags_array(turn[:, k, 1]) @ fine.up for k in (0, 1)
    ]
    matrix = rows[0].T @ rows[0] + rows[1].T @ rows[1]
    matrix = matrix + UNMOVED * np.mean(matrix.diagonal()) * sparse.eye_array(fine.count)
    return between + factored(matrix).solve(rows[0].T @ change[:, 0] + rows[1].T @ change[:, 1])


def _between(heights: Float[np.ndarray, " corners"], coarse: Corners, fine: Corners) -> Float[np.ndarray, " finer"]:
    """Corners of the coarse level are every other one of the fine; means between them."""
    full = np.zeros(coarse.used.shape)
    full[coarse.used] = heights
    rows, columns = full.shape
    double = np.zeros((2 * rows - 1, 2 * columns - 1))
    double[::2, ::2] = full
    double[1::2, ::2] = (full[1:] + full[:-1]) / 2
    double[:, 1::2] = (double[:, 2::2] + double[:, :-2:2]) / 2
    return 2 * double[: fine.used.shape[0], : fine.used.shape[1]][fine.used]


def dome(corners: Corners) -> Float[np.ndarray, " corners"]:
    """A round hill on each piece of a mask: of a disc, half a ball. Pieces that touch at a corner are one."""
    from scipy import ndimage

    used = np.pad(corners.used, 1)
    distance = np.asarray(ndimage.distance_transform_edt(used))
    labels = np.zeros(used.shape, int)
    ndimage.label(used, np.ones((3, 3)), output=labels)
    largest = np.zeros(labels.max() + 1)
    np.maximum.at(largest, labels, distance)
    radius = largest[labels]
    return np.sqrt(distance * (2 * radius - distance))[used]
