"""One treatment of horizons, cosines, weights and negative values for all scattered files."""

import numpy as np
import pytest

from hshjax.io import FileFormatError
from hshjax.io._directions import one_azimuth, polar
from hshjax.io.measured import Findings, measured_samples
from tests.helpers import assert_close

WI = polar(np.asarray([0.1, 0.2, 0.3, 1.8, 0.5]), 0.0)
WO = polar(np.asarray([0.4, np.pi / 2, 0.6, 0.7, 0.8]), 1.0)
VALUE = np.asarray([[1.0, 2.0], [3.0, 4.0], [-1.0, 2.0], [-5.0, 6.0], [7.0, 8.0]])
WEIGHT = np.asarray([1.0, 2.0, 3.0, 4.0, 0.0])
FOUND = Findings("test", "", ("a", "b"), "sr^-1", 0, dropped={"torn": 2}, masked={"grey": 1}, notes=("first",))
HORIZON = {"a direction on or below the horizon": 2}


@pytest.mark.parametrize("negatives", ["keep", "clip", "mask"])
@pytest.mark.parametrize("weighted", [False, True])
def test_samples_and_findings(negatives, weighted):
    """Entries are what the file holds: what the reader left out before counts, too."""
    options = {"weight": WEIGHT} if weighted else {}
    data, found = measured_samples("f", WI, WO, VALUE, FOUND, negatives=negatives, **options)
    kept = [0, 2, 4]
    value = VALUE[kept]
    assert_close(data.wi, WI[kept])
    assert_close(data.wo, WO[kept])
    assert_close(data.value, np.maximum(value, 0) if negatives == "clip" else value)
    weight = (WEIGHT if weighted else np.ones(5))[kept]
    assert_close(data.weight, weight * [1, 0, 1] if negatives == "mask" else weight)
    assert (found.entries, found.negative, found.dropped) == (7, 1, {"torn": 2} | HORIZON)
    assert found.masked == {"grey": 1} | ({"a negative value": 1} if negatives == "mask" else {})
    assert found.notes == (("first", "Negative values became 0.") if negatives == "clip" else ("first",))
    assert found.invalid_share == pytest.approx((4 + 1 + (negatives == "mask")) / 7)
    assert (data.degree, data.isotropic) == (None, False)


def test_the_cosine_of_the_outgoing_direction_is_divided_out():
    data, found = measured_samples("f", WI, WO, VALUE, FOUND, negatives="keep", cosine_included=True, isotropic=True)
    assert_close(data.value, VALUE[[0, 2, 4]] / np.cos([[0.4], [0.6], [0.8]]))
    assert "cosine" in found.notes[-1]
    assert data.isotropic
    with pytest.raises(FileFormatError, match="f: values over the cosine: expected finite numbers"):
        measured_samples("f", WI, WO, 3e38 * VALUE / 8, FOUND, negatives="keep", cosine_included=True)


def test_nothing_left():
    with pytest.raises(FileFormatError, match="f: samples: expected directions above the horizon, got none among 7"):
        measured_samples("f", WI, -WO, VALUE, FOUND, negatives="keep")


def test_findings_of_an_empty_file_lose_nothing():
    assert Findings("test", "", ("a",), "sr^-1", 0).invalid_share == 0


@pytest.mark.parametrize(
    ("theta", "phi", "expected"),
    [
        ([0.1, 0.5], [1.0, 1.0 + 2 * np.pi], True),
        ([0.1, 0.5], [1.0, 1.0 + np.pi], False),
        ([0.1, -0.5], [1.0, 1.0 + np.pi], True),
        ([0.0, 0.5, 0.0], [0.0, 1.0, 2.0], True),
        ([0.0, 0.0], [0.0, 1.0], True),
        ([0.5, 0.5], [1.0, 1.00001], False),
    ],
)
def test_one_azimuth(theta, phi, expected):
    """Light along the normal has none; a negative angle lies across it."""
    assert one_azimuth(polar(np.asarray(theta), np.asarray(phi))) == expected
