"""A small good file of every kind that is read, and what reads it: for hostile variants and for fuzzing."""

import io
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import imagecodecs
import jax.numpy as jnp
import numpy as np
from scipy.io import savemat

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import GGX, Lambert, LinearBRDF
from hshjax.io import FORMATS, read_exr, read_material, read_measured, read_photographs_npz, save_model, write_exr
from hshjax.io._images import read_image
from hshjax.io._mat import read_mat_floats
from hshjax.io.merl import write_merl
from tests.io import tensor_files, text_formats


def _written(write: Callable[[Path], object], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"seed{suffix}"
        write(path)
        return path.read_bytes()


def _rgl() -> bytes:
    return tensor_files.packed(tensor_files.material())


def _merl() -> bytes:
    brdf = Lambert([0.3, 0.2, 0.1]) + GGX([0.1, 0.1, 0.1], 0.5)
    return _written(lambda path: write_merl(path, brdf, steps=(4, 3, 6)), ".binary")


def _model() -> bytes:
    basis = IsotropicBasis(HSH(1))
    return _written(lambda path: save_model(path, LinearBRDF(basis, jnp.ones((basis.count, 3)))), ".hshjax")


def _npz() -> bytes:
    images = np.random.default_rng(0).uniform(0.1, 1, (4, 5, 6, 3)).astype(np.float32)
    lights = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8], [-0.6, 0, 0.8]])
    file = io.BytesIO()
    np.savez_compressed(file, images=images, lights=lights)
    return file.getvalue()


def _mat(compressed: bool) -> bytes:
    file = io.BytesIO()
    normals = np.random.default_rng(0).uniform(0, 1, (4, 5, 3))
    savemat(file, {"Normal_gt": normals}, do_compression=compressed)
    return file.getvalue()


def _exr() -> bytes:
    image = np.random.default_rng(0).uniform(0, 1, (6, 7, 3)).astype(np.float32)
    return _written(lambda path: write_exr(path, image), ".exr")


def _png() -> bytes:
    return imagecodecs.png_encode(np.random.default_rng(0).integers(0, 2**16, (6, 7, 3), dtype=np.uint16))


def _utia() -> bytes:
    return np.random.default_rng(0).uniform(0.1, 1, 3 * 288 * 288).astype("<f8").tobytes()


MEASURED: dict[str, Callable[[], bytes]] = {
    "rgl": _rgl,
    "merl": _merl,
    "utia": _utia,
    **{one.name: (lambda content=one.content: content) for one in text_formats.FORMATS},
}
"""Of every format in `FORMATS`."""

OTHERS: dict[str, tuple[Callable[[], bytes], Callable[[Path], object]]] = {
    "model": (_model, read_material),
    "npz": (_npz, read_photographs_npz),
    "mat": (lambda: _mat(False), lambda path: read_mat_floats(path, "Normal_gt")),
    "mat, compressed": (lambda: _mat(True), lambda path: read_mat_floats(path, "Normal_gt")),
    "exr": (_exr, read_exr),
    "png": (_png, read_image),
}


def seeds() -> dict[str, tuple[bytes, tuple[Callable[[Path], object], ...]]]:
    """By name: a good file, and its readers; of measured materials the dispatcher, too."""
    found = {
        name: (make(), (read_material, lambda path, name=name: read_measured(path, format=name)))
        for name, make in MEASURED.items()
    }
    return found | {name: (make(), (read,)) for name, (make, read) in OTHERS.items()}


def missing() -> set[str]:
    """Formats that have no good file here."""
    return set(FORMATS) ^ set(MEASURED)


def zip_bomb(size: int) -> bytes:
    """An archive of photographs that unpacks to `size` bytes of zeros."""
    file, zeros = io.BytesIO(), bytes(2**20)
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f4", "fortran_order": False, "shape": (4, size // 16, 1)})
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("images.npy", "w") as member:
        member.write(head.getvalue())
        for _ in range(size // len(zeros)):
            member.write(zeros)
    return file.getvalue()
