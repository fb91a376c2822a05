"""Meshes of surfaces over the pixels of an image, as PLY, through trimesh."""

from os import PathLike

import numpy as np

from hshjax.io._replace import replacing
from hshjax.photographs import numbers
from hshjax.surface import Surface


def write_ply(path: str | PathLike, surface: Surface, *, colours: np.ndarray | None = None) -> None:
    """Write what a camera sees of a shape, such as `height_field` gives it: a vertex and its normal for each pixel.

    Neighbouring pixels inside the mask are joined: two triangles where all four of a square are inside, one where three
    are, counter-clockwise as the camera sees them. A pixel without such neighbours is a vertex of no triangle. float32,
    binary, little-endian; lengths in the unit of the surface.

    - `colours` `(rows, columns, 3)`: uint8, as displays take them; None: no colours.

    **Raises:** ValueError for a surface that is not `(rows, columns)`, for one without a pixel, positions that are not
    finite, and other colours; ImportError without the extra `photographs`.
    """
    import trimesh  # imported where it is used: slow, and optional
    from trimesh.exchange.ply import export_ply

    position, normal = np.asarray(surface.position), np.asarray(surface.normal)
    mask = np.any(normal != 0, axis=-1)
    if mask.ndim != 2 or not mask.any():
        raise ValueError(
            f"a mesh needs a surface over (rows, columns), with points in it; got {mask.shape} and {mask.sum()}"
        )
    if not np.all(np.isfinite(position[mask])):
        raise ValueError("positions of the surface must be finite")
    if colours is not None and (colours.shape != position.shape or colours.dtype != np.uint8):
        raise ValueError(f"colours must be {position.shape} of uint8, got {colours.shape} of {colours.dtype}")
    mesh = trimesh.Trimesh(
        position[mask],
        triangles(mask),
        vertex_normals=normal[mask],
        vertex_colors=None if colours is None else colours[mask],
        process=False,  # vertices stay as many, and in this order
    )
    content = export_ply(mesh)
    with replacing(path) as beside:
        beside.write_bytes(content)


def triangles(mask: np.ndarray) -> np.ndarray:
    """Triangles `(n, 3)` between neighbouring pixels of a mask, as numbers of its pixels row by row.

    Counter-clockwise in an image whose rows run down.
    """
    number = numbers(mask)
    corners = (slice(None, -1), slice(None, -1)), (slice(1, None), slice(None, -1))
    corners += (slice(1, None), slice(1, None)), (slice(None, -1), slice(1, None))
    inside = np.stack([mask[corner] for corner in corners])  # around each square, counter-clockwise
    vertex = np.stack([number[corner] for corner in corners])
    full, found = inside.all(axis=0), []
    for left_out in range(4):
        keep = [k for k in range(4) if k != left_out]
        whole = full if left_out in (1, 3) else np.zeros_like(full)  # either diagonal of a full square will do
        some = whole | (inside[keep].all(axis=0) & ~inside[left_out])
        found.append(vertex[keep][:, some].T)
    return np.concatenate(found)
