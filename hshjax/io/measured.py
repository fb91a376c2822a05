"""What a reader of a measured material returns: its data, and what it found and decided."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Literal, NamedTuple

import numpy as np

from hshjax.brdfs import TabulatedBRDF
from hshjax.io.errors import FileFormatError
from hshjax.samples import Samples

Negatives = Literal["keep", "clip", "mask"]
"""What a reader does with negative values: keep them as measured, make them 0, or give their samples weight 0."""

GRAZING = 1e-6
"""Cosine, to which a direction counts as on the horizon: 90 degrees in float32, or with six digits in radians."""


@dataclass(frozen=True)
class Findings:
    """What a file holds, and what its reader did about it.

    - `format`: of the file, in words; `material`: the file's own words, "" where it has none.
    - `channel_names`: one a channel: "R", "650 nm", "value".
    - `units`: of the values as declared, or "not declared: taken as sr^-1".
    - `entries`: pairs of directions in the file; `dropped`: how many of them are not in the data, by reason; `masked`:
      how many are there at weight 0, or as nodes of a table that count as unmeasured, by reason.
    - `negative`: how many entries have a value below 0 in the file, marks of what is invalid not counted.
    - `notes`: every other decision and assumption, a sentence each.
    """

    format: str
    material: str
    channel_names: tuple[str, ...]
    units: str
    entries: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    masked: Mapping[str, int] = field(default_factory=dict)
    negative: int = 0
    notes: tuple[str, ...] = ()

    @property
    def invalid_share(self) -> float:
        """Share of the entries that do not count, dropped or masked; 0 of a file without any."""
        lost = sum(self.dropped.values()) + sum(self.masked.values())
        return lost / self.entries if self.entries else 0.0


class Measured(NamedTuple):
    """Samples, or a table that is a BRDF, with the findings of the reader."""

    data: Samples | TabulatedBRDF
    found: Findings


def measured_samples(
    path: str | PathLike,
    wi: np.ndarray,
    wo: np.ndarray,
    value: np.ndarray,
    found: Findings,
    *,
    negatives: Negatives,
    cosine_included: bool = False,
    isotropic: bool = False,
) -> Measured:
    """Samples of equal weight from what a scattered file holds.

    `wi`, `wo`: unit directions `(n, 3)`; `value`: `(n, channels)`, finite, times cos θ_o if `cosine_included`. Entries
    with a direction on or below the horizon are dropped and counted, negative values are treated as `negatives` says.

    **Raises:** FileFormatError where nothing is left.
    """
    entries = len(value)
    upper = (wi[:, 2] > GRAZING) & (wo[:, 2] > GRAZING)
    dropped, masked = dict(found.dropped), dict(found.masked)
    if not upper.all():
        dropped["a direction on or below the horizon"] = int(np.sum(~upper))
    if not upper.any():
        raise FileFormatError(path, "samples", "directions above the horizon", f"none among {entries}")
    wi, wo, value = wi[upper], wo[upper], value[upper]
    notes = list(found.notes)
    if cosine_included:
        value = value / wo[:, 2:]
        notes.append("Values include the cosine of the outgoing direction: divided by it.")
    negative = np.any(value < 0, axis=1)
    weight = np.ones(len(value))
    if negative.any() and negatives == "clip":
        value = np.maximum(value, 0)
        notes.append("Negative values became 0.")
    elif negative.any() and negatives == "mask":
        weight[negative] = 0
        masked["a negative value"] = int(negative.sum())
    found = replace(
        found, entries=entries, dropped=dropped, masked=masked, negative=int(negative.sum()), notes=tuple(notes)
    )
    return Measured(Samples.scattered(wi, wo, value, weight, isotropic=isotropic), found)
