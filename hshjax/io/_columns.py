"""Named columns of angles: what a header says of one, and the directions that they make."""

import difflib
import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from hshjax.io._directions import polar
from hshjax.io._text import Lines, shown

ANGLE = re.compile(
    r"(?P<angle>theta|phi)_(?P<side>[iosr])\s*[_\[(]?\s*(?P<unit>deg|degrees?|°|rad|radians?)?\s*[\])]?", re.IGNORECASE
)
SIDES = {"i": "i", "o": "o", "s": "o", "r": "o"}
"""Incident; outgoing, also called scattered or reflected."""

Angles = dict[str, tuple[int, str | None]]
"""By name, theta_i, phi_i, theta_o, phi_o: the column (from 0); and its unit, deg, rad or None where it says none."""


def angle_columns(file: Lines, number: int, names: Sequence[str]) -> Angles:
    """The columns of angles among the names that stand in a line.

    **Raises:** FileFormatError for one that is there twice, or looks like one but is none.
    """
    found: Angles = {}
    for column, name in enumerate(names):
        match = ANGLE.fullmatch(name)
        if match:
            key = f"{match['angle'].lower()}_{SIDES[match['side'].lower()]}"
            if key in found:
                raise file.error(number, f"one column of {key}", f"{shown(name)}, too", column + 1)
            unit = match["unit"]
            found[key] = column, None if unit is None else "rad" if unit.lower().startswith("rad") else "deg"
    return found


@lru_cache(1024)
def misspelt(name: str, known: tuple[str, ...]) -> str | None:
    """The name among `known` that this one looks like and is not, if there is one."""
    if name in known or len(name) > 40:
        return None
    by_case = {word.lower(): word for word in known}
    near = difflib.get_close_matches(name.lower(), by_case, n=1, cutoff=0.75)
    return by_case[near[0]] if near else None


def refuse_misspelt(file: Lines, number: int, name: str, known: tuple[str, ...], column: int | None = None) -> None:
    """A name that is passed over, or read as a channel, but looks like one that means something.

    **Raises:** FileFormatError.
    """
    near = misspelt(name, known)
    if near:
        raise file.error(number, f"{near!r}, or a name that does not look like it", shown(name), column)


def from_angles(
    file: Lines, numbers: Sequence[int], table: np.ndarray, angles: Angles, side: str, unit: str
) -> np.ndarray:
    """Directions `(n, 3)` of one side, i or o, from the rows of a table; `unit` where a column does not say.

    A column of azimuths that is not there is 0.

    **Raises:** FileFormatError for a polar angle above 180 degrees.
    """
    column, own = angles[f"theta_{side}"]
    theta = _radians(table[:, column], own or unit)
    wrong = np.abs(theta) > np.pi * (1 + 1e-6)
    if wrong.any():
        row = int(np.argmax(wrong))
        limit, other = ("180 degrees", "") if (own or unit) == "deg" else ("pi radians", " (are these degrees?)")
        raise file.error(
            numbers[row], f"a polar angle of at most {limit}{other}", f"{table[row, column]:g}", column + 1
        )
    if f"phi_{side}" not in angles:
        return polar(theta, 0.0)
    column, own = angles[f"phi_{side}"]
    return polar(theta, _radians(table[:, column], own or unit))


def _radians(angle: np.ndarray, unit: str) -> np.ndarray:
    return np.deg2rad(angle) if unit == "deg" else angle
