"""Coarse to fine: photographs at half the resolution, and heights at twice."""

import numpy as np

from hshjax._typing import Bool, Float
from hshjax.stereo._corners import Corners
from hshjax.stereo._relief_energy import Target

COARSEST = 24
"""Root of the number of pixels, above which there is a coarser level."""


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
    """Heights at twice the resolution, in its pixels: corners of the coarse level are every other one of the fine."""
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
    count = ndimage.label(used, np.ones((3, 3)), output=labels)
    radius = np.concatenate([[0.0], np.atleast_1d(ndimage.maximum(distance, labels, np.arange(1, int(count) + 1)))])
    radius = radius[labels]
    return np.sqrt(distance * (2 * radius - distance))[used]
