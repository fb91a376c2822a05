"""Materials of the RGL database (Dupuy and Jakob 2018): isotropic and anisotropic, RGB and spectral."""

import re
from collections.abc import Callable, Sequence
from os import PathLike

import numpy as np

from hshjax._typing import PairFunction
from hshjax.brdfs import RGLTable, TabulatedBRDF
from hshjax.io._rgl_resample import resampled
from hshjax.io.errors import FileFormatError
from hshjax.io.measured import Findings, Measured, Negatives, check_negatives
from hshjax.io.tensor_file import MAGIC, read_tensor_file, write_tensor_file

HALF_PI = np.float32(np.pi / 2) * (1 + 1e-6)
"""Files store the last elevation in float32, which may lie above π/2."""


TURN = 1e-4
"""Of spans of azimuths, relative: they are stored in float32."""


def sniff(head: bytes) -> bool:
    """Whether a file that begins with `head` is a container of tensors; which ones it holds is not looked at."""
    return head.startswith(MAGIC)


def read_rgl(path: str | PathLike) -> TabulatedBRDF:
    """The BRDF of a `.bsdf` file: `brdf(wi, wo)` [sr^-1], cosine not included; the data of `measured_rgl`.

    Negative measurements are kept. `description` is the file's own; `unmeasured` counts the entries that the database
    extrapolated. The tables take the default float of jax's configuration, results the dtype of the directions.

    **Raises:** as `measured_rgl`.
    """
    data = measured_rgl(path).data
    assert isinstance(data, TabulatedBRDF)
    return data


def measured_rgl(path: str | PathLike, *, negatives: Negatives = "keep") -> Measured:
    """The material of a `.bsdf` file as an `RGLTable`, isotropic or anisotropic.

    Channels are R, G, B where the file has the field `rgb`, else its wavelengths, named "360 nm" and so on, with the
    values of its field `spectra`. An entry of these tables cannot be left out, so that negative ones are kept or made
    0 ("clip"), not masked.

    Isotropic RGB files were held against originals. Originals of anisotropic and spectral files were not at hand: the
    reader follows the public source of Mitsuba 3's `measured` plugin, and was held against it on files of the layout.

    **Raises:** FileFormatError for damaged files, and where tables do not fit each other; ValueError for
    `negatives="mask"` and other words; OSError where the file cannot be opened.
    """
    check_negatives(negatives)
    if negatives == "mask":
        raise ValueError('the entries of an RGL table cannot be masked: negatives may be "keep" or "clip", got "mask"')
    fields = _Fields(path, read_tensor_file(path))
    phi_i = fields.numbers("phi_i", 1).astype(np.float64)
    turns = phi_i.size
    fields.require(
        "phi_i",
        turns >= 1 and np.all(np.diff(phi_i) > 0) and (turns == 1 or phi_i[-1] - phi_i[0] <= 2 * np.pi * (1 + TURN)),
        "one azimuth, or increasing ones within a turn",
        lambda: np.array2string(phi_i, threshold=8),
    )
    if turns > 2:
        parts = 2 * np.pi / (phi_i[-1] - phi_i[0])
        fields.require(
            "phi_i",
            min(abs(parts / whole - 1) for whole in (1, 2, 4)) <= TURN and abs(phi_i[0] + np.pi) <= np.pi * TURN,
            "azimuths from -π on over a turn, half of one or a quarter",
            lambda: f"{phi_i[0]:.6g} ... {phi_i[-1]:.6g}",
        )
    theta_i = fields.numbers("theta_i", 1)
    elevations = theta_i.size
    fields.require(
        "theta_i",
        elevations >= 2 and np.all(np.diff(theta_i) > 0) and theta_i[0] >= 0 and theta_i[-1] <= HALF_PI,
        "at least 2 increasing elevations in [0, π/2]",
        lambda: np.array2string(theta_i, threshold=8),
    )
    sigma, ndf = fields.grid("sigma"), fields.grid("ndf")
    fields.require("sigma", np.all(sigma > 0), "positive areas", lambda: f"a minimum of {sigma.min()}")
    fields.require("ndf", np.all(ndf >= 0), "no negative values", lambda: f"a minimum of {ndf.min()}")
    vndf = fields.grid("vndf", turns, elevations)
    fields.require("vndf", np.all(vndf >= 0), "no negative densities", lambda: f"a minimum of {vndf.min()}")
    mass = np.sum(vndf, axis=(2, 3), dtype=np.float64)
    fields.require("vndf", np.all(mass > 0), "positive mass in every slice", lambda: f"sums {mass}")
    values, names = _channels(fields, turns, elevations)
    jacobian = fields.tensor("jacobian")
    fields.require(
        "jacobian",
        jacobian.size == 1 and np.all(jacobian == 1),
        "1",
        lambda: np.array2string(jacobian, threshold=8),
    )
    entries = turns * elevations * values.shape[-2] * values.shape[-1]
    unmeasured, description = _unmeasured(fields, entries), _description(fields)
    negative = int(np.count_nonzero((values < 0).any(axis=2)))
    notes = []
    if negative and negatives == "clip":
        values = np.maximum(values, 0)
        notes.append("Negative values became 0.")
    if unmeasured:
        notes.append(f"{unmeasured} entries were extrapolated by the database.")
    slices = turns * elevations
    table = RGLTable.from_tables(
        theta_i,
        sigma,
        ndf,
        vndf.reshape(slices, *vndf.shape[2:]),
        values.reshape(slices, *values.shape[2:]),
        description=description,
        channel_names=names,
        unmeasured=unmeasured,
        phi_i=phi_i,
    )
    kind = "isotropic" if turns <= 2 else "anisotropic"
    found = Findings(
        f"RGL tensor_file, {kind}", description, names, "sr^-1", entries, negative=negative, notes=tuple(notes)
    )
    return Measured(table, found)


def _channels(fields: "_Fields", turns: int, elevations: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """Values `(turns, elevations, channels, rows, columns)` and the names of the channels."""
    if "rgb" in fields.tensors or not {"spectra", "wavelengths"} & set(fields.tensors):
        return fields.grid("rgb", turns, elevations, 3), ("R", "G", "B")
    wavelengths = fields.numbers("wavelengths", 1)
    fields.require(
        "wavelengths",
        wavelengths.size >= 1 and np.all(np.diff(wavelengths) > 0) and wavelengths[0] > 0,
        "increasing wavelengths above 0 [nm]",
        lambda: np.array2string(wavelengths, threshold=8),
    )
    names = tuple(f"{wavelength:g} nm" for wavelength in wavelengths.tolist())
    return fields.grid("spectra", turns, elevations, wavelengths.size), names


def write_rgl(
    path: str | PathLike,
    brdf: PairFunction,
    *,
    slices: int = 24,
    size: int = 64,
    wavelengths: Sequence[float | int] | None = None,
    repeat: bool = False,
    description: str = "",
) -> int:
    """An isotropic BRDF [sr^-1] as a `.bsdf` file, which the `measured` plugin of Mitsuba 3 renders; written beside and
    renamed.

    `slices` angles of incidence from 0 to 89 degrees, evenly, each with `size` x `size` values at places that suit the
    material (see `_rgl_resample`). With `wavelengths` [nm], rising, one a channel, the file is a spectral one; None:
    those that `channel_names` of the BRDF say, where every one does ("650 nm"); else three channels are R, G, B, and a
    single one is written three times if `repeat`. The table is as coarse as its steps, and files are in float32: read
    it back to see the error.

    Where a table has no value, at nodes that were not measured and in cells without a measured one, ρ / D is that
    of the nearest place of its slice that has one, and the file's mask says that it was not measured. Returned is how
    many entries of a channel are filled so.

    **Raises:** ValueError for an anisotropic BRDF, values that are not finite, channels that do not fit, too few slices
    or values, or an angle of incidence without any value.
    """
    if min(slices, size) < 2:
        raise ValueError(f"a table needs 2 slices and 2 x 2 values at least, got slices={slices}, size={size}")
    tables = resampled(brdf, slices, size)
    values, filled = tables.pop("values"), tables.pop("filled")
    channels = values.shape[2]
    if wavelengths is None:
        wavelengths = wavelengths_of(getattr(brdf, "channel_names", ()))
    if wavelengths is None:
        if channels == 1 and repeat:
            values = np.repeat(values, 3, axis=2)
        elif channels != 3:
            hint = ", or repeat=True writes it three times" if channels == 1 else ""
            raise ValueError(
                f"an RGB file has 3 channels, got {channels}: wavelengths make it a spectral one, as names of channels "
                f"like '650 nm' do{hint}"
            )
        named = {"rgb": values}
    else:
        nanometres = np.asarray(wavelengths, np.float32)
        if nanometres.shape != (channels,) or not (nanometres[0] > 0 and np.all(np.diff(nanometres) > 0)):
            raise ValueError(f"wavelengths must be {channels} rising numbers [nm], one a channel, got {wavelengths}")
        named = {"spectra": values, "wavelengths": nanometres}
    head = {"description": np.frombuffer(description.encode(), np.uint8), "phi_i": np.zeros(1, np.float32)}
    mask = {"valid": np.packbits(filled)} if filled.any() else {}
    write_tensor_file(path, head | tables | named | mask | {"jacobian": np.ones(1, np.uint8)})
    return int(filled.sum())


def wavelengths_of(names: Sequence[str]) -> tuple[float, ...] | None:
    """Those that names of channels say, as "650 nm"; None unless every one does."""
    found = [re.fullmatch(r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?) ?nm", name) for name in names]
    return tuple(float(match[1]) for match in found if match) if found and all(found) else None


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
