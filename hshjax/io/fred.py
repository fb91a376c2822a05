"""Tabulated BSDF data of FRED (Photon Engineering), as text.

The first line is `type bsdf_data`, the second `format angles=deg bsdf=value scale=1`. Then follow blocks: a line `θ φ`
of the *specular* direction, and lines `θ φ value` of scattered directions, all from the normal of the surface; a
negative θ lies across the normal, at φ + 180 degrees. `angles` is deg or sin, `bsdf` value or log, `scale` multiplies
the values. Sources: Photon Engineering's help on tabulated BSDFs (azimuths, and that the model is isotropic); its
application note on importing them, in the translation of its distributor infotek (the format, with an example).

What follows for azimuths: light comes from φ_specular + 180 degrees. The data at hand agree: of blocks `θ 0` the peak
lies at φ = 0, on the side of the specular direction.
"""

import os
import re

import numpy as np

from hshjax.io._directions import mirrored, one_azimuth, polar
from hshjax.io._text import LARGEST, Lines, head_lines, read_lines, shown
from hshjax.io.measured import Findings, Measured, Negatives, measured_samples
from hshjax.samples import Samples

TYPE = re.compile(r"type\s+bsdf_data\s*", re.IGNORECASE)
OPTIONS = {"angles": ("deg", "sin"), "bsdf": ("value", "log")}


def sniff(head: bytes) -> bool:
    """Whether these first bytes of a file begin one of FRED's."""
    return bool(TYPE.fullmatch(head_lines(head)[0]))


def read_fred(path: str | os.PathLike, *, negatives: Negatives = "keep") -> Samples:
    """The samples of a FRED file of BSDF data: see `measured_fred`."""
    data = measured_fred(path, negatives=negatives).data
    assert isinstance(data, Samples)
    return data


def measured_fred(path: str | os.PathLike, *, negatives: Negatives = "keep") -> Measured:
    """The samples of a FRED file of BSDF data [sr^-1, cosine not included], with what was found.

    Isotropic where all light comes from one azimuth. `bsdf=log` is taken as the decimal logarithm. `angles=sin` is read
    where every second column is 0, in the plane of incidence; elsewhere the file may hold direction cosines, or sines
    and azimuths, and is refused.

    **Raises:** FileFormatError, naming the line, for what `hshjax.io._text` refuses, another header, rows of other than
    two or three numbers, a specular direction without samples and angles above 180 degrees; OSError where the file
    cannot be opened.
    """
    file = read_lines(path)
    angles, logarithmic, scale = _format(file)
    numbers = file.filled(3)
    lengths = np.asarray([len(file.lines[number - 1].split()) for number in numbers], int)
    heads, rows = np.flatnonzero(lengths == 2), np.flatnonzero(lengths != 2)
    if not len(heads) or heads[0] != 0:
        number, got = (numbers[0], _line(file, numbers[0])) if numbers else (len(file.lines), "the end of the file")
        raise file.error(number, "theta and phi of a specular direction", got)
    row_numbers, head_numbers = [numbers[k] for k in rows], [numbers[k] for k in heads]
    specular = _directions(file, head_numbers, file.table(head_numbers, 2), angles)
    empty = np.flatnonzero(np.diff(np.append(heads, len(numbers))) == 1)
    if len(empty):
        raise file.error(head_numbers[empty[0]], "samples after a specular direction", "none")
    table = file.table(row_numbers, 3)
    wi = mirrored(specular)[np.searchsorted(heads, rows) - 1]
    wo = _directions(file, row_numbers, table[:, :2], angles)
    value = table[:, 2]
    notes = ["Light comes from the azimuth opposite to that of the specular direction."]
    if logarithmic:
        with np.errstate(over="ignore"):
            value = 10.0**value
        notes.append("Values are logarithms, taken as decimal ones.")
    value = scale * value
    wrong = ~(np.abs(value) <= LARGEST)
    if wrong.any():
        number = row_numbers[int(np.argmax(wrong))]
        raise file.error(number, "a finite number (of float32) once scaled", "a larger one", 3)
    if scale != 1:
        notes.append(f"Values are times {scale:g}, the scale of the file.")
    isotropic = one_azimuth(wi)
    if isotropic:
        notes.append("Light comes from one azimuth: taken for an isotropic material.")
    found = Findings("FRED BSDF text", "", ("value",), "sr^-1", 0, notes=tuple(notes))
    return measured_samples(path, wi, wo, value[:, None], found, negatives=negatives, isotropic=isotropic)


def _line(file: Lines, number: int) -> str:
    return shown(file.lines[number - 1])


def _format(file: Lines) -> tuple[str, bool, float]:
    """Of the two lines of the header: angles, whether values are logarithms, scale."""
    if not TYPE.fullmatch(file.lines[0]):
        raise file.error(1, "'type bsdf_data'", _line(file, 1))
    words = file.lines[1].split() if len(file.lines) > 1 else []
    example = "'format angles=deg bsdf=value scale=1'"
    if not words or words[0].lower() != "format":
        raise file.error(2, example, _line(file, 2) if words else "nothing")
    settings = [word.partition("=")[::2] for word in words[1:]]
    given = {name.lower(): value for name, value in settings}
    if sorted(name.lower() for name, _ in settings) != ["angles", "bsdf", "scale"]:
        raise file.error(2, f"{example}, each setting once", _line(file, 2))
    for name, allowed in OPTIONS.items():
        if given[name].lower() not in allowed:
            raise file.error(2, f"{name}={' or '.join(allowed)}", shown(given[name]))
    (scale,) = file.numbers(2, [given["scale"]])
    if not scale > 0:
        raise file.error(2, "a positive scale", shown(given["scale"]))
    return given["angles"].lower(), given["bsdf"].lower() == "log", float(scale)


def _directions(file: Lines, numbers: list[int], columns: np.ndarray, angles: str) -> np.ndarray:
    first, second = columns.T
    if angles == "deg":
        _require(file, numbers, np.abs(first) <= 180, "a polar angle of at most 180 degrees", 1)
        return polar(np.deg2rad(first), np.deg2rad(second))
    _require(
        file,
        numbers,
        second == 0,
        "0 under angles=sin (elsewhere it is ambiguous: an azimuth, or a second direction cosine)",
        2,
    )
    _require(file, numbers, np.abs(first) <= 1, "a sine", 1)
    return np.stack([first, second, np.sqrt(1 - first**2)], axis=-1)


def _require(file: Lines, numbers: list[int], holds: np.ndarray, expected: str, column: int) -> None:
    if not holds.all():
        number = numbers[int(np.argmin(holds))]
        raise file.error(number, expected, shown(file.lines[number - 1].split()[column - 1]), column)
