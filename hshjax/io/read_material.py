"""Whatever file holds a material: a measured one, or a model that `save_model` saved."""

from os import PathLike
from pathlib import Path
from typing import NamedTuple

from hshjax.brdfs import AbstractBRDF
from hshjax.io import model
from hshjax.io.errors import FileFormatError
from hshjax.io.measured import Findings, Negatives, check_negatives
from hshjax.io.read_measured import HEAD, read_measured
from hshjax.samples import Samples


class Material(NamedTuple):
    """A BRDF, or scattered samples of one; with the findings of the reader where it was measured."""

    data: AbstractBRDF | Samples
    found: Findings | None


def read_material(path: str | PathLike, *, negatives: Negatives = "keep") -> Material:
    """The material in a file, by its first bytes: a saved model, or any format that `read_measured` knows.

    **Raises:** FileFormatError for another file, for a model that is no BRDF; OSError where it cannot be opened;
    ValueError for a float64 model while jax has no 64-bit types, and for another word in `negatives`.
    """
    check_negatives(negatives)
    with Path(path).open("rb") as file:
        saved = model.sniff(file.read(HEAD))
    if not saved:
        return Material(*read_measured(path, negatives=negatives))
    brdf = model.load_model(path)
    if not isinstance(brdf, AbstractBRDF):
        raise FileFormatError(path, "line 1, model", "a BRDF", f"a saved {type(brdf).__name__}")
    return Material(brdf, None)
