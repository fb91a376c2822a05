"""A material in another format: the writer is chosen by the suffix of the file, or by name."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from hshjax.brdfs import AbstractBRDF
from hshjax.io.csv_samples import write_csv_samples
from hshjax.io.glsl import write_glsl
from hshjax.io.measured import Negatives
from hshjax.io.merl import write_merl
from hshjax.io.model import save_model
from hshjax.io.rgl import write_rgl
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples


class Writer(NamedTuple):
    """What a format is in words, and what writes a BRDF or samples as it."""

    words: str
    write: Callable[..., None]


def _model(path: str | PathLike, data: AbstractBRDF | Samples, **_: Any) -> None:
    save_model(path, _brdf(data, ".hshjax"))


def _merl(path: str | PathLike, data: AbstractBRDF | Samples, *, negatives: Negatives, **_: Any) -> None:
    write_merl(path, _brdf(data, ".binary"), repeat=True, negatives=None if negatives == "keep" else negatives)


def _rgl(path: str | PathLike, data: AbstractBRDF | Samples, **_: Any) -> None:
    brdf = _brdf(data, ".bsdf")
    write_rgl(path, brdf, description=getattr(brdf, "description", ""))


def _glsl(path: str | PathLike, data: AbstractBRDF | Samples, **_: Any) -> None:
    write_glsl(path, _brdf(data, ".glsl"))


def _csv(path: str | PathLike, data: AbstractBRDF | Samples, *, degree: int, **_: Any) -> None:
    samples = data if isinstance(data, Samples) else Samples.from_function(data, isotropic_pair_rule(degree))
    names = getattr(data, "channel_names", None)
    write_csv_samples(path, samples.cleared(), names, material=getattr(data, "description", ""))


WRITERS: dict[str, Writer] = {
    ".hshjax": Writer("a model of this library, or a table as one", _model),
    ".binary": Writer("MERL", _merl),
    ".bsdf": Writer("RGL, as Mitsuba renders it", _rgl),
    ".glsl": Writer("a function of GLSL, of a fitted model", _glsl),
    ".csv": Writer("samples in CSV", _csv),
}
"""By suffix."""


def write_material(
    path: str | PathLike,
    data: AbstractBRDF | Samples,
    *,
    to: str | None = None,
    degree: int = 64,
    negatives: Negatives = "keep",
) -> None:
    """Write a BRDF or samples; written beside and renamed.

    - `to`: a suffix in `WRITERS`, with or without its point; None: that of `path`.
    - `degree`: of the rule that samples a BRDF, where samples are written.
    - `negatives`: of the BRDF, where the format has no room for them (MERL): "keep" refuses them, "clip" makes them 0,
      "mask" marks them as not measured.

    **Raises:** ValueError for a format that is not written, or cannot hold this material; OSError.
    """
    WRITERS[writer_suffix(path, to)].write(path, data, degree=degree, negatives=negatives)


def writer_suffix(path: str | PathLike, to: str | None = None) -> str:
    """The key in `WRITERS`.

    **Raises:** ValueError, which lists them, for another one.
    """
    suffix = Path(path).suffix.lower() if to is None else "." + to.lower().removeprefix(".")
    if suffix not in WRITERS:
        known = ", ".join(f"{name} ({one.words})" for name, one in WRITERS.items())
        raise ValueError(f"{path}: cannot write {suffix or 'a file without a suffix'!r}; what is written: {known}")
    return suffix


def _brdf(data: AbstractBRDF | Samples, suffix: str) -> AbstractBRDF:
    if isinstance(data, Samples):
        raise ValueError(f"{suffix} holds a BRDF, and these are scattered samples: fit them, and convert the model")
    return data
