"""A material in another format: the writer is chosen by the suffix of the file, or by name."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from hshjax.brdfs import AbstractBRDF
from hshjax.brdfs._known import table_samples
from hshjax.geometry import direction
from hshjax.io._sampling import sampling_rule
from hshjax.io.csv_samples import write_csv_samples
from hshjax.io.glsl import write_glsl
from hshjax.io.measured import Findings, Negatives, check_negatives
from hshjax.io.merl import write_merl
from hshjax.io.model import save_model
from hshjax.io.rgl import wavelengths_of, write_rgl
from hshjax.metrics import with_channels
from hshjax.samples import Samples

GREY = "The one channel is written three times, as R, G and B."


class Writer(NamedTuple):
    """What a format is in words, and what writes a BRDF or samples as it and says what it decided."""

    words: str
    write: Callable[..., tuple[str, ...]]


def _model(path: str | PathLike, data: AbstractBRDF | Samples, **_: Any) -> tuple[str, ...]:
    save_model(path, _brdf(data, ".hshjax"))
    return ()


def _merl(path: str | PathLike, data: AbstractBRDF | Samples, *, negatives: Negatives, **_: Any) -> tuple[str, ...]:
    brdf = _brdf(data, ".binary")
    marked = write_merl(path, brdf, repeat=True, negatives=None if negatives == "keep" else negatives)
    told = f"{marked} nodes with both directions above the horizon are marked as not measured."
    return (GREY,) * (_channels(brdf) == 1) + (told,) * (marked > 0)


def _rgl(path: str | PathLike, data: AbstractBRDF | Samples, *, found: Findings | None, **_: Any) -> tuple[str, ...]:
    brdf = _brdf(data, ".bsdf")
    names, material = _said(data, found)
    wavelengths = wavelengths_of(names or ())
    filled = write_rgl(path, brdf, wavelengths=wavelengths, repeat=True, description=material)
    told = f"{filled} entries without a value hold that of the nearest place with one, and are marked."
    return (GREY,) * (wavelengths is None and _channels(brdf) == 1) + (told,) * (filled > 0)


def _glsl(path: str | PathLike, data: AbstractBRDF | Samples, **_: Any) -> tuple[str, ...]:
    write_glsl(path, _brdf(data, ".glsl"))
    return ()


def _csv(
    path: str | PathLike, data: AbstractBRDF | Samples, *, found: Findings | None, degree: int | None, **_: Any
) -> tuple[str, ...]:
    samples = data if isinstance(data, Samples) else table_samples(data, sampling_rule(data, degree))
    names, material = _said(data, found)
    used = np.asarray(samples.weight) > 0
    left_out = int(np.sum(~used))
    if left_out:
        arrays = (jnp.asarray(np.asarray(a)[used]) for a in (samples.wi, samples.wo, samples.value, samples.weight))
        samples = Samples.scattered(*arrays, isotropic=samples.isotropic)
    write_csv_samples(path, samples, names, material=" ".join(material.split()))  # which is one line there
    return (f"{left_out} samples of weight 0, or where a table has no value, are left out.",) * (left_out > 0)


def _said(data: AbstractBRDF | Samples, found: Findings | None) -> tuple[tuple[str, ...] | None, str]:
    """Names of channels, None where nobody knows them, and the material in words."""
    if found is not None:
        return found.channel_names, found.material
    return getattr(data, "channel_names", None), getattr(data, "description", "")


def _channels(brdf: AbstractBRDF) -> int:
    normal = direction(jnp.zeros(1), jnp.zeros(1))
    return with_channels(brdf(normal, normal), 1).shape[1]


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
    found: Findings | None = None,
    to: str | None = None,
    degree: int | None = None,
    negatives: Negatives = "keep",
) -> tuple[str, ...]:
    """Write a BRDF or samples, and say what was decided, a sentence each; written beside and renamed.

    A single channel is grey: where a format has R, G and B only it is written three times, unless its name is a
    wavelength and the format holds spectra (RGL). Where a table has no value, MERL marks the node, CSV leaves the
    sample out, and RGL takes the nearest value and marks the entry. Samples of weight 0 are left out.

    - `found`: what the reader said, for names of channels and the material; None: what the BRDF itself says.
    - `to`: a suffix in `WRITERS`, with or without its point; None: that of `path`.
    - `degree`: of the rule that samples a BRDF, where samples are written; None: 64, of anisotropic ones 16 over both
      azimuths.
    - `negatives`: of the BRDF, where the format has no room for them (MERL): "keep" refuses them, "clip" makes them 0,
      "mask" marks them as not measured.

    **Raises:** ValueError for a format that is not written, or cannot hold this material; OSError.
    """
    check_negatives(negatives)
    return WRITERS[writer_suffix(path, to)].write(path, data, found=found, degree=degree, negatives=negatives)


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
