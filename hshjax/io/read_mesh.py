"""Meshes of other programs (PLY, OBJ, STL and more), through trimesh."""

from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from hshjax.io.errors import FileFormatError

SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb")


def read_mesh(path: str | PathLike) -> tuple[np.ndarray, np.ndarray]:
    """Vertices `(vertices, 3)` float64 and triangles `(faces, 3)` of a file; parts of a scene become one mesh.

    **Raises:** FileFormatError for another suffix, a damaged file, no triangle, or vertices that are not finite;
    OSError where it cannot be opened; ImportError without the extra `photographs`.
    """
    import trimesh  # imported where it is used: slow, and optional

    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise FileFormatError(path, "suffix", f"one of {', '.join(SUFFIXES)}", repr(path.suffix))
    with path.open("rb"):  # what cannot be opened is an OSError, whatever the library makes of it
        pass
    try:
        mesh: Any = trimesh.load(fspath(path), force="mesh", process=False)
        vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    except Exception as error:  # parsers of many formats, whose errors have no common class
        got = f"an error of the library: {type(error).__name__}: {error}"
        raise FileFormatError(path, "mesh", "an intact mesh", got) from error
    if faces.ndim != 2 or not len(faces):
        raise FileFormatError(path, "faces", "at least one triangle", "none")
    if not np.isfinite(vertices).all():
        raise FileFormatError(path, "vertices", "finite positions", f"{np.sum(~np.isfinite(vertices))} that are not")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FileFormatError(path, "faces", f"vertices 0 to {len(vertices) - 1}", f"{faces.min()} to {faces.max()}")
    return vertices, faces
