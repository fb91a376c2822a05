"""Samples in CSV: what is written comes back, and what others write is read or refused with line and column."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from hshjax.io import FileFormatError, measured_csv_samples, read_csv_samples, read_measured, write_csv_samples
from hshjax.quadrature import pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, directions
from tests.io.text_formats import CSV

TEXT = CSV.decode()


@pytest.fixture
def read(tmp_path):
    def from_text(text: str, **options):
        (tmp_path / "a.csv").write_text(text, encoding="utf-8", newline="")
        return measured_csv_samples(tmp_path / "a.csv", **options)

    return from_text


def samples(size: int = 20, channels: int = 3, seed: int = 0, *, weighted: bool = True) -> Samples:
    rng = np.random.default_rng(seed)
    wi, wo = directions(seed, size, min_z=0.01), directions(seed + 1, size, min_z=0.01)
    value = rng.normal(size=(size, channels)) * 10.0 ** rng.uniform(-20, 20, (size, 1))
    weight = rng.uniform(0, 2, size) if weighted else np.ones(size)
    return Samples(wi, wo, value.astype(DTYPE), weight.astype(DTYPE), None, bool(seed % 2))


settled = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@settled
@given(st.integers(1, 30), st.integers(1, 5), st.integers(0, 1000), st.booleans())
def test_what_is_written_comes_back_exactly(tmp_path, size, channels, seed, weighted):
    written = samples(size, channels, seed, weighted=weighted)
    names = tuple(f"{400 + 5 * k} nm" for k in range(channels))
    write_csv_samples(tmp_path / "a.csv", written, names, material='a, b: "c" # d')
    again, found = measured_csv_samples(tmp_path / "a.csv")
    for name in ("wi", "wo", "value", "weight"):
        np.testing.assert_array_equal(getattr(again, name), getattr(written, name))
        assert getattr(again, name).dtype == DTYPE
    assert again.isotropic == written.isotropic
    assert (found.channel_names, found.material, found.units) == (names, 'a, b: "c" # d', "sr^-1")
    assert (found.entries, found.dropped, found.notes) == (size, {}, ())


@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_angles_come_back_to_rounding(unit, tmp_path):
    written = samples()
    write_csv_samples(tmp_path / "a.csv", written, directions=unit)
    assert f"theta_i [{unit}]" in (tmp_path / "a.csv").read_text()
    again, found = measured_csv_samples(tmp_path / "a.csv")
    for name in ("wi", "wo"):
        assert_close(getattr(again, name), getattr(written, name), tolerance=1e-15 if X64 else 2e-7)
    np.testing.assert_array_equal(again.value, written.value)
    np.testing.assert_array_equal(again.weight, written.weight)
    assert found.channel_names == ("value 1", "value 2", "value 3")


def test_a_rule_is_read_as_scattered_samples(tmp_path):
    """Weights of its nodes are kept; that it is exact is not."""
    rule = pair_rule(2, dtype=DTYPE)
    written = Samples.from_function(lambda wi, wo: wi[:, 2] * wo[:, 2], rule)
    write_csv_samples(tmp_path / "a.csv", written)
    again, found = measured_csv_samples(tmp_path / "a.csv")
    np.testing.assert_array_equal(again.weight, rule.weight)
    assert again.degree is None
    assert found.channel_names == ("value",)


NOT_WRITTEN = {
    "too few names": (lambda s: (s, ["a"]), {}, "expected 3 different names of channels, got"),
    "equal names": (lambda s: (s, ["a", "b", "a"]), {}, "expected 3 different names"),
    "a direction's name": (lambda s: (s, ["a", "b", "theta_h"]), {}, "does not look like one of theta_i"),
    "the weight's name": (lambda s: (s, ["a", "b", "weight"]), {}, "does not look like one of"),
    "an angle's name": (lambda s: (s, ["a", "b", "phi_s [deg]"]), {}, "does not look like one of"),
    "no name": (lambda s: (s, ["a", "b", ""]), {}, "printable, without blanks or quotes around it, got ''"),
    "blanks": (lambda s: (s, ["a", "b", " c"]), {}, "without blanks or quotes around it, got ' c'"),
    "quotes": (lambda s: (s, ["a", "b", '"c"']), {}, "without blanks or quotes around it"),
    "a line end": (lambda s: (s, ["a", "b", "c\nd"]), {}, "printable"),
    "a material of two lines": (lambda s: (s,), {"material": "a\nb"}, "the material is one line"),
    "other directions": (lambda s: (s,), {"directions": "gon"}, "directions is one of vectors, deg, rad, got 'gon'"),
    "NaN": (lambda s: (Samples(s.wi, s.wo, s.value.at[3].set(np.nan), s.weight),), {}, "finite numbers only"),
    "below": (lambda s: (Samples(s.wi, -s.wo, s.value, s.weight),), {}, "directions above the horizon only"),
    "none": (lambda s: (Samples(s.wi[:0], s.wo[:0], s.value[:0], s.weight[:0]),), {}, "at least one"),
}


@pytest.mark.parametrize("case", NOT_WRITTEN)
def test_what_would_not_come_back_is_not_written(case, tmp_path, unchecked):
    change, options, message = NOT_WRITTEN[case]
    with pytest.raises(ValueError, match=message):
        write_csv_samples(tmp_path / "a.csv", *change(samples()), **options)
    assert not list(tmp_path.iterdir())


def test_names_with_commas(tmp_path):
    names = ("a, b", 'c "d" e', "µ")
    write_csv_samples(tmp_path / "a.csv", samples(), names)
    assert measured_csv_samples(tmp_path / "a.csv").found.channel_names == names


def spherical(theta: float, phi: float) -> list[float]:
    """In degrees."""
    t, p = np.deg2rad([theta, phi])
    return [np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]


def test_what_others_write(read):
    data, found = read(TEXT)
    assert_close(data.wi, [spherical(30, 0), spherical(30, 90), spherical(60.25, 0)])
    assert_close(data.wo, [spherical(45.5, 180), spherical(45.5, -170), spherical(10, 20)])
    cosines = np.cos(np.deg2rad([45.5, 45.5, 10]))
    assert_close(data.value, [[0.125, 0.08], [0.12, 0.07], [0.11, -0.06]] / cosines[:, None])
    assert_close(data.weight, [1, 0.5, 2])
    assert (found.material, found.channel_names, found.negative) == ("red cloth", ("R", "G"), 1)
    assert any("cosine" in note for note in found.notes)
    assert not data.isotropic


def test_units_are_those_of_each_column(read):
    """In any of their forms, columns in any order, names in quotes, comments before them."""
    rows = f"1,30,{np.pi / 2!r},45,{np.pi!r}\n"
    heads = (
        "value,theta_i [deg],phi_i (rad),theta_o_degrees,phi_r [radians]",
        '"value","Theta_i_deg",phi_i rad,theta_s[°],phi_o_rad',
    )
    for head in heads:
        data, found = read(f"# written by hand\n#\n{head}\n{rows}")
        assert_close(data.wi[0], spherical(30, 90))
        assert_close(data.wo[0], spherical(45, 180))
        assert found.units == "not declared: taken as sr^-1"
        assert data.isotropic
        assert any("one azimuth" in note for note in found.notes)


def test_vectors_to_three_digits(read):
    data, _ = read("wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,v\n0,0.6,0.8,0.577,0.577,0.577,1\n")
    assert_close(data.wi[0], [0, 0.6, 0.8])
    assert_close(data.wo[0], np.full(3, 1 / np.sqrt(3)))


def test_weights_and_negative_values_mask(read):
    text = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,v,weight\n10,0,20,0,-1,0\n10,0,20,0,-1,2\n10,0,20,0,1,3\n"
    data, found = read(text, negatives="mask")
    assert_close(data.weight, [0, 0, 3])
    assert found.masked == {"a weight of 0": 1, "a negative value": 1}
    assert found.negative == 2


HEAD = "theta_i [deg],phi_i [deg],theta_o [deg],phi_o [deg]"
WRONG = {
    "no unit": (
        "theta_i [deg]",
        "theta_i",
        r"line 5: expected the unit of the angle: 'theta_i \[deg\]' or 'theta_i \[rad",
    ),
    "another unit": ("theta_i [deg]", "theta_i [gon]", "line 5: expected a column theta_i, got"),
    "no azimuth": (",phi_o [deg]", ",x", "line 5: expected a column phi_o"),
    "a column twice": (
        "phi_i [deg]",
        "theta_i_rad",
        "line 5, column 2: expected one column of theta_i, got 'theta_i_rad', too",
    ),
    "a name twice": ("R,G", "R,R", "line 5, column 6: expected a name that no other column has, got 'R'"),
    "no name": ("R,G", ",G", "line 5, column 5: expected a name that no other column has, got ''"),
    "no names": (f"{HEAD},R,G,weight\n", "", "line 5: expected columns theta_i, .*, got no column wi_x"),
    "no directions": (HEAD, "a,b,c,d", "line 5: expected columns theta_i, .*, or wi_x, .*, got no column wi_x"),
    "both directions": ("R,G", "R,wi_x", "line 5: expected directions as angles or as vectors, got both"),
    "misspelt": ("weight", "weights", "line 5, column 7: expected 'weight', or a name that does not look like it"),
    "blanks": (
        f"{HEAD},R,G,weight",
        "theta_i_deg phi_i_deg",
        "line 5: expected names of columns with commas, semicolons or tabs between them, got 'theta_i_deg phi",
    ),
    "an open quote": ("R,G", '"R,G', "line 5: expected names of columns, got"),
    "decimal commas": (
        "60.25",
        "60,25",
        r"line 8: expected 7 numbers \(if commas stand for decimal points, replace them\)",
    ),
    "too few": (",2\n", "\n", "line 8: expected 7 numbers, got 6"),
    "a quoted thousand": ("0.125", '"1,125"', "line 6: expected 7 numbers"),
    "an angle that was not measured": ("45.5,180", ",180", "line 6, column 3: expected a number, got ''"),
    "a weight that is not there": (",0.5\n", ",\n", "line 7, column 7: expected a number, got ''"),
    "infinite": ("0.125", "inf", r"line 6, column 5: expected a finite number \(of float32\), got 'inf'"),
    "a key among samples": (
        "60.25",
        "# cosine_included: false\n60.25",
        "line 8: expected what values mean before the names of the columns",
    ),
    "a comment after a number": ("60.25", "60.25 # x", "line 8, column 1: expected a number, got '60.25 # x'"),
    "a wide angle": ("60.25", "190", "line 8, column 1: expected a polar angle of at most 180 degrees, got 190"),
    "degrees as radians": (
        "theta_o [deg]",
        "theta_o [rad]",
        r"line 6, column 3: .* at most pi radians \(are these degrees",
    ),
    "a negative weight": (",0.5\n", ",-0.5\n", "line 7, column 7: expected a weight of at least 0, got -0.5"),
    "isotropic maybe": (
        "isotropic: false",
        "isotropic: maybe",
        "line 2: expected isotropic true or false, got 'maybe'",
    ),
    "isotropic twice": (
        "# units: sr^-1",
        "# isotropic: true",
        "line 3: expected 'isotropic' once, got again, after line 2",
    ),
    "other units": ("sr^-1", "percent", "line 3: expected units of sr.-1 or 1/sr or sr-1, got 'percent'"),
    "a misspelt key": (
        "cosine_included",
        "cosine_include",
        "line 4: expected 'cosine_included', or a name that does not",
    ),
    "a key without its colon": (
        "included: true",
        "included true",
        "line 4: expected '# key: value', or a comment that",
    ),
    "a key within": (
        "cloth\n# isotropic",
        "cloth# isotropic",
        "line 1: expected '# isotropic:' at the beginning of a line",
    ),
    "no values": (
        TEXT[TEXT.index(HEAD) :],
        f"{HEAD},weight\n30,0,45.5,180,1\n",
        "line 5: expected a column of values beside the directions",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_malformed_files(case, read):
    old, new, message = WRONG[case]
    assert old in TEXT
    with pytest.raises(FileFormatError, match=message):
        read(TEXT.replace(old, new, 1))


SPREADSHEETS = {
    "semicolons": lambda text: text.replace(",", ";"),
    "tabs": lambda text: text.replace(",", "\t"),
    "semicolons and decimal commas": lambda text: text.replace(",", ";").replace(".", ","),
    "tabs and decimal commas": lambda text: text.replace(",", "\t").replace(".", ","),
    "all that Excel does": lambda text: (
        "\ufeffsep=;\n" + text.replace(",", ";").replace(".", ",").replace("\n", ";;\n")
    ),
    "quotes": lambda text: "\n".join(",".join(f'"{cell}"' for cell in row.split(",")) for row in text.split()) + "\n",
    "empty rows and columns": lambda text: text.replace("\n", ",,\n") + ",,,,,,,,\n\n",
    "comments": lambda text: text.replace("\n40", "\n# another run\n40"),
    "rows that were not measured": lambda text: text + "50,0,10,0,nan,1\n50,0,20,0,,\n50,0,30,0,#N/A,2\n",
}


@pytest.mark.parametrize("case", SPREADSHEETS)
def test_what_spreadsheets_write(case, read):
    plain = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,R,G\n30,0,45.5,180,0.125,1.5e-3\n40,90,45.5,-170,12,-0.25\n"
    expected, got = read(plain).data, read(SPREADSHEETS[case](plain))
    for name in ("wi", "wo", "value", "weight"):
        np.testing.assert_array_equal(getattr(got.data, name), getattr(expected, name))
    lost = 3 if "measured" in case else 0
    assert got.found.dropped == ({"a value that was not measured": 3} if lost else {})
    assert got.found.entries == 2 + lost
    assert got.found.channel_names == ("R", "G")


def test_points_and_commas_in_one_file_are_refused(read):
    """One of them may stand between thousands."""
    with pytest.raises(FileFormatError, match="line 3: expected decimal points or commas as in line 2, not both"):
        read(HEAD.replace(",", ";") + ";R\n10;0;20;0;1,234\n10;0;30;0;0.5\n")


def test_radians_that_are_called_degrees_are_asked_about(read):
    rows = "0.5236,0,0.7854,3.1416,1\n1.0472,0,0.2618,3.1416,2\n"
    assert any("are these radians?" in note for note in read(HEAD + ",R\n" + rows).found.notes)
    small = "0.5,0,1,180,1\n1,0,0.25,180,2\n"  # about the normal, in degrees
    assert not any("radians" in note for note in read(HEAD + ",R\n" + small).found.notes)


def test_tables_that_are_none_are_told_what_one_is(tmp_path):
    for content, message in (
        (b"My sample\nangle,view,BRDF\n1,2,3\n", "a table of samples begins with names of columns: theta_i"),
        ("theta_i,theta_o\n".encode("utf-16"), "text in UTF-16"),
        (b"PK\x03\x04" + bytes(100), "an archive or a workbook .save the sheet"),
    ):
        (tmp_path / "a.csv").write_bytes(content)
        with pytest.raises(FileFormatError, match=message):
            read_measured(tmp_path / "a.csv")


def test_files_without_samples(read, tmp_path):
    with pytest.raises(FileFormatError, match="line 1: expected samples after the names of the columns, got none"):
        read(HEAD + ",R\n")
    with pytest.raises(FileFormatError, match="line 1: expected a line with the names of the columns, got the end of"):
        read("# only a comment\n")
    with pytest.raises(FileFormatError, match="line 1, column 1: expected a name that no other column has, got ''"):
        read(";;;;\n1;2;3;4;5\n")
    with pytest.raises(FileFormatError, match=r"line 2, column 4: expected a vector of length 1, got 0\.9"):
        read("wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,v\n0,0,1,0,0,0.9,1\n")
    with pytest.raises(FileFormatError, match="expected directions above the horizon, got none among 1"):
        read(HEAD + ",R\n10,0,100,0,1\n")
    read(TEXT)
    assert read_csv_samples(tmp_path / "a.csv").size == 3
