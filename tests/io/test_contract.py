"""The checker that hostile tests and fuzzing share notices what a reader must not return."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import HalfVectorTable, LinearBRDF
from hshjax.io import FileFormatError
from hshjax.io.measured import Findings, Measured
from hshjax.io.read_material import Material
from hshjax.photographs import Photographs
from hshjax.samples import Samples
from tests.io.hostile_binary import refused
from tests.io.hostile_process import wrong

FOUND = Findings("a format", "", ("value",), "sr^-1", 1)
UP = jnp.asarray([[0.0, 0.0, 1.0]])


def samples(value: float = 1.0, wi: tuple[float, float, float] = (0.0, 0.0, 1.0), weight: float = 1.0) -> Samples:
    return Samples.scattered(jnp.asarray([wi]), UP, jnp.asarray([[value]]), jnp.asarray([weight]))


def table(value: float, measured: bool | None = None) -> HalfVectorTable:
    axes = np.asarray([0.0, 1.0]), np.asarray([0.0, 1.0]), np.asarray([0.0])
    values = np.full((2, 2, 1, 1), 0.5)
    values[0, 0] = value
    mask = None if measured is None else jnp.full((2, 2, 1), measured)
    return HalfVectorTable(values, *axes, channel_names=("value",), measured=mask)


def model(value: float) -> LinearBRDF:
    return LinearBRDF(IsotropicBasis(HSH(0)), jnp.full((1, 1), value))


def photographs(value: float) -> Photographs:
    return Photographs(np.full((1, 1, 1), value), np.ones((1, 1), bool))


NAN, INF = float("nan"), float("inf")
UNSOUND = {
    "NaN in samples": samples(NAN),
    "below the horizon": samples(wi=(0.0, 0.6, -0.8)),
    "not of unit length": samples(wi=(0.0, 0.0, 2.0)),
    "a negative weight": samples(weight=-1.0),
    "samples with findings": Measured(samples(INF), FOUND),
    "a table": Material(table(NAN), FOUND),
    "nothing measured": table(0.5, measured=False),
    "a model": Material(model(NAN), None),
    "photographs": photographs(INF),
    "unknown photographs": photographs(NAN),
    "no array": [1.0],
    "an empty array": np.zeros((0, 3)),
    "an array of objects": np.asarray(["a"]),
}
SOUND = (samples(), Measured(samples(weight=0.0), FOUND), table(0.5), Material(model(1.0), None), photographs(1.0))


@pytest.fixture
def path(tmp_path):
    (tmp_path / "file").write_bytes(b"content")
    return tmp_path / "file"


@pytest.mark.parametrize("name", UNSOUND)
def test_what_is_not_sound_is_a_fault(name, path):
    fault = wrong(lambda _: UNSOUND[name], path)
    assert fault is not None
    assert "AssertionError" in fault
    with pytest.raises(AssertionError):
        refused(lambda _: UNSOUND[name], path)


def test_what_is_sound_is_none(path):
    for result in SOUND:
        assert wrong(lambda _, result=result: result, path) is None
        assert refused(lambda _, result=result: result, path) is None
        assert wrong(lambda _, result=result: result, path, refused=True) == "it was read"


def test_other_errors_are_faults(path):
    def raising(error):
        def read(_):
            raise error

        return read

    assert wrong(raising(FileFormatError(path, "byte 0", "something", "nothing")), path) is None
    for error in (
        FileFormatError("another", "byte 0", "something", "nothing"),
        KeyError("a"),
        MemoryError(),
        OSError("broken"),
    ):
        assert wrong(raising(error), path) is not None
