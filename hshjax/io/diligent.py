"""Photographs in the folder layout of DiLiGenT (Shi et al., A Benchmark Dataset and Evaluation for Non-Lambertian and
Uncalibrated Photometric Stereo, TPAMI 41(2), 2019), as downloaded or cropped."""

import warnings
from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io._images import read_image, read_mask
from hshjax.io._mat import read_mat_floats
from hshjax.io._photographs import Saturated, assemble, check_options, make_lights
from hshjax.io.errors import FileFormatError
from hshjax.photographs import Photographs

NORMALS = "Normal_gt"


def read_diligent(folder: str | PathLike, *, saturated: Saturated = "drop") -> Photographs:
    """Photographs, calibrated lights and, where the folder has them, true normals.

    The folder holds `filenames.txt`, `light_directions.txt` (x y z), `light_intensities.txt` (R G B), `mask.png`, the
    images, and optionally `Normal_gt.mat`. Directions and normals are in the world of a camera far away: x right, y up,
    z towards it, as the fit of the ball's true normals shows.

    Values are pixel / 65535 and not divided by the lights' intensities, which are the irradiances of `lights`.

    - `saturated`: values of 65535 become NaN ("drop") or stay ("keep"). The benchmark's own images are clipped there:
      the ball's have this value 1429 times, and 9 values in the 535 levels below.

    **Raises:** FileFormatError where counts, sizes or types disagree, or a file is damaged or missing in the list;
    OSError where a file of the layout cannot be opened; ImportError without the extra `photographs`.
    """
    check_options(saturated)
    folder = Path(folder)
    listing = folder / "filenames.txt"
    names = [line.strip() for line in _text(listing).splitlines() if line.strip()]
    if not names:
        raise FileFormatError(listing, "lines", "the name of an image each", "none")
    directions = _table(folder / "light_directions.txt", len(names), listing)
    intensities = _table(folder / "light_intensities.txt", len(names), listing)
    if not np.all(intensities > 0):
        raise FileFormatError(folder / "light_intensities.txt", "values", "numbers above 0", str(intensities.min()))
    paths = []
    for number, name in enumerate(names, 1):
        if Path(name).name != name or not (folder / name).is_file():
            raise FileFormatError(listing, f"line {number}", "the name of an image in the same folder", repr(name))
        paths.append(folder / name)
    if len(set(names)) != len(names):
        raise FileFormatError(listing, "lines", "different names", f"{len(names) - len(set(names))} repeated")
    mask = read_mask(folder / "mask.png")
    lights, notes = make_lights(folder / "light_directions.txt", directions, intensities)
    truth_file = folder / f"{NORMALS}.mat"
    truth = _normals(truth_file, mask) if truth_file.exists() else None
    return assemble(
        ((path, _rgb(path)) for path in paths),
        len(paths),
        lights=lights,
        mask=mask,
        mask_file=folder / "mask.png",
        truth=truth,
        saturated=saturated,
        notes=[f"DiLiGenT layout, {'with' if truth is not None else 'without'} true normals.", *notes],
    )


def _rgb(path: Path) -> np.ndarray:
    pixels = read_image(path)
    if pixels.dtype != np.uint16 or pixels.shape[-1] != 3:
        got = f"{pixels.shape[-1]} channels of {pixels.dtype}"
        raise FileFormatError(path, "pixels", "3 channels of 16 bits", got)
    return pixels


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(path, f"byte {error.start}", "text in UTF-8", "other bytes") from error


def _table(path: Path, rows: int, listing: Path) -> np.ndarray:
    """Three numbers a line."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # an empty file is refused below
            table = np.loadtxt(_text(path).splitlines(), ndmin=2)
    except ValueError as error:
        raise FileFormatError(path, "lines", "three numbers each", str(error)) from error
    if table.shape != (rows, 3) or not np.all(np.isfinite(table)):
        expected = f"three finite numbers for each of the {rows} images of {listing.name}"
        got = f"{table.shape[0]} lines of {table.shape[1]}" if table.shape != (rows, 3) else "others"
        raise FileFormatError(path, "lines", expected, got)
    return table


def _normals(path: Path, mask: np.ndarray) -> np.ndarray:
    normals = read_mat_floats(path, NORMALS)
    if normals.shape != (*mask.shape, 3):
        expected = f"shape {(*mask.shape, 3)}, as the mask"
        raise FileFormatError(path, f"field {NORMALS!r}", expected, str(normals.shape))
    return normals
