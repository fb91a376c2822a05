"""What a reader of a measured material returns: its data, and what it found and decided."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Literal, NamedTuple, get_args

import jax.numpy as jnp
import numpy as np

from hshjax.brdfs import TabulatedBRDF
from hshjax.brdfs._cells import GRAZING as GRAZING
from hshjax.io.errors import FileFormatError
from hshjax.samples import Samples

Negatives = Literal["keep", "clip", "mask"]
"""What a reader does with negative values: keep them as measured, make them 0, or give their samples weight 0."""

LARGEST = 1e30
"""Of a value in a binary file: beyond it lie doubles in the other byte order, and no BRDF."""


def check_negatives(negatives: str) -> None:
    """What every reader does with its argument first.

    **Raises:** ValueError for other words than those of `Negatives`.
    """
    if negatives not in get_args(Negatives):
        raise ValueError(f"negatives is one of {', '.join(get_args(Negatives))}, got {negatives!r}")


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
    weight: np.ndarray | None = None,
) -> Measured:
    """Samples from what a scattered file holds, of equal weight unless `weight` `(n,)` is given.

    `wi`, `wo`: unit directions `(n, 3)`; `value`: `(n, channels)`, finite, times cos θ_o if `cosine_included`. Entries
    with a direction on or below the horizon are dropped and counted, negative values are treated as `negatives` says.
    What the reader has left out already stands in `found.dropped`, and counts as entries.

    **Raises:** FileFormatError where nothing is left, or a value is too large for float32 once the cosine is out of it;
    ValueError for other words than those of `Negatives`.
    """
    check_negatives(negatives)
    entries = len(value) + sum(found.dropped.values())
    upper = (wi[:, 2] > GRAZING) & (wo[:, 2] > GRAZING)
    dropped, masked = dict(found.dropped), dict(found.masked)
    if not upper.all():
        dropped["a direction on or below the horizon"] = int(np.sum(~upper))
    if not upper.any():
        raise FileFormatError(path, "samples", "directions above the horizon", f"none among {entries}")
    wi, wo, value = wi[upper], wo[upper], value[upper]
    weight = np.ones(len(value)) if weight is None else weight[upper]
    notes = list(found.notes)
    if cosine_included:
        value = value / wo[:, 2:]
        if not np.all(np.abs(value) <= np.finfo(np.float32).max):
            raise FileFormatError(path, "values over the cosine", "finite numbers (of float32)", "larger ones")
        notes.append("Values include the cosine of the outgoing direction: divided by it.")
    negative = np.any(value < 0, axis=1)
    if negative.any() and negatives == "clip":
        value = np.maximum(value, 0)
        notes.append("Negative values became 0.")
    elif negative.any() and negatives == "mask":
        masked["a negative value"] = int(np.sum(negative & (weight > 0)))
        weight = np.where(negative, 0.0, weight)
    found = replace(
        found, entries=entries, dropped=dropped, masked=masked, negative=int(negative.sum()), notes=tuple(notes)
    )
    arrays = [jnp.asarray(array) for array in (wi, wo, value, weight)]
    return Measured(Samples.scattered(*arrays, isotropic=isotropic), found)
