"""The contour of an object: where its surface turns away from the camera, normals point out of the mask."""

import numpy as np

from hshjax._typing import Bool, Float, Int
from hshjax.stereo._corners import numbers

BLUR = 2.0
"""Of the mask, in pixels, whose slope is the outward direction."""

TILT = 0.15
"""n_z that normals of the contour have on average: its pixels lie inside of it."""

FACING = 0.3
"""How much the mean normal's towards the camera counts, against all of the contour."""

ROUNDS = 30

LEAST = 16
"""Pixels of a contour."""


def contour(mask: Bool[np.ndarray, "rows columns"]) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Numbers of the pixels at the contour, and unit directions out of the mask (x right, y up).

    Pixels at the border of the photographs are none of it: the object goes on there.

    **Raises:** ValueError where fewer than `LEAST` are left.
    """
    pixels, outward = silhouette(mask)
    if len(pixels) < LEAST:
        raise ValueError(
            f"the contour of the mask has {len(pixels)} pixels inside of the photographs, expected at least {LEAST}: "
            "without it unknown lights are not determined"
        )
    return pixels, outward


def silhouette(mask: Bool[np.ndarray, "rows columns"]) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """`contour`, however few pixels there are."""
    from scipy import ndimage

    wide = int(4 * BLUR)
    blurred = np.asarray(ndimage.gaussian_filter(np.pad(mask, wide).astype(float), BLUR))
    down, right = (np.gradient(blurred, axis=axis)[wide:-wide, wide:-wide] for axis in (0, 1))
    edge = mask & ~np.asarray(ndimage.binary_erosion(mask, np.ones((3, 3)), border_value=1), bool)
    edge[[0, -1]] = edge[:, [0, -1]] = False
    outward = np.stack([-right[edge], down[edge]], axis=1)
    length = np.linalg.norm(outward, axis=1)
    there = length > 0  # 0 where the mask is as wide on both sides
    return numbers(mask)[edge][there], outward[there] / length[there, None]


def turn(normals: Float[np.ndarray, "pixels 3"], mask: Bool[np.ndarray, "rows columns"]) -> Float[np.ndarray, "3 3"]:
    """The orthogonal matrix, with or without a reflection, that makes normals look out of the mask at its contour, and
    towards the camera on average. By sums of distances, not of their squares: not all of a contour is one."""
    pixels, outward = contour(mask)
    wanted = np.concatenate([np.sqrt(1 - TILT**2) * outward, np.full((len(pixels), 1), TILT)], axis=1)
    mean = np.mean(normals, axis=0)
    facing = FACING * np.outer(mean / np.linalg.norm(mean), [0, 0, 1])
    weight, found = np.ones(len(pixels)), np.eye(3)
    for _ in range(ROUNDS):
        moment = (weight[:, None] * normals[pixels]).T @ wanted / np.sum(weight) + facing
        left, _, right = np.linalg.svd(moment)
        found = (left @ right).T
        distance = np.linalg.norm(normals[pixels] @ found.T - wanted, axis=1)
        weight = 1 / np.maximum(distance, 0.05)
    return found
