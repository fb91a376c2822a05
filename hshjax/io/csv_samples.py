"""Scattered samples as comma-separated values with named columns: read from anywhere, and written.

    # material: red cloth
    # isotropic: false
    theta_i [deg],phi_i [deg],theta_o [deg],phi_o [deg],R,G,B
    30,0,45,180,0.12,0.08,0.06

The first line that does not begin with `#` names the columns, in any order. Directions are four columns of angles,
theta_i, phi_i, theta_o, phi_o, each with its unit, as `theta_i [deg]`, `theta_i (rad)` or `theta_i_deg`; or six columns
of unit vectors, wi_x, wi_y, wi_z, wo_x, wo_y, wo_z. Both directions point away from the surface, azimuths are from one
axis. `weight`, where it is there, is the weight of the sample. Every other column is a channel of the BRDF [sr^-1].

Lines `# key: value` before the names may say more: material, isotropic (true or false), units (sr^-1) and
cosine_included (true or false). Others are comments.

Spreadsheets are met halfway: cells may have semicolons or tabs between them, and then decimal commas; `sep=;` may stand
first; numbers may be quoted; rows and last columns may be empty. A row with a value that is empty, nan or NA was not
measured: it is left out and counted.
"""

import csv
import os
import re
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from hshjax.io._columns import ANGLE, Angles, angle_columns, from_angles, misspelt, refuse_misspelt
from hshjax.io._csv_rows import Rows, read_rows, separator
from hshjax.io._directions import one_azimuth
from hshjax.io._replace import replacing
from hshjax.io._text import Lines, head_lines, read_lines, shown
from hshjax.io.measured import GRAZING, Findings, Measured, Negatives, measured_samples
from hshjax.samples import Samples

ANGLES = ("theta_i", "phi_i", "theta_o", "phi_o")
VECTORS = {side: tuple(f"w{side}_{axis}" for axis in "xyz") for side in "io"}
WEIGHT = "weight"
KNOWN = (*ANGLES, *VECTORS["i"], *VECTORS["o"], WEIGHT)
KEYS = ("material", "isotropic", "units", "cosine_included")
STRICT = ("isotropic", "units", "cosine_included")
"""Of these, the ones that say what the values mean."""

UNMEASURED = "a value that was not measured"
UNITS = ("sr^-1", "1/sr", "sr-1")
KEY = re.compile(r"#\s*(\w+)\s*:\s*(.*)")
WITHIN = re.compile(rf"#\s*(?:{'|'.join(STRICT)})\s*:", re.IGNORECASE)
SEPARATOR = re.compile(r'"?sep=[,;\t]"?')
"""The first line of a file that a spreadsheet is to split so: the names tell it, too."""

Directions = Literal["vectors", "deg", "rad"]


def sniff(head: bytes) -> bool:
    """Whether these first bytes of a file name columns of directions."""
    for line in head_lines(head):
        if line.strip() and not line.startswith("#") and not SEPARATOR.fullmatch(line):
            names = [name.strip().strip('"').lower() for name in line.split(separator(line))]
            angles = {name[:7] for name in names}
            return len(names) > 1 and (
                ("theta_i" in angles and not angles.isdisjoint(("theta_o", "theta_r", "theta_s")))
                or all(name in names for name in (VECTORS["i"][0], VECTORS["o"][0]))
            )
    return False


def read_csv_samples(path: str | os.PathLike, *, negatives: Negatives = "keep") -> Samples:
    """The samples of a file of comma-separated values: see `measured_csv_samples`."""
    data = measured_csv_samples(path, negatives=negatives).data
    assert isinstance(data, Samples)
    return data


def measured_csv_samples(path: str | os.PathLike, *, negatives: Negatives = "keep") -> Measured:
    """The samples of a file of comma-separated values, as the module describes it, with what was found.

    Where the file does not say whether it is isotropic, it is if all light comes from one azimuth.

    **Raises:** FileFormatError, naming line and column, for what `hshjax.io._text` refuses; other separators; angles
    without a unit; columns that are missing, there twice, or misspelt; angles above 180 degrees, vectors that are not
    unit, negative weights. OSError where the file cannot be opened.
    """
    file = read_lines(path)
    said, number = _comments(file)
    names, rows = _rows(file, number)
    numbers, table = rows.numbers, rows.table
    wi, wo, used = _directions(file, number, numbers, names, table)
    weight = None
    if WEIGHT in names:
        column = names.index(WEIGHT)
        weight = table[:, column]
        used.add(column)
        if np.any(weight < 0):
            row = int(np.argmax(weight < 0))
            raise file.error(numbers[row], "a weight of at least 0", f"{weight[row]:g}", column + 1)
    values = [k for k in range(len(names)) if k not in used]
    for k in values:
        refuse_misspelt(file, number, names[k], KNOWN, k + 1)
    if not values:
        raise file.error(number, "a column of values beside the directions", "none")
    notes = []
    isotropic = _truth(file, said, "isotropic", one_azimuth(wi))
    if isotropic and "isotropic" not in said:
        notes.append("Light comes from one azimuth: taken for an isotropic material.")
    if _seem_radians(angle_columns(file, number, names), table):
        notes.append("No angle to the normal is above 1.58 degrees: are these radians?")
    masked = {} if weight is None or weight.all() else {"a weight of 0": int(np.sum(weight == 0))}
    found = Findings(
        "samples in CSV",
        said.get("material", (0, ""))[1],
        tuple(names[k] for k in values),
        _units(file, said),
        0,
        dropped={UNMEASURED: rows.unmeasured} if rows.unmeasured else {},
        masked=masked,
        notes=tuple(notes),
    )
    return measured_samples(
        path,
        wi,
        wo,
        table[:, values],
        found,
        negatives=negatives,
        cosine_included=_truth(file, said, "cosine_included", False),
        isotropic=isotropic,
        weight=weight,
    )


def write_csv_samples(
    path: str | os.PathLike,
    samples: Samples,
    channel_names: Sequence[str] | None = None,
    *,
    directions: Directions = "vectors",
    material: str = "",
) -> None:
    """Samples as a file that `read_csv_samples` reads.

    - `channel_names`: one a channel; without them "value", or "value 1" and so on.
    - `directions`: as unit vectors, which come back exactly, as do values and weights; or as angles in degrees or
      radians, from which directions come back to 1e-15. The degree of a rule of quadrature is not kept.

    **Raises:** ValueError for names that are not as many as channels, are not different, or mean something else to the
    reader; for values that are not finite and directions on or below the horizon, which it would refuse or drop (take
    `samples.cleared()` where they are masked); OSError where the file cannot be written.
    """
    if directions not in get_args(Directions):
        raise ValueError(f"directions is one of {', '.join(get_args(Directions))}, got {directions!r}")
    names = _checked_names(channel_names, samples.channels)
    if "\n" in material or "\r" in material or material != material.strip():
        raise ValueError(f"the material is one line without blanks around it, got {material!r}")
    columns = [np.asarray(a, np.float64) for a in (samples.wi, samples.wo, samples.value, samples.weight[:, None])]
    wi, wo, value, weight = columns
    if not samples.size or not all(np.all(np.isfinite(a)) for a in columns):
        raise ValueError("a file of samples holds at least one, and finite numbers only")
    if np.any(wi[:, 2] <= GRAZING) or np.any(wo[:, 2] <= GRAZING):
        raise ValueError("a file of samples holds directions above the horizon only")
    if directions == "vectors":
        heads = [*VECTORS["i"], *VECTORS["o"]]
        table = [wi, wo, value]
    else:
        heads = [f"{name} [{directions}]" for name in ANGLES]
        table = [_angles(wi, directions), _angles(wo, directions), value]
    if np.any(weight != 1):
        names, table = [*names, WEIGHT], [*table, weight]
    with replacing(path) as beside, open(beside, "w", encoding="utf-8", newline="") as file:
        if material:
            file.write(f"# material: {material}\n")
        file.write(f"# isotropic: {'true' if samples.isotropic else 'false'}\n# units: sr^-1\n")
        csv.writer(file, lineterminator="\n").writerow([*heads, *names])
        # The shortest decimals that give the same float64, and so the same float32.
        file.writelines(",".join(map(repr, row)) + "\n" for row in np.concatenate(table, axis=1).tolist())


def _angles(w: np.ndarray, unit: str) -> np.ndarray:
    """θ and φ `(n, 2)`."""
    angles = np.stack([np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2]), np.arctan2(w[:, 1], w[:, 0])], axis=-1)
    return np.rad2deg(angles) if unit == "deg" else angles


def _checked_names(names: Sequence[str] | None, channels: int) -> list[str]:
    if names is None:
        names = ["value"] if channels == 1 else [f"value {k}" for k in range(1, channels + 1)]
    names = list(names)
    if len(names) != channels or len(set(names)) != channels:
        raise ValueError(f"expected {channels} different names of channels, got {names}")
    for name in names:
        if not name or name != name.strip() or not name.isprintable() or name.strip('"') != name:
            raise ValueError(f"a name of a channel is printable, without blanks or quotes around it, got {name!r}")
        if ANGLE.fullmatch(name) or name in KNOWN or misspelt(name, KNOWN):
            raise ValueError(f"a name of a channel does not look like one of {', '.join(KNOWN)}, got {name!r}")
    return names


def _comments(file: Lines) -> tuple[dict[str, tuple[int, str]], int]:
    """What the lines before the names say, by key with the line's number; and the number of the line with the names."""
    said: dict[str, tuple[int, str]] = {}
    for number, line in enumerate(file.lines, 1):
        if SEPARATOR.fullmatch(line):
            continue
        if line.strip() and not line.startswith("#"):
            return said, number
        if match := KEY.fullmatch(line):
            key = match[1].lower()
            refuse_misspelt(file, number, key, KEYS)
            if key in KEYS and key in said:
                raise file.error(number, f"{key!r} once", f"again, after line {said[key][0]}")
            said[key] = number, match[2].strip()
        else:
            # A comment, unless it is one of those that change what the values mean, with its colon lost.
            for word in line.lstrip("#").split()[:1]:
                if word.lower() in STRICT or misspelt(word, STRICT):
                    raise file.error(number, "'# key: value', or a comment that begins otherwise", shown(line))
        if late := WITHIN.search(line, 1):
            raise file.error(number, f"{late[0]!r} at the beginning of a line", shown(line))
    raise file.error(len(file.lines), "a line with the names of the columns", "the end of the file")


def _rows(file: Lines, number: int) -> tuple[list[str], Rows]:
    """The names, which stand in a line, and the rows below it."""
    given = _names(file, number)
    names = given[: max((k for k, name in enumerate(given, 1) if name), default=1)]
    _check_names(file, number, names)
    for late in range(number + 1, len(file.lines) + 1):
        if WITHIN.match(file.lines[late - 1]):
            raise file.error(late, "what values mean before the names of the columns", shown(file.lines[late - 1]))
    directions = {column for column, _ in angle_columns(file, number, names).values()}
    values = [k for k, name in enumerate(names) if k not in directions and name not in KNOWN]
    between = separator(file.lines[number - 1])
    rows = read_rows(file, number + 1, len(names), len(given) - len(names), values, between)
    if not len(rows.table):
        got = f"{rows.unmeasured} of which nothing was measured" if rows.unmeasured else "none"
        raise file.error(len(file.lines), "samples after the names of the columns", got)
    return names, rows


def _names(file: Lines, number: int) -> list[str]:
    line = file.lines[number - 1]
    try:
        names = [name.strip() for name in next(csv.reader([line], delimiter=separator(line), strict=True))]
    except csv.Error as error:
        raise file.error(number, "names of columns", str(error)) from error
    if len(names) < 2:
        raise file.error(number, "names of columns with commas, semicolons or tabs between them", shown(line))
    return names


def _check_names(file: Lines, number: int, names: Sequence[str]) -> None:
    for column, name in enumerate(names, 1):
        if not name or name in names[: column - 1]:
            raise file.error(number, "a name that no other column has", shown(name), column)


def _directions(
    file: Lines, number: int, numbers: list[int], names: list[str], table: np.ndarray
) -> tuple[np.ndarray, np.ndarray, set[int]]:
    """wi, wo `(n, 3)`, and the columns that they come from."""
    angles = angle_columns(file, number, names)
    vectors = [name for side in "io" for name in VECTORS[side]]
    if angles and any(name in names for name in vectors):
        raise file.error(number, "directions as angles or as vectors", "both")
    if not angles:
        for name in vectors:
            if name not in names:
                raise file.error(number, f"columns {', '.join(ANGLES)}, or {', '.join(vectors)}", f"no column {name}")
        columns = [[names.index(name) for name in VECTORS[side]] for side in "io"]
        wi, wo = (_unit(file, numbers, table[:, k], k[0]) for k in columns)
        return wi, wo, {*columns[0], *columns[1]}
    for name in ANGLES:
        if name not in angles:
            hint = " (0 throughout where all light comes from one azimuth)" if name == "phi_i" else ""
            raise file.error(number, f"a column {name}{hint}", shown(file.lines[number - 1]))
        column, unit = angles[name]
        if unit is None:
            raise file.error(number, f"the unit of the angle: '{name} [deg]' or '{name} [rad]'", shown(names[column]))
    wi, wo = (from_angles(file, numbers, table, angles, side, "rad") for side in "io")
    return wi, wo, {column for column, _ in angles.values()}


def _seem_radians(angles: Angles, table: np.ndarray) -> bool:
    """Whether polar angles that are given in degrees would all be radians of a hemisphere, and are no round numbers."""
    columns = [column for name, (column, unit) in angles.items() if name.startswith("theta") and unit == "deg"]
    polar = np.abs(table[:, columns])
    return polar.size > 0 and bool(np.all(polar <= 1.58) and np.any(polar % 0.25 != 0))


def _unit(file: Lines, numbers: list[int], w: np.ndarray, column: int) -> np.ndarray:
    """The vectors as they are where they are unit to float32, normalized where they are to three digits."""
    norm = np.linalg.norm(w, axis=1)
    wrong = np.abs(norm - 1) > 1e-3
    if wrong.any():
        row = int(np.argmax(wrong))
        raise file.error(numbers[row], "a vector of length 1", f"{norm[row]:.6g}", column + 1)
    return np.where(np.abs(norm - 1)[:, None] > 1e-6, w / norm[:, None], w)


def _truth(file: Lines, said: dict[str, tuple[int, str]], key: str, default: bool) -> bool:
    if key not in said:
        return default
    number, word = said[key]
    if word not in ("true", "false"):
        raise file.error(number, f"{key} true or false", shown(word))
    return word == "true"


def _units(file: Lines, said: dict[str, tuple[int, str]]) -> str:
    if "units" not in said:
        return "not declared: taken as sr^-1"
    number, word = said["units"]
    if word not in UNITS:
        raise file.error(number, f"units of {' or '.join(UNITS)}", shown(word))
    return "sr^-1"
