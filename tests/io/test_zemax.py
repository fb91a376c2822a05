"""Zemax's tabular BSDFs: directions around the specular one, sections, counts, and files that are none."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from scipy.spatial.transform import Rotation

from hshjax.io import FileFormatError, measured_zemax, read_zemax
from tests.helpers import assert_close
from tests.io.text_formats import ZEMAX

TEXT = ZEMAX.decode()


@pytest.fixture
def read(tmp_path):
    def from_text(text: str, **options):
        (tmp_path / "a.bsdf").write_text(text, encoding="utf-8")
        return measured_zemax(tmp_path / "a.bsdf", **options)

    return from_text


def written(angles: dict[str, list[float]], values: dict[str, np.ndarray], symmetry: str = "ASymmetrical4D") -> str:
    """A file of these angles and sections `(rotations, incidences, azimuths, radial angles)`."""
    lines = ["Source Measured", f"Symmetry {symmetry}"]
    lines += [f"SpectralContent {'XYZ' if len(values) == 3 else 'Monochrome'}", "ScatterType BRDF"]
    for name, found in angles.items():
        lines += [f"{name} {len(found)}", " ".join(map(repr, found))]
    for name, value in values.items():
        lines += ["", name, "DataBegin"]
        for block in value.reshape(-1, *value.shape[2:]):
            lines += ["TIS 0.5", *("\t".join(map(repr, row)) for row in block.tolist())]
        lines += ["DataEnd"]
    return "\n".join(lines) + "\n"


def expected_pair(rotation: float, incidence: float, azimuth: float, radial: float) -> tuple[np.ndarray, np.ndarray]:
    """By scipy: the pole goes to the specular direction, then everything turns with the sample."""
    turn = Rotation.from_euler("z", -rotation, degrees=True)
    local = Rotation.from_euler("ZY", [azimuth, radial], degrees=True).apply([0, 0, 1])
    wi = turn.apply(Rotation.from_euler("y", incidence, degrees=True).apply([0, 0, 1]))
    return wi, turn.apply(Rotation.from_euler("y", -incidence, degrees=True).apply(local))


def test_directions_and_order(read):
    """Rotation, incidence, azimuth, radial angle: the last runs fastest. All entries are above the horizon here."""
    angles = {
        "SampleRotation": [0.0, 30.0],
        "AngleOfIncidence": [5.0, 20.0, 35.0],
        "ScatterAzimuth": [0.0, 45.0, 200.0, 315.0],
        "ScatterRadial": [2.5, 10.0, 50.0],
    }
    shape = tuple(map(len, angles.values()))
    value = np.arange(1.0, 1 + np.prod(shape)).reshape(shape)
    data, found = read(written(angles, {"Monochrome": value}))
    assert (data.size, found.entries, found.dropped, data.isotropic) == (value.size, value.size, {}, False)
    assert_close(data.value[:, 0], value.ravel())
    pairs = [expected_pair(*at) for at in np.array(np.meshgrid(*angles.values(), indexing="ij")).reshape(4, -1).T]
    assert_close(data.wi, [wi for wi, _ in pairs])
    assert_close(data.wo, [wo for _, wo in pairs])


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.floats(-180, 180), st.floats(0, 60), st.floats(-360, 360), st.floats(0, 25))
def test_any_direction(read, rotation, incidence, azimuth, radial):
    angles = {"SampleRotation": [rotation], "AngleOfIncidence": [incidence]}
    angles |= {"ScatterAzimuth": [azimuth], "ScatterRadial": [radial]}
    data, _ = read(written(angles, {"Monochrome": np.ones((1, 1, 1, 1))}))
    wi, wo = expected_pair(rotation, incidence, azimuth, radial)
    assert_close(data.wi[0], wi)
    assert_close(data.wo[0], wo)


def test_azimuth_0_points_to_the_normal(read):
    """The specification's words: at radial = θ_i and azimuth 0 is the normal, at azimuth 180 the scatter is lower."""
    angles = {"SampleRotation": [0.0], "AngleOfIncidence": [30.0]}
    angles |= {"ScatterAzimuth": [0.0, 180.0], "ScatterRadial": [30.0]}
    data, _ = read(written(angles, {"Monochrome": np.ones((1, 1, 2, 1))}))
    assert_close(data.wo, [[0, 0, 1], [-np.sin(np.pi / 3), 0, 0.5]])


def test_three_sections(read):
    angles = {"SampleRotation": [0.0], "AngleOfIncidence": [30.0]}
    angles |= {"ScatterAzimuth": [0.0, 90.0], "ScatterRadial": [5.0, 10.0]}
    values = {f"Tristimulus{name}": np.arange(4.0).reshape(1, 1, 2, 2) + 10 * k for k, name in enumerate("XYZ")}
    data, found = read(written(angles, values))
    assert found.channel_names == ("X", "Y", "Z")
    assert_close(data.value, [[k, 10 + k, 20 + k] for k in range(4)])
    assert data.isotropic


def test_the_specular_direction_is_there_once(read):
    """The table repeats it for every azimuth; not where its values differ."""
    data, found = read(TEXT)
    assert found.entries == 24
    assert found.dropped == {"the specular direction again": 4, "a direction on or below the horizon": 1}
    assert data.size == 19
    assert int(np.sum(np.asarray(data.value) == np.asarray(0.06, data.value.dtype))) == 1
    data, found = read(TEXT.replace("6.0e-02 5.7e-02", "6.1e-02 5.7e-02"))
    assert found.dropped == {"the specular direction again": 2, "a direction on or below the horizon": 1}


def test_findings(read):
    data, found = read(TEXT.replace("5.7e-02", "0").replace("2.3e-02", "0"))
    assert (found.material, found.units, found.channel_names) == ("brown vinyl", "sr^-1", ("value",))
    assert data.isotropic
    # Of the two zeros one lies on the horizon.
    assert any(note.startswith("1 entries above the horizon are exactly 0") for note in found.notes)
    assert any("PlaneSymmetrical" in note for note in found.notes)


def test_case_and_wrapped_angles(read):
    """Keywords in any case; angles on more lines than one, comments in between; nothing after DataEnd needed."""
    text = (
        TEXT.replace("PlaneSymmetrical", "PLANESYMMETRICAL")
        .replace("Source", "SOURCE")
        .replace("DataBegin", "databegin")
    )
    text = text.replace("0 5.5 20 60", "0 5.5\n# wrapped\n20 60").removesuffix("\n")
    np.testing.assert_array_equal(read(text).data.value, read(TEXT).data.value)


WRONG = {
    "transmission": ("BRDF", "BTDF", r"line 6: expected reflection \(BRDF\), got transmission \(BTDF\), which is not"),
    "another scatter": ("BRDF", "BSSRDF", "line 6: expected 'scattertype' with brdf or btdf, got 'bssrdf'"),
    "another symmetry": ("PlaneSymmetrical", "Round", "line 4: expected 'symmetry' with planesymmetrical or"),
    "another spectrum": ("Monochrome\nS", "RGB\nS", "line 5: expected 'spectralcontent' with monochrome or xyz"),
    "no symmetry": ("Symmetry PlaneSymmetrical\n", "", "line 15: expected the keyword 'symmetry' before the data"),
    "no incidence": ("AngleOfIncidence 2\n10.5 30\n", "", "line 14: expected the keyword 'angleofincidence' before"),
    "a keyword twice": ("ScatterType BRDF", "ScatterType BRDF\nScatterType BRDF", "line 7: expected ScatterType once"),
    "two words": ("Source Measured", "Source Measured twice", "line 3: expected Source and one word"),
    "an unknown keyword": ("ScatterType BRDF", "Scatter BRDF", "line 6: expected the keyword 'scattertype' before the"),
    "no count": ("SampleRotation 1", "SampleRotation", "line 7: expected SampleRotation and one word"),
    "count 2^31 - 1": ("SampleRotation 1", "SampleRotation 2147483647", "line 7: expected a whole number of at"),
    "count 999999999": ("ScatterRadial 4", "ScatterRadial 999999999", "line 16: expected 999999999 angles of 'scat"),
    "count -1": ("SampleRotation 1", "SampleRotation -1", "line 7: expected a whole number of at least 1, got '-1'"),
    "count 0": ("ScatterRadial 4", "ScatterRadial 0", "line 13: expected a whole number of at least 1, got '0'"),
    "too few angles": ("10.5 30", "10.5", "line 11: expected 2 angles of 'angleofincidence', got 'ScatterAzimuth 3'"),
    "too many angles": ("10.5 30", "10.5 30 50", "line 10: expected 2 angles of 'angleofincidence', got '10.5 30 50'"),
    "angles that fall": ("10.5 30", "30 10.5", "line 10: expected increasing angles of 'angleofincidence'"),
    "angles twice": ("10.5 30", "30 30", "line 10: expected increasing angles of 'angleofincidence'"),
    "incidence 100": ("10.5 30", "10.5 100", "line 10: expected angles of 'angleofincidence' in 0 ... 90 degrees"),
    "radial -1": ("0 5.5 20 60", "-1 5.5 20 60", "line 14: expected angles of 'scatterradial' in 0 ... 180"),
    "an angle with a comma": ("10.5", "10,5", r"line 10: expected a decimal point .*, got '10,5'"),
    "another section": ("\nMonochrome", "\nTristimulusX", "line 16: expected the section 'monochrome', got 'Trist"),
    "no DataBegin": ("DataBegin\n", "", "line 17: expected 'DataBegin', got 'TIS 0.25'"),
    "no TIS": ("TIS 0.25\n", "", "line 18: expected 'TIS' and a number, before block 1 of 2, got '6.0e-02"),
    "a TIS of no number": ("TIS 0.25", "TIS x", "line 18: expected a number, got 'x'"),
    "a row less": ("6.0e-02 5.7e-02 5.3e-02 1.3e-02\n", "", "line 21: expected 3 rows in every block, got 'TIS"),
    "a row more": ("TIS 0.375", "1 2 3 4\nTIS 0.375", "line 22: expected 'TIS' and a number, before block 2 of 2"),
    "a block less": ("AngleOfIncidence 2\n10.5 30", "AngleOfIncidence 3\n10.5 30 40", "line 26: .* block 3 of 3"),
    "a block more": ("AngleOfIncidence 2\n10.5 30", "AngleOfIncidence 1\n10.5", "line 22: expected 'DataEnd'"),
    "a column less": (" 1.3e-02", "", "line 21: expected 4 numbers, got 3"),
    "a column more": (" 1.3e-02", " 1 1", "line 21: expected 4 numbers, got 5"),
    "no DataEnd": ("DataEnd\n", "", "line 25: expected 'DataEnd', got the end of the file"),
    "more after DataEnd": ("DataEnd\n", "DataEnd\n1\n", "line 27: expected the end of the file after DataEnd, got '1'"),
    "an end too early": ("TIS 0.375\n", "DataEnd\n", "line 22: expected 'TIS' and a number, before block 2 of 2"),
    "two of three sections": ("Monochrome\nS", "XYZ\nS", "line 16: expected the section 'tristimulusx'"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_malformed_files(case, read):
    old, new, message = WRONG[case]
    assert old in TEXT
    with pytest.raises(FileFormatError, match=message):
        read(TEXT.replace(old, new, 1))


def test_missing_sections(read):
    angles = {"SampleRotation": [0.0], "AngleOfIncidence": [30.0], "ScatterAzimuth": [0.0], "ScatterRadial": [5.0]}
    text = written(angles, {f"Tristimulus{name}": np.ones((1, 1, 1, 1)) for name in "XYZ"})
    with pytest.raises(FileFormatError, match="expected the section 'tristimulusz', got the end of the file"):
        read(text[: text.index("\nTristimulusZ")])


def test_all_below_the_horizon(read, tmp_path):
    angles = {"SampleRotation": [0.0], "AngleOfIncidence": [60.0], "ScatterAzimuth": [180.0], "ScatterRadial": [50.0]}
    with pytest.raises(FileFormatError, match="samples: expected directions above the horizon, got none among 1"):
        read(written(angles, {"Monochrome": np.ones((1, 1, 1, 1))}))
    read(TEXT)
    assert read_zemax(tmp_path / "a.bsdf").size == 19
