"""Photographs in the folder layout of DiLiGenT (Shi et al., A Benchmark Dataset and Evaluation for Non-Lambertian and
Uncalibrated Photometric Stereo, TPAMI 41(2), 2019), as downloaded, cropped, or made by others in its image."""

from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io._diligent_truth import MAT, PICTURE, TEXT, numbers_of_lines, text_of, true_normals
from hshjax.io._folder_files import FolderFiles
from hshjax.io._images import SUFFIXES, read_image, read_mask
from hshjax.io._photographs import Encoding, Saturated, assemble, check_options, make_lights
from hshjax.io.errors import FileFormatError
from hshjax.photographs import LUMA, Photographs

LISTING, DIRECTIONS, INTENSITIES, MASK = "filenames.txt", "light_directions.txt", "light_intensities.txt", "mask.png"


def is_diligent(folder: str | PathLike) -> bool:
    """Whether a folder has a file of the layout that no other one has, and no light file (*.lp) instead of lights."""
    files = FolderFiles(Path(folder))
    if files.get(DIRECTIONS):
        return True
    return not files.ending(".lp") and any(files.get(name) for name in (LISTING, INTENSITIES, MAT, TEXT))


def read_diligent(
    folder: str | PathLike, *, saturated: Saturated = "drop", encoding: Encoding = "linear"
) -> Photographs:
    """Photographs, calibrated lights and, where the folder has them, true normals.

    The folder holds images of one size, channels and type, and what it has of these, in letters of either case:

    - `filenames.txt`: images in the order of lights; without it, in the order of names.
    - `light_directions.txt` (x y z); without it nothing is known of the lights.
    - `light_intensities.txt` (R G B, or one number); 1 without it.
    - `mask.png`; without it every pixel is taken to see the object.
    - `Normal_gt.mat`, or `normal.txt` with a line for each pixel of the image or of the mask, row by row.

    Directions and normals are in the world of a camera far away: x right, y up, z towards it, as the fit of the ball's
    true normals shows.

    Values are pixel / 65535 (255 of 8 bits) and not divided by the lights' intensities, which are the irradiances of
    `lights`. Intensities of R, G and B of images of one channel are weighted as grey is (`LUMA`).

    - `saturated`: values of 65535 become NaN ("drop") or stay ("keep"). The benchmark's own images are clipped there:
      the ball's have this value 1429 times, and 9 values in the 535 levels below.
    - `encoding`: "srgb" of images that a camera made so; the benchmark's are linear in light.

    **Raises:** FileFormatError where counts, sizes or types disagree, or a file is damaged or missing in the list;
    OSError where a file cannot be opened; ImportError without the extra `photographs`.
    """
    check_options(saturated, encoding)
    folder = Path(folder)
    files = FolderFiles(folder)
    paths, order = _images(folder, files)
    lights, notes = _lights(files, paths, order)
    mask_file = files.get(MASK)
    mask = None if mask_file is None else read_mask(mask_file)
    if mask is None:
        notes.append(f"No {MASK}: every pixel is taken to see the object.")
        shape = read_image(paths[0]).shape[:2]
    else:
        shape = mask.shape
    truth, source = true_normals(files, shape, np.ones(shape, bool) if mask is None else mask)
    notes.insert(0, f"DiLiGenT layout, {f'with true normals of {source}' if source else 'without true normals'}.")
    return assemble(
        ((path, read_image(path)) for path in paths),
        len(paths),
        lights=lights,
        mask=mask,
        mask_file=folder / MASK,
        truth=truth,
        saturated=saturated,
        encoding=encoding,
        notes=notes,
    )


def _images(folder: Path, files: FolderFiles) -> tuple[list[Path], str]:
    """The images in the order of lights, and what says so."""
    listing = files.get(LISTING)
    if listing is None:
        apart = {path for path in (files.get(MASK), files.get(PICTURE)) if path is not None}
        paths = [path for path in files.ending(*SUFFIXES) if path not in apart]
        if not paths:
            raise FileFormatError(folder, "images", f"at least one of {', '.join(SUFFIXES)}", "none")
        return paths, "the folder, by name"
    numbered = [(number, line.strip()) for number, line in enumerate(text_of(listing).splitlines(), 1) if line.strip()]
    if not numbered:
        raise FileFormatError(listing, "lines", "the name of an image each", "none")
    paths = []
    for number, name in numbered:
        path = files.get(name.replace("\\", "/").rsplit("/", 1)[-1])
        if path is None:
            raise FileFormatError(listing, f"line {number}", "the name of an image in the same folder", repr(name))
        paths.append(path)
    if len(set(paths)) != len(paths):
        raise FileFormatError(listing, "lines", "different names", f"{len(paths) - len(set(paths))} repeated")
    return paths, listing.name


def _lights(files: FolderFiles, paths: list[Path], order: str):
    """Lights of the images, None where their directions are not known, and notes. `order`: where images are named."""
    where, strength = files.get(DIRECTIONS), files.get(INTENSITIES)
    if where is None:
        return None, [f"No {DIRECTIONS}: nothing is known of the lights."]
    directions = _table(where, len(paths), order, 3)
    notes = [] if files.get(LISTING) else [f"No {LISTING}: images are taken in the order of their names."]
    irradiance = None
    if strength is None:
        notes.append(f"No {INTENSITIES}: every light is taken to have the same, 1.")
    else:
        irradiance = _table(strength, len(paths), order, 1, 3)
        for k in np.flatnonzero(np.any(irradiance <= 0, axis=1))[:1]:
            raise FileFormatError(strength, f"light {k + 1}", "numbers above 0", str(irradiance[k].min()))
        if irradiance.shape[1] == 3 and read_image(paths[0]).shape[-1] == 1:
            irradiance = irradiance @ np.asarray(LUMA)[:, None]
            notes.append(f"Images of one channel: R, G and B of {strength.name} are weighted as grey is.")
    lights, said = make_lights(where, directions, irradiance)
    return lights, [*notes, *said]


def _table(path: Path, rows: int, order: str, *columns: int) -> np.ndarray:
    """Finite numbers, a line for each image."""
    table = numbers_of_lines(path, *columns)
    if len(table) != rows:
        raise FileFormatError(path, "lines", f"{rows}, one for each image of {order}", str(len(table)))
    for k in np.flatnonzero(~np.all(np.isfinite(table), axis=1))[:1]:
        raise FileFormatError(path, f"light {k + 1}", "finite numbers", str(table[k].tolist()))
    return table
