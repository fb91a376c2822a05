"""Tabular BSDF files of Zemax OpticStudio (Radiant Imaging's BSDF data interchange format), as text.

A header of keywords, each with a word or with a count and as many angles in degrees, then a section for each channel:

    Source Measured
    Symmetry PlaneSymmetrical
    SpectralContent Monochrome
    ScatterType BRDF
    SampleRotation 1
    0
    AngleOfIncidence 2
    10 30
    ScatterAzimuth 3
    0 90 180
    ScatterRadial 2
    0 5

    Monochrome
    DataBegin
    TIS 0.1
    (for every azimuth a row of values, one a radial angle)
    DataEnd

with a `TIS` line and a block of rows for every angle of incidence of every sample rotation. Lines that begin with `#`
are comments. Of `SpectralContent XYZ` there are three sections, TristimulusX, Y and Z. Case does not matter.

Scattered directions are given around the specular one: radial is the angle from it, azimuth 0 points from it towards
the normal, and azimuths increase counter-clockwise as seen from outside. With light at φ = 0 the specular direction is
s = (-sin θ, 0, cos θ) and wo = cos r s + sin r (cos a (cos θ, 0, sin θ) + sin a (0, 1, 0)). Source: Zemax knowledge
base, "BSDF data interchange file format specification" (R. Rykowski, 2008, and its later revision); libbsdf
(`SpecularCoordinateSystem`) agrees, and so do the values of a black coating that was published in this format and in
FRED's (University of Arizona, `ua-loft/bsdf-tools`).

Assumed, for the specification is a figure here: a sample rotation of R turns the sample counter-clockwise, so that in
its frame light comes from φ = -R.
"""

import os

import numpy as np

from hshjax.io._directions import polar
from hshjax.io._text import Lines, head_lines, read_lines, shown
from hshjax.io.errors import FileFormatError
from hshjax.io.measured import GRAZING, Findings, Measured, Negatives, measured_samples
from hshjax.samples import Samples

WORDS = {
    "source": None,
    "symmetry": ("planesymmetrical", "asymmetrical", "asymmetrical4d"),
    "spectralcontent": ("monochrome", "xyz"),
    "scattertype": ("brdf", "btdf"),
}
"""Keywords with a word, and which; any after Source."""

ANGLES = ("samplerotation", "angleofincidence", "scatterazimuth", "scatterradial")
SECTIONS = {"monochrome": ("monochrome",), "xyz": ("tristimulusx", "tristimulusy", "tristimulusz")}
CHANNELS = {"monochrome": ("value",), "xyz": ("X", "Y", "Z")}


def sniff(head: bytes) -> bool:
    """Whether these first bytes of a file begin a tabular BSDF of Zemax's."""
    lines = [line.split() for line in head_lines(head) if line.strip() and not line.startswith("#")]
    first = [line[0].lower() for line in lines[:4]]
    return bool(first) and first[0] in WORDS and any(word in (*WORDS, *ANGLES) for word in first[1:])


def read_zemax(path: str | os.PathLike, *, negatives: Negatives = "keep") -> Samples:
    """The samples of a tabular BSDF file of Zemax: see `measured_zemax`."""
    data = measured_zemax(path, negatives=negatives).data
    assert isinstance(data, Samples)
    return data


def measured_zemax(path: str | os.PathLike, *, negatives: Negatives = "keep") -> Measured:
    """The samples of a tabular BSDF file of Zemax [sr^-1, cosine not included], with what was found.

    Isotropic where there is one sample rotation. Of PlaneSymmetrical data the file has one side of the plane of
    incidence, and so have the samples. The specular direction, which the table repeats for every azimuth, is there once
    where its values agree. Values of exactly 0 are kept; programs write them, too, where nothing was measured, so that
    a note counts them.

    **Raises:** FileFormatError, naming the line, for what `hshjax.io._text` refuses, transmission (BTDF), keywords that
    are missing, twice or unknown, counts that do not fit, and angles out of their range; OSError where the file cannot
    be opened.
    """
    file = read_lines(path, closed_by="DataEnd")
    rest = _Rest(file)
    words, angles, section = _header(rest)
    spectral = words["spectralcontent"]
    rotation, incidence, azimuth, radial = (np.deg2rad(angles[name]) for name in ANGLES)
    shape = (len(rotation), len(incidence), len(azimuth), len(radial))
    channels = []
    for k, name in enumerate(SECTIONS[spectral]):
        section = rest.next(f"the section {name!r}") if k else section
        if section.lower() != name:
            raise rest.error(f"the section {name!r}", shown(section))
        channels.append(_section(rest, shape))
    rest.end()
    value = np.stack(channels, axis=-1)
    keep, repeated = _without_repetition(value, radial)
    rotation, incidence, azimuth, radial = (
        grid[keep] for grid in np.broadcast_arrays(*np.ix_(rotation, incidence, azimuth, radial))
    )
    wi, wo = _directions(rotation, incidence, azimuth, radial)
    value = value[keep]
    notes = _notes(words, len(angles["samplerotation"]), wo, value)
    found = Findings(
        "Zemax tabular BSDF", _material(file), CHANNELS[spectral], "sr^-1", 0, dropped=repeated, notes=tuple(notes)
    )
    return measured_samples(path, wi, wo, value, found, negatives=negatives, isotropic=shape[0] == 1)


class _Rest:
    """The lines that hold something, one after the other."""

    def __init__(self, file: Lines):
        self.file, self.numbers, self.number = file, iter(file.filled(comment="#")), 0

    def next(self, expected: str) -> str:
        """The next line, without blanks around it."""
        number = next(self.numbers, None)
        if number is None:
            raise self.file.error(len(self.file.lines), expected, "the end of the file")
        self.number = number
        return self.file.lines[number - 1].strip()

    def end(self) -> None:
        """That there is none."""
        for number in self.numbers:
            raise self.file.error(number, "the end of the file after DataEnd", shown(self.file.lines[number - 1]))

    def error(self, expected: str, got: str) -> FileFormatError:
        """The error for the line that was read last."""
        return self.file.error(self.number, expected, got)


def _header(rest: _Rest) -> tuple[dict[str, str], dict[str, np.ndarray], str]:
    """Words and angles [degrees] by keyword in lower case, and the line that ends the header."""
    words: dict[str, str] = {}
    angles: dict[str, np.ndarray] = {}
    while True:
        missing = [key for key in (*WORDS, *ANGLES) if key not in words and key not in angles]
        expected = f"the keyword {missing[0]!r}" if missing else "the data after the header"
        line = rest.next(expected)
        tokens = line.split()
        key = tokens[0].lower()
        if key not in WORDS and key not in ANGLES:
            if missing:
                raise rest.error(f"{expected} before the data", shown(line))
            return words, angles, line
        if key in words or key in angles:
            raise rest.error(f"{tokens[0]} once", "it again")
        if len(tokens) != 2:
            raise rest.error(f"{tokens[0]} and one word", shown(line))
        if key in WORDS:
            words[key] = _word(rest, key, tokens[1].lower())
        else:
            angles[key] = _angles(rest, key, rest.file.count(rest.number, tokens[1]))


def _word(rest: _Rest, key: str, word: str) -> str:
    allowed = WORDS[key]
    if allowed and word not in allowed:
        raise rest.error(f"{key!r} with {' or '.join(allowed)}", shown(word))
    if word == "btdf":
        raise rest.error("reflection (BRDF)", "transmission (BTDF), which is not supported")
    return word


def _angles(rest: _Rest, key: str, count: int) -> np.ndarray:
    """So many angles, on one line or more."""
    expected = f"{count} angles of {key!r}"
    found: list[float] = []
    while len(found) < count:
        line = rest.next(expected)
        tokens = line.split()
        if len(found) + len(tokens) > count or line[0].isalpha():
            raise rest.error(expected, shown(line))
        found += rest.file.numbers(rest.number, tokens).tolist()
    angles = np.asarray(found)
    low, high = {"angleofincidence": (0, 90), "scatterradial": (0, 180)}.get(key, (-360, 360))
    wrong = (angles < low) | (angles > high)
    if wrong.any():
        raise rest.error(f"angles of {key!r} in {low} ... {high} degrees", f"{angles[wrong][0]:g}")
    if np.any(np.diff(angles) <= 0):
        raise rest.error(f"increasing angles of {key!r}", "others")
    return angles


def _section(rest: _Rest, shape: tuple[int, int, int, int]) -> np.ndarray:
    """The values of one channel, rotations x incidences x azimuths x radial angles."""
    rotations, incidences, azimuths, radials = shape
    if (line := rest.next("'DataBegin'")).lower() != "databegin":
        raise rest.error("'DataBegin'", shown(line))
    rows: list[int] = []
    for block in range(rotations * incidences):
        expected = f"'TIS' and a number, before block {block + 1} of {rotations * incidences}"
        tokens = (line := rest.next(expected)).split()
        if len(tokens) != 2 or tokens[0].lower() != "tis":
            raise rest.error(expected, shown(line))
        rest.file.numbers(rest.number, tokens[1:])
        for _ in range(azimuths):
            # A word here is the next block, or the end: said as such, rather than as a wrong number.
            expected = f"{azimuths} rows in every block"
            if (line := rest.next(expected))[0].isalpha():
                raise rest.error(expected, f"{shown(line)} before")
            rows.append(rest.number)
    if (line := rest.next("'DataEnd'")).lower() != "dataend":
        raise rest.error("'DataEnd'", shown(line))
    return rest.file.table(rows, radials).reshape(shape)


def _without_repetition(value: np.ndarray, radial: np.ndarray) -> tuple[np.ndarray, dict[str, int]]:
    """Which entries to keep, and how many are the specular direction again: at radial 0 every azimuth is the same."""
    keep = np.ones(value.shape[:4], bool)
    if radial[0] == 0:
        same = np.all(value[:, :, :, 0] == value[:, :, :1, 0], axis=(2, 3))
        keep[:, :, 1:, 0] = ~same[:, :, None]
    repeated = int(np.sum(~keep))
    return keep, {"the specular direction again": repeated} if repeated else {}


def _directions(
    rotation: np.ndarray, incidence: np.ndarray, azimuth: np.ndarray, radial: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """wi, wo `(n, 3)` of angles in radians."""
    x, y, z = polar(radial, azimuth).T
    # Around the specular direction, light at φ = 0; then the turn of the sample.
    x, z = np.cos(incidence) * x - np.sin(incidence) * z, np.sin(incidence) * x + np.cos(incidence) * z
    c, s = np.cos(rotation), -np.sin(rotation)
    return polar(incidence, -rotation), np.stack([c * x - s * y, s * x + c * y, z], axis=-1)


def _notes(words: dict[str, str], rotations: int, wo: np.ndarray, value: np.ndarray) -> list[str]:
    notes = []
    if rotations == 1:
        notes.append("One sample rotation: taken for an isotropic material.")
    else:
        notes.append("A sample rotation of R is taken as light from the azimuth -R.")
    if words["symmetry"] == "planesymmetrical":
        notes.append("PlaneSymmetrical: samples are on one side of the plane of incidence, as in the file.")
    black = int(np.sum(np.all(value == 0, axis=1) & (wo[:, 2] > GRAZING)))
    if black:
        notes.append(f"{black} entries above the horizon are exactly 0: measured, or not measured; they are kept.")
    return notes


def _material(file: Lines) -> str:
    """What a comment in the header calls the sample."""
    for line in file.lines:
        if line.strip() and not line.startswith("#"):
            return ""
        name, colon, words = line.lstrip("# \t").partition(":")
        if colon and name.strip().lower() in ("sample", "sample name", "name", "material"):
            return words.strip()
    return ""
