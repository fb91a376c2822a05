"""FRED's BSDF text: directions from the specular one, its units, and files that are none."""

import numpy as np
import pytest

from hshjax.io import FileFormatError, measured_fred, read_fred
from tests.helpers import X64, assert_close

HEAD = "type bsdf_data\nformat angles=deg bsdf=value scale=1\n"


@pytest.fixture
def read(tmp_path):
    def from_text(text: str, **options):
        (tmp_path / "a.txt").write_text(text, encoding="utf-8")
        return measured_fred(tmp_path / "a.txt", **options)

    return from_text


def spherical(theta: float, phi: float) -> list[float]:
    """In degrees."""
    t, p = np.deg2rad([theta, phi])
    return [np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]


def test_directions(read):
    """The first line of a block is the specular direction: light comes from the other side of the normal."""
    data, found = read(HEAD + "30 0\n30 0 0.5\n40 350 0.25\n-20 0 0.125\n50 90\n50 90 4\n")
    assert_close(data.wi, [spherical(30, 180)] * 3 + [spherical(50, 270)])
    assert_close(data.wo, [spherical(30, 0), spherical(40, 350), spherical(20, 180), spherical(50, 90)])
    assert_close(data.value[:, 0], [0.5, 0.25, 0.125, 4])
    # Mirror pairs have their half vector along the normal.
    half = np.asarray(data.wi + data.wo)[[0, 3]]
    assert_close(half[:, :2], 0)
    assert (found.units, found.channel_names, found.entries) == ("sr^-1", ("value",), 4)
    assert not data.isotropic


def test_one_azimuth_of_light_is_isotropic(read):
    """The azimuth of light along the normal is none."""
    data, found = read(HEAD + "0 77\n10 0 1\n30 5\n30 5 1\n50 365\n50 5 1\n")
    assert data.isotropic
    assert any("isotropic" in note for note in found.notes)


def test_logarithms_and_scales(read):
    text = "type bsdf_data\nformat scale=0.5 bsdf=log angles=deg\n30 0\n30 0 -1\n40 0 2\n"
    data, found = read(text)
    assert_close(data.value[:, 0], [0.05, 50])
    assert any("decimal" in note for note in found.notes)
    assert any("times 0.5" in note for note in found.notes)


def test_sines_in_the_plane_of_incidence(read):
    data, _ = read("TYPE BSDF_DATA\nFORMAT angles=sin bsdf=value scale=1\n0.5 0\n0.6 0 1\n-0.8 0 2\n")
    assert_close(data.wi, [spherical(30, 180)] * 2)
    assert_close(data.wo, [[0.6, 0, 0.8], [-0.8, 0, 0.6]])


def test_below_the_horizon(read):
    data, found = read(HEAD + "30 0\n90 0 1\n89 0 2\n120 0 3\n")
    assert (data.size, found.entries, found.dropped) == (1, 3, {"a direction on or below the horizon": 2})


ROWS = "30 0\n30 0 0.5\n"
WRONG = {
    "another type": ("type bsdf\n" + ROWS, "line 1: expected 'type bsdf_data', got 'type bsdf'"),
    "no format": ("type bsdf_data\n", "line 2: expected 'format angles=deg .*', got nothing"),
    "rows at once": ("type bsdf_data\n" + ROWS, "line 2: expected 'format angles=deg .*', got '30 0'"),
    "radians": (HEAD.replace("deg", "rad") + ROWS, "line 2: expected angles=deg or sin, got 'rad'"),
    "decibels": (HEAD.replace("value", "dB") + ROWS, "line 2: expected bsdf=value or log, got 'dB'"),
    "no scale": (HEAD.replace(" scale=1", "") + ROWS, "line 2: expected 'format .*', each setting once, got 'format"),
    "a scale twice": (HEAD.replace("scale=1", "scale=1 scale=1") + ROWS, "line 2: .* each setting once"),
    "another setting": (HEAD.replace("scale=1", "scale=1 unit=m") + ROWS, "line 2: .* each setting once"),
    "scale 0": (HEAD.replace("scale=1", "scale=0") + ROWS, "line 2: expected a positive scale, got '0'"),
    "scale xxx": (HEAD.replace("scale=1", "scale=xxx") + ROWS, "line 2: expected a number, got 'xxx'"),
    "a scale with a comma": (HEAD.replace("=1", "=0,5") + ROWS, "line 2: expected a decimal point .*, got '0,5'"),
    "no samples": (HEAD, "line 2: expected theta and phi of a specular direction, got the end of the file"),
    "no direction": (HEAD + "30 0 0.5\n", "line 3: expected theta and phi of a specular direction, got '30 0 0.5'"),
    "no samples of a direction": (HEAD + "10 0\n" + ROWS, "line 3: expected samples after a specular direction"),
    "no samples of the last": (HEAD + ROWS + "50 0\n", "line 5: expected samples after a specular direction, got none"),
    "four numbers": (HEAD + ROWS + "40 0 1 1\n", "line 5: expected 3 numbers, got 4 in '40 0 1 1'"),
    "a word": (HEAD + ROWS + "40 0 x\n", "line 5, column 3: expected a number, got 'x'"),
    "a comment": (HEAD + "# x\n" + ROWS, "line 3, column 1: expected a number, got '#'"),
    "two files": (HEAD + ROWS + HEAD + ROWS, "line 5, column 1: expected a number, got 'type'"),
    "a wide angle": (HEAD + ROWS + "190 0 1\n", "line 5, column 1: expected a polar angle of at most 180 degrees"),
    "a wide specular angle": (HEAD + "-200 0\n40 0 1\n", "line 3, column 1: expected a polar angle of at most 180"),
    "sines out of the plane": (
        HEAD.replace("deg", "sin") + "0.5 0\n0.5 0.1 1\n",
        "line 4, column 2: expected 0 under angles=sin .*ambiguous.*, got '0.1'",
    ),
    "no sine": (HEAD.replace("deg", "sin") + "0.5 0\n1.5 0 1\n", "line 4, column 1: expected a sine, got '1.5'"),
    "a large logarithm": (
        HEAD.replace("value", "log") + ROWS + "40 0 39\n",
        r"line 5, column 3: expected a finite number \(of float32\) once scaled",
    ),
    "light below": (HEAD + "100 0\n40 0 1\n", "samples: expected directions above the horizon, got none among 1"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_malformed_files(case, read):
    text, message = WRONG[case]
    with pytest.raises(FileFormatError, match=message):
        read(text)


def test_a_real_file(data):
    """Black coating: counts, and the side on which it shines, which settles what azimuths mean."""
    path = data / "goniometer/AnoBlackNiTEonSteel_fullAz.txt"
    samples, found = measured_fred(path)
    assert (samples.size, samples.channels, found.entries) == (2175, 1, 2175)
    assert (found.negative, found.invalid_share, samples.isotropic) == (0, 0, True)
    wi, wo, value = (np.asarray(a, float) for a in (samples.wi, samples.wo, samples.value[:, 0]))
    theta = np.round(np.rad2deg(np.arccos(wi[:, 2])), 2)
    assert {t: int(np.sum(theta == t)) for t in np.unique(theta)} == {10: 549, 30: 542, 50: 542, 70: 542}
    for angle in (10, 30, 50, 70):
        of = np.flatnonzero(theta == angle)
        mirror = wi[of] * [-1, -1, 1]
        # The brightest sample lies nearer to the mirror direction than to the light, but for 10 degrees by far.
        peak = np.argmax(value[of])
        away = np.rad2deg(np.arccos(np.clip(np.sum(mirror[peak] * wo[of][peak]), -1, 1)))
        assert away < 31
        # The sample in the mirror direction shines more than the one back towards the light.
        towards = [np.argmax(np.sum(w * wo[of], axis=1)) for w in (mirror, wi[of])]
        assert value[of][towards[0]] > 1.3 * value[of][towards[1]]
        # All of the hemisphere to 80 degrees.
        assert_close(np.rad2deg(np.arccos(wo[of, 2])).max(), 80, tolerance=1e-6 if X64 else 1e-4)
        assert len(np.unique(np.round(np.arctan2(wo[of, 1], wo[of, 0]), 4))) >= 36
    np.testing.assert_array_equal(read_fred(path).value, samples.value)
