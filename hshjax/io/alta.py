"""Text files of ALTA (Belcour, Barla, Pacanowski: "ALTA, a BRDF analysis library"), scattered measurements.

Header lines `#KEY value`, then one sample a line: coordinates of the pair of directions, then values, then confidence
intervals where `#VS` announces them. `#DIM in out` counts coordinates and values, `#PARAM_IN` names the coordinates
(`hshjax.io._alta_parameters`), `#PARAM_OUT` the values. Lines that begin with `#` and a blank are comments. Source:
ALTA's `core/args.h` (header), `core/data_storage.cpp` (rows), `core/params.h`, `core/params.cpp` (parametrisations).
"""

import os
import re

import numpy as np

from hshjax.io._alta_parameters import AMBIGUOUS, PARAMETRISATIONS, Parametrisation
from hshjax.io._columns import refuse_misspelt
from hshjax.io._text import Lines, head_lines, read_lines, shown
from hshjax.io.measured import Findings, Measured, Negatives, measured_samples
from hshjax.samples import Samples

KEYS = ("DIM", "PARAM_IN", "PARAM_OUT", "VS", "FORMAT", "SAMPLE_COUNT")
"""Of a header, those that say how to read the rows; others are words about the measurement."""

OUTPUTS = {
    "INV_STERADIAN": (None, "sr^-1"),
    "INV_STERADIAN_COSINE_FACTOR": (None, "sr^-1, times the cosine of the outgoing direction"),
    "RGB_COLOR": (("R", "G", "B"), "RGB_COLOR: taken as sr^-1"),
    "XYZ_COLOR": (("X", "Y", "Z"), "XYZ_COLOR: taken as sr^-1"),
    "UNKNOWN_OUTPUT": (None, "not declared: taken as sr^-1"),
}
"""Channels, where the name tells them, and units of each kind of value. ENERGY is no BRDF."""

WITHIN = re.compile(rf"#(?:{'|'.join(KEYS)})\b")
START = re.compile(r"#(DIM\s+\d+\s+\d+|PARAM_IN\s+\w+|ALTA HEADER BEGIN)\s*$")


def sniff(head: bytes) -> bool:
    """Whether these first bytes of a file begin a header of ALTA's."""
    for line in head_lines(head):
        if line.strip() and not line.startswith("#"):
            return False
        if START.match(line):
            return True
    return False


def read_alta(path: str | os.PathLike, *, negatives: Negatives = "keep") -> Samples:
    """The samples of an ALTA text file: see `measured_alta`."""
    data = measured_alta(path, negatives=negatives).data
    assert isinstance(data, Samples)
    return data


def measured_alta(path: str | os.PathLike, *, negatives: Negatives = "keep") -> Measured:
    """The samples of an ALTA text file, cosine not included, with what was found.

    Values of `INV_STERADIAN_COSINE_FACTOR` are divided by cos θ_o; values of a file that does not name them are taken
    as sr^-1. Coordinates that leave the pair of directions open stand for one pair, named in the notes; those that do
    not exist (a half vector longer than 1) are dropped and counted. Confidence intervals are checked and left out.
    Isotropic parametrisations give isotropic samples; where their pairs lie in azimuth means nothing.

    **Raises:** FileFormatError, naming the line, for what `hshjax.io._text` refuses, a header that is not complete,
    names that are ambiguous or unknown, angles above π, cosines above 1 and vectors that are not unit; OSError where
    the file cannot be opened.
    """
    file = read_lines(path)
    header, first = _header(file)
    parameters, name = _parameters(file, header)
    inputs, outputs = _dimensions(file, header, parameters, name)
    output = _output(file, header, outputs)
    notes = [parameters.note] if parameters.note else []
    extra = _intervals(file, header, outputs)
    if extra:
        notes.append(f"Confidence intervals (#VS, {extra} columns) were read past.")
    numbers = file.filled(first, comment="#")
    _refuse_late_keys(file, first)
    table = file.table(numbers, inputs + outputs + extra)
    if "SAMPLE_COUNT" in header:
        number, words = header["SAMPLE_COUNT"]
        count = file.count(number, words, least=0)
        if count != len(table):
            raise file.error(number, f"{len(table)} samples, as follow", str(count))
    if not len(table):
        raise file.error(len(file.lines), "samples after the header", "none")
    channels, units = OUTPUTS[output]
    if channels is None:
        channels = ("value",) if outputs == 1 else tuple(f"value {k}" for k in range(1, outputs + 1))
    coordinates, value = table[:, :inputs], table[:, inputs : inputs + outputs]
    coordinates = _checked(file, numbers, coordinates, parameters)
    wi, wo = parameters.pair(coordinates)
    exists = np.all(np.isfinite(wi) & np.isfinite(wo), axis=1)
    dropped = {} if exists.all() else {"coordinates of no pair of directions": int(np.sum(~exists))}
    found = Findings(
        f"ALTA text, {name}", _words(header, "SAMPLE"), channels, units, 0, dropped=dropped, notes=tuple(notes)
    )
    return measured_samples(
        path,
        wi[exists],
        wo[exists],
        value[exists],
        found,
        negatives=negatives,
        cosine_included=output == "INV_STERADIAN_COSINE_FACTOR",
        isotropic=parameters.isotropic,
    )


Header = dict[str, tuple[int, str]]
"""Line number and words of every key."""


def _header(file: Lines) -> tuple[Header, int]:
    """The keys, and the number of the first line after the header."""
    header: Header = {}
    number = 0
    for number, line in enumerate(file.lines, 1):
        if line.strip() and not line.startswith("#"):
            return header, number
        if late := WITHIN.search(line, 1):
            raise file.error(number, f"{late[0]} at the beginning of a line", shown(line))
        if not (match := re.match(r"#(\S+)\s*(.*)", line)):
            continue
        key, words = match[1], match[2].strip()
        if key == "ALTA":
            if words == "HEADER END":
                return header, number + 1
            continue
        if key in KEYS and key in header:
            raise file.error(number, f"#{key} once", f"again, after line {header[key][0]}")
        # `#PARAM_OUTT`, passed over as words about the measurement, would change what the values mean.
        refuse_misspelt(file, number, key, KEYS)
        if key not in KEYS and key.startswith(KEYS):
            raise file.error(number, "a blank after the keyword", shown(line))
        header.setdefault(key, (number, words))
    return header, number + 1


def _refuse_late_keys(file: Lines, first: int) -> None:
    """Two files in one, or rows that a broken line has made into a header."""
    for number, line in enumerate(file.lines[first - 1 :], first):
        if line.startswith("#") and (match := re.match(r"#(\w+)", line)) and match[1] in (*KEYS, "ALTA"):
            raise file.error(number, "no header after the first sample", shown(line))


def _parameters(file: Lines, header: Header) -> tuple[Parametrisation, str]:
    if "FORMAT" in header and header["FORMAT"][1].lower() != "text":
        number, words = header["FORMAT"]
        raise file.error(number, "text (convert with ALTA's data2data)", f"#FORMAT {words}")
    if "PARAM_IN" not in header:
        raise file.error(1, "a header with #PARAM_IN", "none")
    number, name = header["PARAM_IN"]
    if name in AMBIGUOUS:
        raise file.error(number, "coordinates that determine directions", f"{name}: {AMBIGUOUS[name]}")
    if name not in PARAMETRISATIONS:
        raise file.error(number, f"one of {', '.join(PARAMETRISATIONS)}", shown(name))
    return PARAMETRISATIONS[name], name


def _dimensions(file: Lines, header: Header, parameters: Parametrisation, name: str) -> tuple[int, int]:
    if "DIM" not in header:
        raise file.error(1, "a header with #DIM", "none")
    number, words = header["DIM"]
    tokens = words.split()
    if len(tokens) != 2:
        raise file.error(number, "two counts, of coordinates and values", shown(words))
    inputs, outputs = (file.count(number, token) for token in tokens)
    if inputs != parameters.columns:
        raise file.error(number, f"{parameters.columns} coordinates, as {name} has", str(inputs))
    return inputs, outputs


def _output(file: Lines, header: Header, outputs: int) -> str:
    """What the values are: a name of OUTPUTS."""
    number, name = header.get("PARAM_OUT", (header["DIM"][0], "UNKNOWN_OUTPUT"))
    if name not in OUTPUTS:
        raise file.error(number, f"values of a BRDF: one of {', '.join(OUTPUTS)}", shown(name))
    channels, _ = OUTPUTS[name]
    if channels is not None and len(channels) != outputs:
        raise file.error(header["DIM"][0], f"{len(channels)} values, as {name} has", str(outputs))
    return name


def _intervals(file: Lines, header: Header, outputs: int) -> int:
    """How many columns follow the values: 1 of a symmetric interval, 2 of another, for the first value only.

    Older versions of ALTA meant them for every value. Where there are several, columns may be interleaved or not:
    refused.
    """
    number, words = header.get("VS", (0, "0"))
    if words not in ("0", "1", "2"):
        raise file.error(number, "#VS 0, 1 or 2", shown(words))
    if words != "0" and outputs > 1:
        raise file.error(
            number,
            "no confidence intervals beside several values",
            f"#VS {words}: ambiguous, whether they follow each value or all",
        )
    return int(words)


def _checked(file: Lines, numbers: list[int], x: np.ndarray, parameters: Parametrisation) -> np.ndarray:
    """The coordinates, with rounding taken out of cosines and unit vectors."""
    x = x.copy()
    for column in parameters.cosines:
        _require(file, numbers, np.abs(x[:, column]) <= 1 + 1e-6, x[:, column], "a cosine", column)
        x[:, column] = np.clip(x[:, column], -1, 1)
    for columns in parameters.angles:
        angle = np.hypot(*x[:, columns].T) if isinstance(columns, tuple) else np.abs(x[:, columns])
        expected = "a polar angle of at most pi radians (are these degrees?)"
        column = columns[0] if isinstance(columns, tuple) else columns
        _require(file, numbers, angle <= np.pi + 1e-6, angle, expected, column)
    for column in parameters.vectors:
        vector = x[:, column : column + 3]
        norm = np.linalg.norm(vector, axis=1)
        _require(file, numbers, np.abs(norm - 1) <= 1e-3, norm, "a vector of length 1", column)
        x[:, column : column + 3] = vector / norm[:, None]
    return x


def _require(file: Lines, numbers: list[int], holds: np.ndarray, got: np.ndarray, expected: str, column: int) -> None:
    if not holds.all():
        row = int(np.argmin(holds))
        raise file.error(numbers[row], expected, f"{got[row]:.6g}", column + 1)


def _words(header: Header, key: str) -> str:
    return header.get(key, (0, ""))[1].strip('"')
