"""Any measured material: the reader is chosen by what the file holds, not by its name."""

import os
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from hshjax.brdfs import AngleTable, HalfVectorTable
from hshjax.brdfs._known import table_samples
from hshjax.io import alta, astm, csv_samples, fred, merl, rgl, utia, zemax
from hshjax.io._csv_rows import separator
from hshjax.io._sampling import sampling_rule
from hshjax.io._text import MARKS, head_lines
from hshjax.io.errors import FileFormatError
from hshjax.io.measured import Findings, Measured, Negatives
from hshjax.quadrature import PairRule
from hshjax.samples import Samples

HEAD = 8192
"""Bytes of a file that tell its format."""


class Format(NamedTuple):
    """A format by name: what it is in words; whether a file is of it, by its first bytes and its size; its reader."""

    words: str
    sniff: Callable[[bytes, int], bool]
    measured: Callable[..., Measured]


def _head(sniff: Callable[[bytes], bool]) -> Callable[[bytes, int], bool]:
    """The first bytes alone tell."""
    return lambda head, size: sniff(head)


FORMATS: dict[str, Format] = {
    "rgl": Format("RGL material (tensor_file)", _head(rgl.sniff), rgl.measured_rgl),
    "merl": Format("MERL binary", merl.sniff, merl.measured_merl),
    "alta": Format("ALTA text", _head(alta.sniff), alta.measured_alta),
    "fred": Format("FRED BSDF data", _head(fred.sniff), fred.measured_fred),
    "zemax": Format("Zemax tabular BSDF", _head(zemax.sniff), zemax.measured_zemax),
    "astm": Format("ASTM E1392 text", _head(astm.sniff), astm.measured_astm),
    "csv": Format("CSV with named columns", _head(csv_samples.sniff), csv_samples.measured_csv_samples),
    "utia": Format("UTIA binary", utia.sniff, utia.measured_utia),
}
"""The first one whose `sniff` agrees reads a file: formats with a mark of their own come first, the loosest last."""


def measured_format(path: str | PathLike) -> str:
    """The name in `FORMATS` of a file, by its first bytes.

    **Raises:** FileFormatError, which lists the formats that are known, where it is none of them; OSError.
    """
    with Path(path).open("rb") as file:
        head, size = file.read(HEAD), os.fstat(file.fileno()).st_size
    for name, one in FORMATS.items():
        if one.sniff(head, size):
            return name
    known = "; ".join(one.words for one in FORMATS.values())
    got = f"a file that begins with {head[:16]!r}" if head else "an empty file"
    raise FileFormatError(path, "first bytes", f"a measured material ({known})", got + _hint(head))


def _hint(head: bytes) -> str:
    """What to do with a file that holds measurements in no format that is known, as far as its first bytes tell."""
    for mark, name in MARKS.items():
        if head.startswith(mark):
            return f", text in {name} (save it again in UTF-8)"
    if head.startswith(b"PK\x03\x04"):
        return ", an archive or a workbook (save the sheet with the samples as CSV)"
    lines = [line for line in head_lines(head)[:-1] if line.strip() and not line.startswith("#")]
    if head.isascii() and any(len(line.split(separator(line))) > 2 for line in lines):
        columns = ", ".join(f"{name} [deg]" for name in csv_samples.ANGLES)
        return f" (a table of samples begins with names of columns: {columns}, then channels; comments begin with #)"
    return ""


def read_measured(path: str | PathLike, *, format: str | None = None, negatives: Negatives = "keep") -> Measured:
    """What a file of a measured material holds, samples or a table, and what its reader found.

    - `format`: a name in `FORMATS`; None: found by the first bytes.
    - `negatives`: "keep" them as measured, "clip" them to 0, or "mask" their samples.

    **Raises:** FileFormatError where no reader takes the file; ValueError for another format or treatment; OSError.
    """
    if format is not None and format not in FORMATS:
        raise ValueError(f"format must be one of {', '.join(FORMATS)}, got {format!r}")
    return FORMATS[measured_format(path) if format is None else format].measured(path, negatives=negatives)


def read_samples(
    path: str | PathLike, *, rule: PairRule | None = None, negatives: Negatives = "keep"
) -> tuple[Samples, Findings]:
    """The samples of any measured file, and what its reader found.

    A table is evaluated at the nodes of `rule`, weighted by solid angle; None: at its own nodes where these are pairs
    of directions (MERL, UTIA), else on an `isotropic_pair_rule` of degree 64, of anisotropic materials on a `pair_rule`
    of degree 16. Where nothing was measured the weight is 0. Scattered samples are as they were measured, and have no
    rule.

    **Raises:** as `read_measured`; ValueError for a rule given along with scattered samples.
    """
    data, found = read_measured(path, negatives=negatives)
    if not isinstance(data, Samples):
        if rule is None and isinstance(data, AngleTable | HalfVectorTable):
            return data.node_samples(), found
        if rule is None:
            rule = sampling_rule(data)
        return table_samples(data, rule), found
    if rule is not None:
        raise ValueError(
            f"{path}: scattered samples ({found.format}) lie where they were measured; a rule is for tables"
        )
    return data, found
