"""ASTM files: columns by name, units of angles, counts, and files that are none."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from hshjax.io import FileFormatError, measured_astm, read_astm
from tests.helpers import assert_close
from tests.io.text_formats import ASTM

TEXT = ASTM.decode()


@pytest.fixture
def read(tmp_path):
    def from_text(text: str, **options):
        (tmp_path / "a.astm").write_text(text, encoding="utf-8")
        return measured_astm(tmp_path / "a.astm", **options)

    return from_text


def spherical(theta: float, phi: float) -> list[float]:
    return [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]


def test_directions_and_values(read):
    data, found = read(TEXT)
    assert_close(data.wi, [spherical(0.1, 0)] * 2 + [spherical(0.7, 0.5)] * 2)
    assert_close(data.wo, [spherical(0.25, 3), spherical(0.5, -1), spherical(0.7, 3.6), spherical(1.2, 0.5)])
    assert_close(data.value, [[0.1, 0.2, 0.3], [0.15, 0.25, 0.35], [1.5, 2.5, 3.5], [0.01, 0.02, -0.03]])
    assert (found.channel_names, found.material, found.negative) == (("R", "G", "B"), "Blue paint", 1)
    assert found.units == "not declared: taken as sr^-1"
    assert found.notes == ("Units of angles are not declared: taken as radians.",)
    assert not data.isotropic


settled = settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@settled
@given(
    st.lists(
        st.tuples(st.floats(0, 1.5), st.floats(-7, 7), st.floats(0, 1.5), st.floats(-7, 7), st.floats(-1, 1e6)),
        min_size=1,
    ),
    st.permutations(range(5)),
)
def test_columns_in_any_order(read, rows, order):
    names = ["theta_i", "phi_i", "theta_r", "phi_r", "luminance"]
    text = f"NUM_POINTS {len(rows)}\nVARS {','.join(names[k] for k in order)}\n"
    data, found = read(text + "".join(",".join(repr(row[k]) for k in order) + "\n" for row in rows))
    assert_close(data.wi, [spherical(*row[:2]) for row in rows])
    assert_close(data.wo, [spherical(*row[2:4]) for row in rows])
    assert_close(data.value[:, 0], [row[4] for row in rows])
    assert found.channel_names == ("luminance",)


def test_degrees(read):
    """By the caller, or by the names, which win."""
    rows = "30,90,45,180,1\n"
    data, found = read("VARS theta_i,phi_i,theta_s,phi_s,v\n" + rows, angles="deg")
    assert_close(data.wi[0], spherical(np.pi / 6, np.pi / 2))
    assert_close(data.wo[0], spherical(np.pi / 4, np.pi))
    assert found.notes[1] == "Units of angles are not declared: taken as degrees."
    for names in (
        "theta_i[deg],phi_i[deg],theta_s[deg],phi_s[deg]",
        "theta_i (degrees),phi_i_deg,theta_s deg,phi_s [°]",
    ):
        again, found = read(f"VARS {names},v\n" + rows)
        np.testing.assert_array_equal(again.wo, data.wo)
        assert not any("Units" in note for note in found.notes)


def test_without_azimuths_of_light_and_counts(read):
    data, found = read("NAME x\nVARS theta_i,theta_s,phi_s,400nm,405 nm,Integrated BRDF\n0.5,0.5,3.14,1,2,3\n")
    assert_close(data.wi[0], spherical(0.5, 0))
    assert data.isotropic
    assert found.channel_names == ("400 nm", "405 nm", "Integrated BRDF")
    assert found.material == "x"
    for part in ("No NUM_POINTS", "No column phi_i", "one azimuth"):
        assert any(part in note for note in found.notes)


def test_below_the_horizon(read):
    data, found = read("VARS theta_i,phi_i,theta_s,phi_s,v\n0.5,0,1.58,0,1\n0.5,0,3,0,1\n0.5,0,1.57,0,1\n")
    assert (data.size, found.entries, found.dropped) == (1, 3, {"a direction on or below the horizon": 2})


NAMES = "theta_i,phi_i,theta_s,phi_s,R,G,B"
WRONG = {
    "no VARS": (f"VARS {NAMES}\n", "", "line 7: expected a header that ends with VARS"),
    "a count too high": ("POINTS 4", "POINTS 5", "line 3: expected 4 samples, as follow, got NUM_POINTS 5"),
    "a count too low": ("POINTS 4", "POINTS 3", "line 3: expected 4 samples, as follow, got NUM_POINTS 3"),
    "count 2^31 - 1": (
        "POINTS 4",
        "POINTS 2147483647",
        "line 3: expected a whole number of at least 0, got '2147483647'",
    ),
    "count -1": ("POINTS 4", "POINTS -1", "line 3: expected a whole number of at least 0, got '-1'"),
    "no count": ("POINTS 4", "POINTS", "line 3: expected a whole number of at least 0, got ''"),
    "counts": (
        "NUM_POINTS 4",
        "NUM_POINTS 4\nNUM_POINTS 4",
        "line 4: expected NUM_POINTS once, got again, after line 3",
    ),
    "a misspelt count": (
        "NUM_POINTS",
        "NUM_POINT",
        "line 3: expected 'NUM_POINTS', or a name that does not look like it",
    ),
    "misspelt names": ("VARS", "VAR", "line 4: expected 'VARS', or a name that does not look like it, got 'VAR'"),
    "no theta_i": (NAMES, "phi_i,theta_s,phi_s,R,G,B,C", "line 4: expected a column theta_i, got 'phi_i,"),
    "no theta_s": (NAMES, "theta_i,phi_i,phi_s,R,G,B,C", "line 4: expected a column theta_s"),
    "no phi_s": (NAMES, "theta_i,phi_i,theta_s,R,G,B,C", "line 4: expected a column phi_s"),
    "a misspelt angle": (
        "phi_i,",
        "phi_l,",
        "line 4: expected 'phi_.', or a name that does not look like it, got 'phi_l'",
    ),
    "angles twice": ("R,G,B", "R,G,theta_r", "line 4, column 7: expected one column of theta_o, got 'theta_r', too"),
    "names twice": ("R,G,B", "R,R,B", "line 4: expected names of columns, all different"),
    "an empty name": ("R,G,B", "R,,B", "line 4: expected names of columns, all different"),
    "no values": ("R,G,B", "R,G", "line 5: expected 6 numbers .*, got 7"),
    "degrees": (
        "0.7,0.5,0.7",
        "40,0.5,0.7",
        r"line 7, column 1: expected a polar angle of at most pi radians \(are these",
    ),
    "blanks between": (
        "0.1,0.0,0.25,3.0,0.1,0.2,0.3",
        "0.1 0.0 0.25 3.0 0.1 0.2 0.3",
        "line 5: expected 7 numbers, got 1",
    ),
    "a comment": ("0.1,0.0,0.5", "# 0.1,0.0,0.5", "line 6, column 1: expected a number, got '# 0.1'"),
}


@pytest.mark.parametrize("case", WRONG)
def test_malformed_files(case, read):
    old, new, message = WRONG[case]
    assert old in TEXT
    with pytest.raises(FileFormatError, match=message):
        read(TEXT.replace(old, new, 1))


def test_headers_without_an_end(read):
    """VARS is looked for in the first lines only: a long file of another kind is refused at once."""
    with pytest.raises(FileFormatError, match="line 10000: expected a header that ends with VARS"):
        read("x 1\n" * 20000 + "VARS theta_i,theta_s,phi_s,v\n0,0,0,1\n")
    with pytest.raises(FileFormatError, match="line 1: expected a column of values beside the angles, got none"):
        read("VARS theta_i,theta_s,phi_s\n0,0,0\n")
    with pytest.raises(FileFormatError, match="line 2: expected samples after the header, got none"):
        read("NUM_POINTS 0\nVARS theta_i,theta_s,phi_s,v\n")


def test_other_units_are_refused(tmp_path, unchecked):
    (tmp_path / "a").write_bytes(ASTM)
    with pytest.raises(ValueError, match="angles is rad or deg, got 'gon'"):
        read_astm(tmp_path / "a", angles="gon")
