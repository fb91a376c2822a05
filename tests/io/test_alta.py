"""ALTA's text files: every parametrisation against its definition, and headers that are none."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from scipy.spatial.transform import Rotation

from hshjax.io import FileFormatError, measured_alta, read_alta
from hshjax.io._alta_parameters import AMBIGUOUS, PARAMETRISATIONS
from tests.helpers import X64, assert_close, directions

ROUNDING = 1e-9 if X64 else 2e-5
"""Angles are written with 17 digits; near poles their cosines lose half of what there is in float32."""


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=-1)


def theta(w: np.ndarray) -> np.ndarray:
    return np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2])


def phi(w: np.ndarray) -> np.ndarray:
    return np.arctan2(w[:, 1], w[:, 0])


def mirror(w: np.ndarray) -> np.ndarray:
    return 2 * w[:, 2:] * [[0, 0, 1]] - w


def half(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    return unit(wi + wo)


def back(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """The bisector of wo and the mirror direction of wi."""
    return unit(wo + mirror(wi))


def difference(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """The view vector in the frame of the half vector, by scipy's rotations."""
    h = half(wi, wo)
    return Rotation.from_euler("ZY", np.stack([phi(h), theta(h)], -1)).inv().apply(wo)


def projected(angle: np.ndarray, azimuth: np.ndarray) -> list[np.ndarray]:
    return [angle * np.cos(azimuth), angle * np.sin(azimuth)]


def around_light(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """The azimuth of wo around wi, from the normal towards +y where wi is at φ = 0: by scipy's rotations."""
    local = Rotation.from_euler("ZY", np.stack([phi(wi), theta(wi)], -1)).inv().apply(wo)
    # There the normal lies at φ = π.
    return np.pi - phi(local)


def stark(wi: np.ndarray, wo: np.ndarray) -> list[np.ndarray]:
    h, b = (wi + wo) / 2, (wi - wo) / 2
    return [np.hypot(h[:, 0], h[:, 1]), np.linalg.norm(b, axis=1), phi(b) - phi(h)]


def neumann(wi: np.ndarray, wo: np.ndarray) -> list[np.ndarray]:
    h, b = (wi + wo) / 2, (wi - wo) / 2
    return [np.hypot(h[:, 0], h[:, 1]), np.hypot(b[:, 0], b[:, 1]), phi(b) - phi(h)]


def barycentric(wi: np.ndarray, wo: np.ndarray) -> list[np.ndarray]:
    alpha = (1 - dot(wi, wo)) / 2
    return [alpha, (1 - half(wi, wo)[:, 2] ** 2) * (1 - alpha)]


COORDINATES = {
    "COS_TH": lambda wi, wo: [half(wi, wo)[:, 2]],
    "COS_TK": lambda wi, wo: [back(wi, wo)[:, 2]],
    "COS_TLV": lambda wi, wo: [dot(wi, wo)],
    "COS_TLR": lambda wi, wo: [dot(wi, mirror(wo))],
    "COS_TH_TD": lambda wi, wo: [half(wi, wo)[:, 2], dot(half(wi, wo), wo)],
    "RUSIN_TH_TD": lambda wi, wo: [theta(half(wi, wo)), np.arccos(dot(half(wi, wo), wo))],
    "ISOTROPIC_TV_PROJ_DPHI": lambda wi, wo: projected(theta(wo), phi(wo) - phi(wi)),
    "STARK_2D": lambda wi, wo: stark(wi, wo)[:2],
    "NEUMANN_2D": lambda wi, wo: neumann(wi, wo)[:2],
    "BARYCENTRIC_ALPHA_SIGMA": barycentric,
    "RUSIN_TH_TD_PD": lambda wi, wo: [
        theta(half(wi, wo)),
        theta(difference(wi, wo)),
        phi(difference(wi, wo)),
    ],
    "RUSIN_TH_PH_TD": lambda wi, wo: [theta(half(wi, wo)), phi(half(wi, wo)), theta(difference(wi, wo))],
    "RUSIN_VH": lambda wi, wo: list(half(wi, wo).T),
    # ALTA's from_cartesian takes the mirror image of the view vector here, not of the light.
    "SCHLICK_VK": lambda wi, wo: list(unit(wi + mirror(wo)).T),
    "SCHLICK_VH": lambda wi, wo: list(unit(wi + mirror(wo)).T),
    "ISOTROPIC_TV_TL_DPHI": lambda wi, wo: [theta(wo), theta(wi), phi(wi) - phi(wo)],
    "ISOTROPIC_TL_TV_DPHI": lambda wi, wo: [theta(wi), theta(wo), phi(wo) - phi(wi)],
    "ISOTROPIC_TL_TV_PROJ_DPHI": lambda wi, wo: [theta(wi), *projected(theta(wo), phi(wo) - phi(wi))],
    "SCHLICK_TL_TK_PROJ_DPHI": lambda wi, wo: [
        theta(wi),
        *projected(theta(back(wi, wo)), phi(back(wi, wo)) - phi(wi)),
    ],
    "RETRO_TL_TVL_PROJ_DPHI": lambda wi, wo: [
        theta(wi),
        *projected(np.arccos(dot(wi, wo)), around_light(wi, wo)),
    ],
    "STARK_3D": stark,
    "NEUMANN_3D": neumann,
    "RUSIN_TH_PH_TD_PD": lambda wi, wo: [
        theta(half(wi, wo)),
        phi(half(wi, wo)),
        theta(difference(wi, wo)),
        phi(difference(wi, wo)),
    ],
    "SPHERICAL_TL_PL_TV_PV": lambda wi, wo: [theta(wi), phi(wi), theta(wo), phi(wo)],
    "STEREOGRAPHIC": lambda wi, wo: [*(wo[:, :2].T / (1 + wo[:, 2])), *(wi[:, :2].T / (1 + wi[:, 2]))],
    "RUSIN_VH_VD": lambda wi, wo: [*half(wi, wo).T, *difference(wi, wo).T],
    "CARTESIAN": lambda wi, wo: [*wo.T, *wi.T],
}
"""The definitions, from directions to coordinates: the other way round than the reader, and with scipy's rotations."""

OPEN = {
    "COS_TH": lambda wi, wo: dot(wi, wo) - 1,
    "COS_TK": lambda wi, wo: dot(wi, mirror(wo)) - 1,
    "COS_TLV": lambda wi, wo: wi[:, 2] - 1,
    "COS_TLR": lambda wi, wo: wi[:, 2] - 1,
    "COS_TH_TD": lambda wi, wo: wi[:, 2] - wo[:, 2],
    "RUSIN_TH_TD": lambda wi, wo: wi[:, 2] - wo[:, 2],
    "ISOTROPIC_TV_PROJ_DPHI": lambda wi, wo: wi[:, 2] - 1,
    "STARK_2D": lambda wi, wo: wi[:, 2] - wo[:, 2],
    "NEUMANN_2D": lambda wi, wo: wi[:, 2] - wo[:, 2],
    "BARYCENTRIC_ALPHA_SIGMA": lambda wi, wo: wi[:, 2] - wo[:, 2],
    "RUSIN_TH_PH_TD": lambda wi, wo: wi[:, 2] - wo[:, 2],
    "RUSIN_VH": lambda wi, wo: dot(wi, wo) - 1,
    "SCHLICK_VK": lambda wi, wo: dot(wi, mirror(wo)) - 1,
    "SCHLICK_VH": lambda wi, wo: dot(wi, mirror(wo)) - 1,
}
"""Where coordinates leave the pair open: what is 0 of the pair that is taken."""


def written(name: str, coordinates: list[np.ndarray], value: np.ndarray, output: str = "INV_STERADIAN") -> str:
    rows = np.column_stack([*coordinates, value])
    header = f"#DIM {len(coordinates)} {value.shape[1]}\n#PARAM_IN {name}\n#PARAM_OUT {output}\n"
    return header + "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


@pytest.fixture
def read(tmp_path):
    def from_text(text: str, **options):
        (tmp_path / "a.dat").write_text(text, encoding="utf-8")
        return measured_alta(tmp_path / "a.dat", **options)

    return from_text


def test_every_parametrisation_has_its_definition_here():
    assert COORDINATES.keys() == PARAMETRISATIONS.keys()
    assert OPEN.keys() == {name for name, p in PARAMETRISATIONS.items() if p.note}


def pairs(name: str, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of directions well above the horizon; what depends on light along the normal gets it."""
    wi, wo = (np.asarray(directions(seed + k, 50, min_z=0.1), float) for k in (1, 2))
    wi, wo = unit(wi), unit(wo)
    if name in ("COS_TLV", "COS_TLR", "ISOTROPIC_TV_PROJ_DPHI"):
        wi = np.tile([0.0, 0.0, 1.0], (50, 1))
    return wi, wo


@pytest.mark.parametrize("name", PARAMETRISATIONS)
def test_parametrisations_against_their_definitions(name, read):
    """Directions that are written as coordinates have the same coordinates when they are read; and are the same up to
    a common rotation about the normal and a mirror image of it, where the coordinates tell them."""
    wi, wo = pairs(name)
    coordinates = COORDINATES[name](wi, wo)
    value = np.arange(100.0).reshape(50, 2)
    data, found = read(written(name, coordinates, value))
    assert found.entries == 50
    assert not found.dropped
    assert found.format == f"ALTA text, {name}"
    assert data.isotropic == PARAMETRISATIONS[name].isotropic
    assert_close(data.value, value)
    back_i, back_o = (np.array(w, float) for w in (data.wi, data.wo))
    assert_close(np.linalg.norm(back_i, axis=1), 1)
    assert_close(np.linalg.norm(back_o, axis=1), 1)
    if not X64:  # angles of rounded directions: half the digits
        return
    again = COORDINATES[name](back_i, back_o)
    for column, (first, second) in enumerate(zip(coordinates, again, strict=True)):
        # Angles are compared on the circle, everything else as it is.
        gap = np.abs(first - second)
        gap = np.minimum(gap, np.abs(2 * np.pi - gap)) if name not in ("CARTESIAN",) else gap
        assert gap.max() < 1e-7, (column, gap.max())
    if name in OPEN:
        assert_close(OPEN[name](back_i, back_o), 0)
        (note,) = found.notes
        assert note.startswith(name.replace("SCHLICK_VH", "SCHLICK_VK"))
        return
    assert not found.notes
    assert_close(back_i[:, 2], wi[:, 2], tolerance=ROUNDING)
    assert_close(back_o[:, 2], wo[:, 2], tolerance=ROUNDING)
    assert_close(dot(back_i, back_o), dot(wi, wo), tolerance=ROUNDING)
    if not data.isotropic:
        assert_close(back_i, wi, tolerance=ROUNDING)
        assert_close(back_o, wo, tolerance=ROUNDING)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from([name for name, p in PARAMETRISATIONS.items() if not p.isotropic and not p.note]),
    st.tuples(*(st.floats(0, 1.5), st.floats(-3.1, 3.1)) * 2),
)
def test_round_trips_of_any_pair(read, name, angles):
    """At the normal, mirror and equal pairs too: where azimuths are nothing, directions are still the same."""
    w = [np.asarray([[np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)]]) for t, p in (angles[:2], angles[2:])]
    data, _ = read(written(name, COORDINATES[name](*w), np.ones((1, 1))))
    # arccos and atan2 near poles: half of the digits.
    assert_close(data.wi, w[0], tolerance=1e-6 if X64 else 1e-3)
    assert_close(data.wo, w[1], tolerance=1e-6 if X64 else 1e-3)


def test_azimuths_count_from_light_to_view(read):
    """Signs: of ISOTROPIC_TL_TV_PROJ_DPHI, ALTA's to_cartesian puts the light at φ = 0 and the view at Δφ."""
    data, _ = read(written("ISOTROPIC_TL_TV_PROJ_DPHI", [np.r_[0.3], np.r_[0.0], np.r_[0.5]], np.ones((1, 1))))
    assert_close(data.wi[0], [np.sin(0.3), 0, np.cos(0.3)])
    assert_close(data.wo[0], [0, np.sin(0.5), np.cos(0.5)])
    # A negative angle lies across the normal.
    data, _ = read(written("ISOTROPIC_TL_TV_PROJ_DPHI", [np.r_[0.3], np.r_[-0.5], np.r_[0.0]], np.ones((1, 1))))
    assert_close(data.wo[0], [-np.sin(0.5), 0, np.cos(0.5)])
    # The difference vector belongs to the view: φ_d = 0 lowers it.
    data, _ = read(written("RUSIN_TH_TD_PD", [np.r_[0.3], np.r_[0.2], np.r_[0.0]], np.ones((1, 1))))
    assert_close(data.wi[0], [np.sin(0.1), 0, np.cos(0.1)])
    assert_close(data.wo[0], [np.sin(0.5), 0, np.cos(0.5)])


@pytest.mark.parametrize("output", ["INV_STERADIAN", "INV_STERADIAN_COSINE_FACTOR", "RGB_COLOR", "XYZ_COLOR"])
def test_values(output, read):
    wi, wo = pairs("CARTESIAN")
    value = np.random.default_rng(0).uniform(size=(50, 3))
    data, found = read(written("CARTESIAN", COORDINATES["CARTESIAN"](wi, wo), value, output))
    weighted = output == "INV_STERADIAN_COSINE_FACTOR"
    assert_close(data.value, value / wo[:, 2:] if weighted else value)
    assert found.channel_names == {"RGB_COLOR": ("R", "G", "B"), "XYZ_COLOR": ("X", "Y", "Z")}.get(
        output, ("value 1", "value 2", "value 3")
    )
    assert found.notes == (("Values include the cosine of the outgoing direction: divided by it.",) if weighted else ())
    assert "sr^-1" in found.units


def test_units_that_are_not_declared(read):
    _, found = read("#DIM 1 1\n#PARAM_IN COS_TH\n0.5 1\n")
    assert found.units == "not declared: taken as sr^-1"
    assert found.channel_names == ("value",)


def test_below_the_horizon_and_outside_of_the_coordinates(read):
    """Counted apart: directions below, and lengths that no pair of directions has."""
    text = (
        "#DIM 3 1\n#PARAM_IN ISOTROPIC_TL_TV_DPHI\n0.1 0.2 0 1\n1.6 0.2 0 1\n0.1 -2 0 1\n0.1 1.5707963267948966 0 1\n"
    )
    data, found = read(text)
    assert (data.size, found.entries, found.dropped) == (1, 4, {"a direction on or below the horizon": 3})
    data, found = read("#DIM 3 1\n#PARAM_IN STARK_3D\n0.6 0.6 0.3 1\n0.9 0.6 0 1\n0.95 0.3 0 1\n")
    assert (data.size, found.entries) == (1, 3)
    assert found.dropped == {
        "coordinates of no pair of directions": 1,
        "a direction on or below the horizon": 1,
    }
    assert found.invalid_share == pytest.approx(2 / 3)


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_confidence_intervals_are_read_past(kind, read):
    rows = "".join(f"0.5 {value}{' 0.1' * kind}\n" for value in (1, 2, 3))
    data, found = read(f"#DIM 1 1\n#VS {kind}\n#PARAM_IN COS_TH\n{rows}")
    assert_close(data.value[:, 0], [1, 2, 3])
    assert any("Confidence" in note for note in found.notes) == (kind > 0)


def test_header(read):
    """Comments, other keys and blank lines anywhere; the words of the sample without their quotes."""
    text = (
        "#ALTA HEADER BEGIN\n# a comment\n#SAMPLE \"Gray Tape\"\n#ORIGIN somewhere\n\n#DIM 1 1\n#PARAM_IN\tCOS_TH\n"
        "#SAMPLE_COUNT 2\n#FORMAT text\n#ALTA HEADER END\n# another\n0.5 1\n\n# a third\n0.6\t2\n"
    )  # fmt: skip
    data, found = read(text)
    assert (data.size, found.material) == (2, "Gray Tape")


HEAD = "#DIM 1 1\n#PARAM_IN COS_TH\n"
WRONG = {
    "no header": ("0.5 1\n", r"line 1: expected a header with #PARAM_IN, got none"),
    "no dimensions": ("#PARAM_IN COS_TH\n0.5 1\n", "line 1: expected a header with #DIM, got none"),
    "no samples": (HEAD, "line 2: expected samples after the header, got none"),
    "one dimension": ("#DIM 1\n#PARAM_IN COS_TH\n0.5 1\n", "line 1: expected two counts, of coordinates and values"),
    "dimension 2^31 - 1": (
        "#DIM 1 2147483647\n#PARAM_IN COS_TH\n0.5 1\n",
        "line 1: expected a whole number of at least 1, got '2147483647'",
    ),
    "many values": ("#DIM 1 999999999\n#PARAM_IN COS_TH\n0.5 1\n", "line 3: expected 1000000000 numbers, got 2"),
    "dimension -1": ("#DIM -1 1\n#PARAM_IN COS_TH\n0.5 1\n", "line 1: expected a whole number of at least 1, got '-1'"),
    "other coordinates": ("#DIM 2 1\n#PARAM_IN COS_TH\n0.5 1 1\n", "line 1: expected 1 coordinates, as COS_TH has"),
    "unknown coordinates": ("#DIM 1 1\n#PARAM_IN COS_TX\n0.5 1\n", "line 2: expected one of COS_TH, .*, got 'COS_TX'"),
    "energy": (HEAD + "#PARAM_OUT ENERGY\n0.5 1\n", "line 3: expected values of a BRDF: one of .*, got 'ENERGY'"),
    "unknown values": (HEAD + "#PARAM_OUT SPECTRAL\n0.5 1\n", "line 3: expected values of a BRDF: .*, got 'SPECTRAL'"),
    "one colour": (HEAD + "#PARAM_OUT RGB_COLOR\n0.5 1\n", "line 1: expected 3 values, as RGB_COLOR has, got 1"),
    "twice": (HEAD + "#DIM 1 1\n0.5 1\n", "line 3: expected #DIM once, got again, after line 1"),
    "misspelt": (HEAD + "#PARAM_OUTT INV_STERADIAN\n0.5 1\n", "line 3: expected 'PARAM_OUT', or a name that"),
    "no blank": (HEAD + "#PARAM_OUT=INV_STERADIAN_COSINE_FACTOR\n0.5 1\n", "line 3: expected a blank after"),
    "a key in a comment": (HEAD + "# x #PARAM_OUT Y\n0.5 1\n", "line 3: expected #PARAM_OUT at the beginning of a"),
    "two files": (HEAD + "0.5 1\n" + HEAD + "0.5 1\n", "line 4: expected no header after the first sample"),
    "binary": (HEAD + "#FORMAT binary\n0.5 1\n", r"line 3: expected text \(convert with ALTA's data2data\), got"),
    "count": (HEAD + "#SAMPLE_COUNT 3\n0.5 1\n", "line 3: expected 1 samples, as follow, got 3"),
    "count -1": (HEAD + "#SAMPLE_COUNT -1\n0.5 1\n", "line 3: expected a whole number of at least 0, got '-1'"),
    "a column more": (HEAD + "0.5 1\n0.5 1 2\n", "line 4: expected 2 numbers, got 3 in '0.5 1 2'"),
    "a column less": (HEAD + "0.5\n0.5 1\n", "line 3: expected 2 numbers, got 1 in '0.5'"),
    "a column more everywhere": (HEAD + "0.5 1 2\n0.5 1 2\n", "line 3: expected 2 numbers, got 3 in '0.5 1 2'"),
    "a cosine": (HEAD + "0.5 1\n1.1 1\n", "line 4, column 1: expected a cosine, got 1.1"),
    "degrees": (
        "#DIM 2 1\n#PARAM_IN RUSIN_TH_TD\n0.1 0.2 1\n10 20 1\n",
        r"line 4, column 1: expected a polar angle of at most pi radians \(are these degrees\?\), got 10",
    ),
    "degrees, projected": (
        "#DIM 3 1\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n0.1 30 40 1\n",
        "line 3, column 2: expected a polar angle of at most pi radians .*, got 50",
    ),
    "a short vector": (
        "#DIM 6 1\n#PARAM_IN CARTESIAN\n0 0 1 0 0 0.9 1\n",
        "line 3, column 4: expected a vector of length 1, got 0.9",
    ),
    "all below": (
        HEAD.replace("TH\n", "TLV\n") + "-0.5 1\n",
        "samples: expected directions above the horizon, got none among 1",
    ),
    "intervals": (HEAD + "#VS 3\n0.5 1\n", "line 3: expected #VS 0, 1 or 2, got '3'"),
    "intervals of several values": (
        "#DIM 1 2\n#PARAM_IN COS_TH\n#VS 1\n0.5 1 2 3 4\n",
        "line 3: expected no confidence intervals beside several values, got #VS 1: ambiguous",
    ),
    "too large over the cosine": (
        "#DIM 3 1\n#PARAM_IN ISOTROPIC_TL_TV_DPHI\n#PARAM_OUT INV_STERADIAN_COSINE_FACTOR\n0.1 1.57 0 3e38\n",
        "values over the cosine: expected finite numbers",
    ),
} | {
    f"ambiguous: {name}": (
        f"#DIM 2 1\n#PARAM_IN {name}\n0.5 0.5 1\n",
        f"line 2: expected coordinates that determine directions, got {name}: ",
    )
    for name in AMBIGUOUS
}


@pytest.mark.parametrize("case", WRONG)
def test_malformed_files(case, read):
    text, message = WRONG[case]
    with pytest.raises(FileFormatError, match=message):
        read(text)


def test_a_real_file(data):
    """Retro-reflective tape: counts, where it sends the light, and what is on the horizon."""
    path = data / "goniometer/retro-gray-tape.dat"
    samples, found = measured_alta(path)
    rows = np.loadtxt(path, comments="#")
    assert found.entries == len(rows) == 7405
    assert found.dropped == {"a direction on or below the horizon": 86}
    assert np.sum(np.hypot(rows[:, 1], rows[:, 2]) > np.pi / 2 - 1e-6) == 86
    assert (samples.size, found.negative, samples.isotropic) == (7319, 0, True)
    assert (found.material, found.units) == ("Gray Tape", "not declared: taken as sr^-1")
    wi, wo, value = (np.asarray(a, float) for a in (samples.wi, samples.wo, samples.value[:, 0]))
    incidences = np.round(np.rad2deg(theta(wi)), 3)
    assert np.unique(incidences).tolist() == [15, 30, 60]
    for angle, away in ((15, 0), (30, 0), (60, 121)):
        of = incidences == angle
        peak = np.flatnonzero(of)[np.argmax(value[of])]
        # Towards the light at 15 and 30 degrees; at 60 the surface of the tape outshines it, near its mirror direction.
        between = np.rad2deg(np.arccos(np.clip(dot(wi[peak], wo[peak]), -1, 1)))
        assert abs(between - away) < 0.5
        assert np.rad2deg(theta(wo[of])).max() > 85
    np.testing.assert_array_equal(read_alta(path).value, samples.value)
