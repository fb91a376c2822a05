"""The rows of a CSV file of numbers as spreadsheets leave them: semicolons or tabs between cells, decimal commas there,
quotes, rows and last columns of nothing, and cells that say that nothing was measured."""

import csv
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hshjax.io._text import COMMA, Lines
from hshjax.io.errors import FileFormatError

SEPARATORS = ",;\t"
NOTHING = ("", "nan", "na", "n/a", "#n/a", "#nv")
"""Cells that hold no measurement, in small letters: of numpy, R, and spreadsheets in English and German."""


class Rows(NamedTuple):
    """Rows that have all values: their line numbers and cells `(rows, columns)`; and how many had not."""

    numbers: list[int]
    table: np.ndarray
    unmeasured: int


def separator(line: str) -> str:
    """The one of `SEPARATORS` that stands most often in a line of names."""
    return max(SEPARATORS, key=line.count)


def read_rows(file: Lines, first: int, columns: int, trailing: int, values: Sequence[int], between: str) -> Rows:
    """The rows from line `first` on.

    - `columns`: cells in a row, and `trailing` empty ones after them. - `values`: columns in which a row may have no
      measurement; such rows are left out and counted. - `between`: the separator.

    **Raises:** FileFormatError, naming line and column, for everything else that is no number.
    """
    numbers = file.filled(first, "#")
    if between == "," and not trailing:
        try:
            return Rows(numbers, file.table(numbers, columns, between), 0)
        except FileFormatError:
            pass  # line by line, below, which takes longer
    kept, lines, unmeasured, blank = [], list(file.lines), 0, set(" \t" + between)
    for number in numbers:
        line = lines[number - 1]
        if set(line) <= blank:
            continue
        cells = _cells(line, between)
        if columns < len(cells) <= columns + trailing and not any(cells[columns:]):
            cells = cells[:columns]
        if len(cells) == columns and _unmeasured(cells, values):
            unmeasured += 1
            continue
        kept.append(number)
        lines[number - 1] = between.join(cells)
    if between != ",":
        _points(file, kept, lines, between)
    tidied = replace(file, lines=lines)
    return Rows(kept, tidied.table(kept, columns, between), unmeasured)


def _cells(line: str, between: str) -> list[str]:
    """The cells of a line, without quotes around them; a quoted cell that holds the separator keeps its quotes, and is
    no number."""
    if '"' not in line:
        return [cell.strip() for cell in line.split(between)]
    try:
        cells = next(csv.reader([line], delimiter=between, skipinitialspace=True, strict=True))
    except csv.Error:
        return line.split(between)
    return [f'"{cell}"' if between in cell else cell.strip() for cell in cells]


def _unmeasured(cells: Sequence[str], values: Sequence[int]) -> bool:
    return any(cells[k].lower() in NOTHING for k in values)


def _points(file: Lines, numbers: Sequence[int], lines: list[str], between: str) -> None:
    """Decimal commas become points.

    **Raises:** FileFormatError where some numbers of the file have commas and others points: one of the two may stand
    between thousands.
    """
    with_comma = with_point = 0
    for number in numbers:
        line = lines[number - 1]
        if "," in line and any(COMMA.fullmatch(cell) for cell in line.split(between)):
            with_comma = with_comma or number
            lines[number - 1] = line.replace(",", ".")
        if "." in line:
            with_point = with_point or number
        if with_comma and with_point:
            other = min(with_comma, with_point)
            raise file.error(number, f"decimal points or commas as in line {other}, not both", "the other")
