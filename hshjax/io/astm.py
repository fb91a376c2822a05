"""ASTM files of scattered BRDF data (ASTM E1392-96, E2387), in the form that Cornell's measurements have.

A header of lines `KEYWORD value`, with words in quotes or not, whose last line is `VARS` and the names of the columns;
then a line of numbers with commas between them for each sample:

    NUM_POINTS 1439
    VARS theta_i,phi_i,theta_s,phi_s,R,G,B
    0.5,0,0.3,3.1,0.1,0.2,0.3

`NUM_POINTS` counts the samples. theta_s and phi_s are the scattered direction, also called theta_r and phi_r; without
phi_i it is 0. All other columns are values: R,G,B, X,Y,Z, wavelengths as 400nm, or one, "Integrated ...". Sources: the
readers of ALTA (`plugins/data_io/astm.cpp`) and libbsdf (`AstmReader`), both for Cornell's files, which the standards'
own text, not public, was not compared with. Both read radians; both directions point away from the surface, from one
axis of azimuth, so that mirror pairs have phi_s - phi_i = pi.
"""

import os
import re
from typing import Literal

from hshjax.io._columns import SIDES, Angles, angle_columns, from_angles, refuse_misspelt
from hshjax.io._directions import one_azimuth
from hshjax.io._text import Lines, head_lines, read_lines, shown
from hshjax.io.measured import Findings, Measured, Negatives, measured_samples
from hshjax.samples import Samples

VARS = re.compile(r"VARS\s+(.*)", re.IGNORECASE)
ANGLE_NAMES = tuple(f"{angle}_{side}" for angle in ("theta", "phi") for side in SIDES)
MATERIAL = ("SAMPLE", "SAMPLE_NAME", "SAMPLE_DESCRIPTION", "MATERIAL", "NAME", "TITLE", "DESCRIPTION")
"""Keywords whose words are the material, in this order."""

HEADER = 10_000
"""Lines, in which VARS is looked for."""


def sniff(head: bytes) -> bool:
    """Whether these first bytes of a file hold the VARS line of an ASTM file."""
    return any((match := VARS.match(line)) and "theta_i" in match[1].lower() for line in head_lines(head))


def read_astm(
    path: str | os.PathLike, *, negatives: Negatives = "keep", angles: Literal["rad", "deg"] = "rad"
) -> Samples:
    """The samples of an ASTM file: see `measured_astm`."""
    data = measured_astm(path, negatives=negatives, angles=angles).data
    assert isinstance(data, Samples)
    return data


def measured_astm(
    path: str | os.PathLike, *, negatives: Negatives = "keep", angles: Literal["rad", "deg"] = "rad"
) -> Measured:
    """The samples of an ASTM file [sr^-1, cosine not included], with what was found.

    - `angles`: the unit of columns that do not state theirs, as `theta_i[deg]` would.

    Isotropic where all light comes from one azimuth.

    **Raises:** FileFormatError, naming the line, for what `hshjax.io._text` refuses, a header without VARS or the
    angles, another number of samples than NUM_POINTS, and polar angles above π; OSError where the file cannot be
    opened.
    """
    if angles not in ("rad", "deg"):
        raise ValueError(f"angles is rad or deg, got {angles!r}")
    file = read_lines(path)
    header, number, names = _header(file)
    columns = _angles(file, number, names)
    values = [k for k, _ in enumerate(names) if k not in {column for column, _ in columns.values()}]
    if not values:
        raise file.error(number, "a column of values beside the angles", "none")
    numbers = file.filled(number + 1)
    table = file.table(numbers, len(names), ",")
    notes = []
    if "NUM_POINTS" in header:
        line, words = header["NUM_POINTS"]
        count = file.count(line, words, least=0)
        if count != len(table):
            raise file.error(line, f"{len(table)} samples, as follow", f"NUM_POINTS {count}")
    else:
        notes.append("No NUM_POINTS: whether lines are missing at the end cannot be told.")
    if not len(table):
        raise file.error(len(file.lines), "samples after the header", "none")
    if any(unit is None for _, unit in columns.values()):
        notes.append(f"Units of angles are not declared: taken as {'radians' if angles == 'rad' else 'degrees'}.")
    if "phi_i" not in columns:
        notes.append("No column phi_i: light comes from the azimuth 0.")
    wi = from_angles(file, numbers, table, columns, "i", angles)
    wo = from_angles(file, numbers, table, columns, "o", angles)
    isotropic = one_azimuth(wi)
    if isotropic:
        notes.append("Light comes from one azimuth: taken for an isotropic material.")
    channels = tuple(re.sub(r"(\d)\s*nm$", r"\1 nm", names[k]) for k in values)
    material = next((header[key][1] for key in MATERIAL if key in header), "")
    found = Findings("ASTM BRDF text", material, channels, "not declared: taken as sr^-1", 0, notes=tuple(notes))
    return measured_samples(path, wi, wo, table[:, values], found, negatives=negatives, isotropic=isotropic)


def _header(file: Lines) -> tuple[dict[str, tuple[int, str]], int, list[str]]:
    """Line number and words of every keyword, the number of the line with the names, and these."""
    header: dict[str, tuple[int, str]] = {}
    for number, line in enumerate(file.lines[:HEADER], 1):
        if match := VARS.match(line):
            names = [name.strip().strip('"') for name in match[1].split(",")]
            if not all(names) or len(set(names)) != len(names):
                raise file.error(number, "names of columns, all different", shown(match[1]))
            return header, number, names
        if not line.strip():
            continue
        key, _, words = line.partition(" ")
        key = key.strip().strip('":').upper()
        refuse_misspelt(file, number, key, ("NUM_POINTS", "VARS"))
        if key == "NUM_POINTS" and key in header:
            raise file.error(number, "NUM_POINTS once", f"again, after line {header[key][0]}")
        header.setdefault(key, (number, words.strip().strip('"')))
    expected = "a header that ends with VARS and the names of the columns"
    raise file.error(min(HEADER, len(file.lines)), expected, "no such line")


def _angles(file: Lines, number: int, names: list[str]) -> Angles:
    columns = angle_columns(file, number, names)
    taken = {column for column, _ in columns.values()}
    for k, name in enumerate(names):
        if k not in taken:
            refuse_misspelt(file, number, name, ANGLE_NAMES)
    for key, usual in (("theta_i", "theta_i"), ("theta_o", "theta_s"), ("phi_o", "phi_s")):
        if key not in columns:
            raise file.error(number, f"a column {usual}", shown(",".join(names)))
    return columns
