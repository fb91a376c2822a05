"""Folders of photographs with a light file (.lp), as tools for reflectance transformation imaging and domes write them.

A light file has the number of images in its first line and then a line for each, `name x y z`: the name of the image,
which may contain blanks, and a vector towards the light, x to the right, y up and z towards the viewer. Source:
Cultural Heritage Imaging, RTIBuilder user guide.
"""

from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io._images import SUFFIXES, orientation, read_image, read_mask
from hshjax.io._photographs import Encoding, Saturated, assemble, check_options, make_lights
from hshjax.io.errors import FileFormatError
from hshjax.photographs import Photographs

MASK = "mask.png"


def is_light_file(path: str | PathLike) -> bool:
    """Whether it is named as one and is a file."""
    return Path(path).suffix.lower() == ".lp" and Path(path).is_file()


def read_light_positions(path: str | PathLike) -> tuple[tuple[str, ...], np.ndarray]:
    """Names of images, without the folders that may stand before them, and vectors `(lights, 3)` as in the file.

    **Raises:** FileFormatError, naming the line, for another count, names twice, anything but three finite numbers, and
    the zero vector; OSError where the file cannot be opened.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise FileFormatError(path, f"byte {error.start}", "text in UTF-8", "other bytes") from error
    numbered = [(number, line.strip()) for number, line in enumerate(lines, 1) if line.strip()]
    if not numbered or not numbered[0][1].isdecimal():
        raise FileFormatError(path, "line 1", "the number of lights", repr(numbered[0][1]) if numbered else "nothing")
    count = int(numbered[0][1])
    if count < 1 or len(numbered) - 1 != count:
        raise FileFormatError(path, "lines", f"{max(count, 1)} after the first, which says so", str(len(numbered) - 1))
    names, vectors = [], []
    for number, line in numbered[1:]:
        name, *words = line.rsplit(maxsplit=3)
        vector = _numbers(words)
        if len(vector) != 3 or not np.all(np.isfinite(vector)) or not any(vector):
            expected = "a name and three finite numbers that are not all zero"
            raise FileFormatError(path, f"line {number}", expected, repr(line))
        name = name.strip('"').replace("\\", "/").rsplit("/", 1)[-1]
        if name in names:
            raise FileFormatError(path, f"line {number}", "a name that no other line has", repr(name))
        names.append(name)
        vectors.append(vector)
    return tuple(names), np.asarray(vectors)


def read_photograph_folder(
    folder: str | PathLike,
    *,
    encoding: Encoding = "linear",
    saturated: Saturated = "drop",
    near: float | None = None,
) -> Photographs:
    """Photographs of a folder of PNG, JPEG or OpenEXR images with one light file `*.lp`, in the order of that.

    `folder` may also be the light file: of several in its folder that one.

    Without a light file `lights` is None, and images are in the order of their names. `mask.png`, where there is one,
    says which pixels see the object (those above half of its largest value); else all do.

    - `encoding`: of 8- and 16-bit values, "linear" in light or "srgb". No file says so reliably: what cameras write as
      JPEG is close to sRGB, what is developed from raw files for measurement is linear.
    - `saturated`: values at the top of the file's range become NaN ("drop") or stay ("keep").
    - `near`: None for lights far away. A number for lights nearby: what the file's vectors are to be multiplied with to
      be positions in the unit of the scene, whose origin is that of the file: the radius of a dome of a unit sphere.

    Irradiances (intensities of lights nearby) are 1: the file does not tell them.

    **Raises:** FileFormatError where light file and images disagree, images differ in size or type, or a file is
    damaged; OSError where a file cannot be opened; ImportError without the extra `photographs`.
    """
    check_options(saturated, encoding)
    light_file, folder = (Path(folder), Path(folder).parent) if is_light_file(folder) else (None, Path(folder))
    images = {
        path.name: path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in SUFFIXES and path.name != MASK and not path.name.startswith(".")
    }
    light_files = [light_file] if light_file else sorted(path for path in folder.iterdir() if is_light_file(path))
    if len(light_files) > 1:
        raise FileFormatError(folder, "light files (*.lp)", "one", ", ".join(path.name for path in light_files))
    if not images:
        raise FileFormatError(folder, "images", f"at least one of {', '.join(SUFFIXES)}", "none")
    lights, names, notes = None, tuple(images), ["No light file (*.lp): nothing is known of the lights."]
    if light_files:
        names, vectors = read_light_positions(light_files[0])
        for k, name in enumerate(names, 1):
            if name not in images:
                raise FileFormatError(light_files[0], f"light {k}", f"an image in {folder}", f"{name!r}, not there")
        lights, notes = make_lights(light_files[0], vectors, near=near)
        notes.insert(0, f"Light file {light_files[0].name}: {len(names)} lights.")
        others = [name for name in images if name not in names]
        if others:
            notes.append(f"{len(others)} images are not in the light file and are left out: {', '.join(others[:3])}.")
    elif near is not None:
        raise FileFormatError(folder, "light files (*.lp)", "one, with the positions of lights nearby", "none")
    mask_file = folder / MASK
    mask = read_mask(mask_file) if mask_file.exists() else None
    if mask is None:
        notes.append(f"No {MASK}: every pixel is taken to see the object.")
    turned = [name for name in names if orientation(images[name]) != 1]
    if turned:
        # A camera that looks down does not know how it is held: what EXIF says there is often chance.
        notes.append(f"EXIF asks for {len(turned)} images to be turned ({', '.join(turned[:3])}): they are as stored.")
    return assemble(
        ((images[name], read_image(images[name])) for name in names),
        len(names),
        lights=lights,
        mask=mask,
        mask_file=mask_file,
        saturated=saturated,
        encoding=encoding,
        notes=notes,
    )


def _numbers(words: list[str]) -> list[float]:
    """The words as numbers; none where one is not."""
    try:
        return [float(word) for word in words]
    except ValueError:
        return []
