"""Materials of the RGL database (Dupuy and Jakob 2018): isotropic ones, converted to RGB."""

from collections.abc import Callable
from os import PathLike

import numpy as np

from hshjax.brdfs import RGLTable, TabulatedBRDF
from hshjax.io.errors import FileFormatError
from hshjax.io.tensor_file import read_tensor_file

HALF_PI = np.float32(np.pi / 2) * (1 + 1e-6)
"""Files store the last elevation in float32, which may lie above π/2."""


def read_rgl(path: str | PathLike) -> TabulatedBRDF:
    """The BRDF of an `*_rgb.bsdf` file: `brdf(wi, wo)` [sr^-1], cosine not included, three channels R, G, B.

    Negative measurements are kept. `description` is the file's own; `unmeasured` counts the entries that the database
    extrapolated. The tables take the default float of jax's configuration, results the dtype of the directions.

    **Raises:** FileFormatError for damaged files, and for anisotropic or spectral ones, which are not supported yet;
    OSError where the file cannot be opened.
    """
    fields = _Fields(path, read_tensor_file(path))
    if "rgb" not in fields.tensors and ("spectra" in fields.tensors or "wavelengths" in fields.tensors):
        raise FileFormatError(path, "field 'rgb'", "an RGB file", "a spectral one (not supported yet; take *_rgb.bsdf)")
    phi_i = fields.numbers("phi_i", 1)
    if phi_i.size != 1:
        raise FileFormatError(
            path,
            "field 'phi_i'",
            "1 azimuth of incidence (isotropic)",
            f"{phi_i.size} (anisotropic: not supported yet)",
        )
    theta_i = fields.numbers("theta_i", 1)
    slices = theta_i.size
    fields.require(
        "theta_i",
        slices >= 2 and np.all(np.diff(theta_i) > 0) and theta_i[0] >= 0 and theta_i[-1] <= HALF_PI,
        "at least 2 increasing elevations in [0, π/2]",
        lambda: np.array2string(theta_i, threshold=8),
    )
    sigma, ndf = fields.grid("sigma"), fields.grid("ndf")
    fields.require("sigma", np.all(sigma > 0), "positive areas", lambda: f"a minimum of {sigma.min()}")
    fields.require("ndf", np.all(ndf >= 0), "no negative values", lambda: f"a minimum of {ndf.min()}")
    vndf = fields.grid("vndf", 1, slices)[0]
    fields.require("vndf", np.all(vndf >= 0), "no negative densities", lambda: f"a minimum of {vndf.min()}")
    mass = np.sum(vndf, axis=(1, 2), dtype=np.float64)
    fields.require("vndf", np.all(mass > 0), "positive mass in every slice", lambda: f"sums {mass}")
    values = fields.grid("rgb", 1, slices, 3)[0]
    jacobian = fields.tensor("jacobian")
    fields.require(
        "jacobian",
        jacobian.size == 1 and np.all(jacobian == 1),
        "1",
        lambda: np.array2string(jacobian, threshold=8),
    )
    return RGLTable.from_tables(
        theta_i,
        sigma,
        ndf,
        vndf,
        values,
        description=_description(fields),
        unmeasured=_unmeasured(fields, slices * values.shape[-2] * values.shape[-1]),
    )


class _Fields:
    """The tensors of one file, with checks that name file and field."""

    def __init__(self, path: str | PathLike, tensors: dict[str, np.ndarray]):
        self.path, self.tensors = path, tensors

    def require(self, name: str, holds: bool | np.bool, expected: str, got: Callable[[], str]) -> None:
        if not holds:
            raise FileFormatError(self.path, f"field {name!r}", expected, got())

    def tensor(self, name: str) -> np.ndarray:
        present = ", ".join(map(repr, self.tensors)) or "no fields"
        self.require(name, name in self.tensors, "this field", lambda: present)
        return self.tensors[name]

    def numbers(self, name: str, dimensions: int) -> np.ndarray:
        """A finite floating tensor of so many dimensions."""
        tensor = self.tensor(name)
        self.require(
            name,
            tensor.ndim == dimensions and tensor.dtype.kind == "f",
            f"{dimensions} dimensions of a float type",
            lambda: f"shape {tensor.shape} of {tensor.dtype.name}",
        )
        # Finite as float32, the type that tables may be kept in.
        wrong = ~(np.abs(tensor) <= np.finfo(np.float32).max)
        self.require(
            name,
            not wrong.any(),
            "finite values",
            lambda: f"{tensor[wrong][0]} at {tuple(map(int, np.argwhere(wrong)[0]))} ({wrong.sum()} of {tensor.size})",
        )
        return tensor

    def grid(self, name: str, *leading: int) -> np.ndarray:
        """A table `(*leading, rows, columns)` with at least 2 x 2 vertices."""
        tensor = self.numbers(name, len(leading) + 2)
        self.require(
            name,
            tensor.shape[:-2] == leading and min(tensor.shape[-2:]) >= 2,
            f"shape ({', '.join(map(str, (*leading, 'rows >= 2', 'columns >= 2')))})",
            lambda: f"{tensor.shape}",
        )
        return tensor


def _description(fields: _Fields) -> str:
    raw = fields.tensor("description")
    fields.require(
        "description",
        raw.ndim == 1 and raw.dtype.kind in "ui" and raw.itemsize == 1,
        "a row of bytes",
        lambda: f"shape {raw.shape} of {raw.dtype.name}",
    )
    try:
        return raw.tobytes().decode("utf-8").rstrip("\0")
    except UnicodeDecodeError as error:
        raise FileFormatError(fields.path, "field 'description'", "UTF-8", str(error)) from error


def _unmeasured(fields: _Fields, entries: int) -> int | None:
    """Number of entries that were not measured, from the mask of one bit an entry, most significant first.

    In spite of its name, a set bit of `valid` marks an entry that is NOT: in the files at hand the set bits are those
    whose outgoing direction is grazing or below the horizon.
    """
    if "valid" not in fields.tensors:
        return None
    mask = fields.tensor("valid")
    size = -(-entries // 8)
    fields.require(
        "valid",
        mask.dtype == np.uint8 and mask.size == size,
        f"{size} bytes, one bit for each of {entries} entries",
        lambda: f"{mask.size} of {mask.dtype.name}",
    )
    return int(np.unpackbits(mask.ravel(), count=entries).sum())
