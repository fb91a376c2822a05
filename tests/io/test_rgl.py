"""RGL materials: against Mitsuba's evaluation, and against files that are none."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from experiments.peers import run
from experiments.peers._environments import folder
from hshjax.brdfs import GGX, Lambert, TabulatedBRDF
from hshjax.geometry import direction
from hshjax.io import (
    FileFormatError,
    load_model,
    measured_rgl,
    read_rgl,
    read_tensor_file,
    save_model,
    write_rgl,
)
from hshjax.quadrature import isotropic_pair_rule
from tests.helpers import DTYPE, X64, assert_close, directions
from tests.io.hostile_binary import placed_variants, refused, sparse, written
from tests.io.measured_reference import CASES, FILE, pairs, tables
from tests.io.tensor_files import material, packed

MATERIALS = ("colodur_napoli_4f_rgb", "paper_white_rgb", "satin_rosaline_rgb", "vch_golden_yellow_rgb")


# Evaluation and its derivatives, each compiled once for all tests that share shapes.
evaluate = eqx.filter_jit(lambda brdf, wi, wo: brdf(wi, wo))
jacobian = eqx.filter_jit(lambda brdf, wi, wo: jax.jacobian(brdf, (0, 1))(wi, wo))


@pytest.fixture
def brdf(tmp_path) -> TabulatedBRDF:
    (tmp_path / "small.bsdf").write_bytes(packed(material()))
    return read_rgl(tmp_path / "small.bsdf")


@pytest.mark.parametrize("name", MATERIALS)
def test_agrees_with_mitsuba(name, data):
    reference = np.load(data / "rgl/reference_eval.npz", allow_pickle=False)
    wi, wo = (jnp.asarray(reference[k], DTYPE) for k in ("wi", "wo"))
    expected = reference[name]
    value = np.asarray(evaluate(read_rgl(data / f"rgl/{name}.bsdf"), wi, wo))
    assert value.dtype == DTYPE
    error = np.abs(value - expected) / np.abs(expected)
    median, tail = np.median(error), np.quantile(error, 0.99)
    print(f"{name}: relative error, median {median:.1e}, 99 % {tail:.1e}, largest {error.max():.1e}")
    # The reference was evaluated in float32.
    assert median <= 1e-6
    assert tail <= 1e-4
    assert (value.min() < 0) == (expected.min() < 0)


def test_metadata_of_a_real_file(data):
    brdf = read_rgl(data / "rgl/paper_white_rgb.bsdf")
    assert brdf.description == "White A4 paper (160 gsm)"
    assert brdf.channel_names == ("R", "G", "B")
    # Set bits of the 8 x 32 x 32 mask, counted apart from the reader.
    assert brdf.unmeasured == 1014


def test_metadata(brdf):
    assert brdf.description == "Kupfer, gebürstet"
    assert brdf.unmeasured == 5


def test_follows_the_formula_at_vertices(brdf):
    """At θ_i of a slice and with a uniform density, s = u and no interpolation is left to chance."""
    tables = material()
    uniform = type(brdf).from_tables(
        tables["theta_i"], tables["sigma"], tables["ndf"], np.full((3, 5, 6), 7.0), tables["rgb"][0]
    )
    # The half vector at u = (1/4, 3/4), that is θ_h = π/32, φ_h - φ_i = π/2; θ_i = π/4 is the slice in the middle.
    wi = direction(jnp.asarray(np.pi / 4, DTYPE), jnp.asarray(0.3, DTYPE))
    h = direction(jnp.asarray(np.pi / 32, DTYPE), jnp.asarray(0.3 + np.pi / 2, DTYPE))
    wo = 2 * jnp.sum(wi * h) * h - wi
    value = np.asarray(uniform(wi, wo))

    def at(row, u):
        return np.interp(u, np.linspace(0, 1, row.size), row)

    # s_y = 3/4 and s_x = 1/4 in tables of 4 rows, 5 columns: y = 2.25, x = 1.
    rgb = 0.75 * tables["rgb"][0, 1, :, 2, 1] + 0.25 * tables["rgb"][0, 1, :, 3, 1]
    expected = rgb * at(tables["ndf"][0], 0.25) / (4 * at(tables["sigma"][0], np.sqrt(0.5))) / float(wo[2])
    # The file keeps θ_i = π/4 in float32; in the float32 leg wo carries the rounding of a reflection.
    assert_close(value, expected, tolerance=1e-7 if X64 else 1e-4)


def test_isotropic(brdf):
    wi, wo = directions(1, 50, min_z=0.1), directions(2, 50, min_z=0.1)
    turn = jnp.asarray([[np.cos(1.1), -np.sin(1.1), 0], [np.sin(1.1), np.cos(1.1), 0], [0, 0, 1]], DTYPE)
    turned = evaluate(brdf, jnp.einsum("ij,nj->ni", turn, wi), jnp.einsum("ij,nj->ni", turn, wo))
    # Rounded azimuths move within cells of a random, hence steep table.
    assert_close(turned, evaluate(brdf, wi, wo), tolerance=1e-9 if X64 else 2e-4)


def test_shapes_dtypes_and_transformations(brdf):
    wi, wo = directions(3, 4, 1, min_z=0.1), directions(4, 5, min_z=0.1)
    value = brdf(wi, wo)
    assert value.shape == (4, 5, 3)
    assert value.dtype == DTYPE
    assert brdf(wi[:0], wo).shape == (0, 5, 3)
    assert brdf(wi.astype(jnp.float32), wo.astype(jnp.float32)).dtype == jnp.float32
    assert_close(eqx.filter_jit(brdf)(wi, wo), value)
    assert_close(jax.jit(jax.vmap(jax.vmap(brdf, (None, 0)), (0, None)))(wi[:, 0], wo), value)


def test_zero_below_the_horizon(brdf):
    wi, wo = directions(5, 6, min_z=0.1), directions(6, 6, min_z=0.1)
    assert not np.any(brdf(wi, -wo))


SPECIAL = {
    "both at the pole": ((0.0, 0.0), (0.0, 0.0)),
    "wi at the pole": ((0.0, 0.0), (0.7, 0.4)),
    "wo at the pole": ((0.7, 0.4), (0.0, 0.0)),
    "mirror pair": ((0.6, 0.3), (0.6, 0.3 + np.pi)),
    "same direction": ((0.6, 0.3), (0.6, 0.3)),
    "plane of incidence": ((0.6, 0.0), (0.9, np.pi)),
    "near the pole": ((1e-6, 0.3), (2e-6, 0.9)),
    "grazing": ((1.5, 0.0), (1.5, np.pi)),
}


@pytest.mark.parametrize("case", SPECIAL)
def test_finite_values_and_gradients_at_special_pairs(case, brdf):
    wi, wo = (direction(*(jnp.asarray(a, DTYPE) for a in pair)) for pair in SPECIAL[case])
    assert np.all(np.isfinite(evaluate(brdf, wi, wo)))
    for gradient in jacobian(brdf, wi, wo):
        assert np.all(np.isfinite(gradient))


def test_gradient_with_respect_to_directions(brdf):
    if not X64:
        pytest.skip("finite differences need float64")
    wi, wo = directions(7, 20, min_z=0.2), directions(8, 20, min_z=0.2)
    for k, e in enumerate(np.eye(3)):
        tangent = jnp.broadcast_to(jnp.asarray(e, DTYPE), wo.shape)
        _, derivative = jax.jvp(lambda w: evaluate(brdf, wi, w), (wo,), (tangent,))
        step = 1e-7
        difference = (evaluate(brdf, wi, wo + step * tangent) - evaluate(brdf, wi, wo - step * tangent)) / (2 * step)
        # Central differences at 1e-7: rounding 1e-9, and no kink of the tables within a step of these pairs.
        np.testing.assert_allclose(derivative, difference, rtol=1e-5, atol=1e-5, err_msg=f"axis {k}")


def test_gradient_reaches_the_table(brdf):
    wi, wo = directions(9, 30, min_z=0.2), directions(10, 30, min_z=0.2)
    gradient = eqx.filter_jit(eqx.filter_grad(lambda b: jnp.sum(b(wi, wo))))(brdf)
    # The BRDF is linear in `values`, so the gradient returns it.
    assert_close(
        jnp.sum(gradient.values * brdf.values), jnp.sum(evaluate(brdf, wi, wo)), tolerance=1e-9 if X64 else 1e-3
    )


def test_tables_that_do_not_fit_are_refused(brdf, unchecked):
    for name, message in (("marginal", "marginal of a table of .* must have shape"), ("values", "values of a table")):
        parts = {field.name: getattr(brdf, field.name) for field in dataclasses.fields(brdf)}
        parts[name] = parts[name][:-1]
        with pytest.raises(ValueError, match=message):
            type(brdf)(**parts)


def test_samples(brdf):
    rule = isotropic_pair_rule(6, dtype=DTYPE)
    samples = brdf.samples(rule)
    assert (samples.degree, samples.isotropic, samples.channels) == (6, True, 3)
    assert_close(samples.value, brdf(rule.wi, rule.wo))
    assert_close(samples.weight, rule.weight)


def test_an_azimuth_without_visible_normals(brdf):
    tables = material()
    vndf = tables["vndf"][0].copy()
    vndf[:, 3:5] = 0
    holed = type(brdf).from_tables(tables["theta_i"], tables["sigma"], tables["ndf"], vndf, tables["rgb"][0])
    wi, wo = directions(11, 200, min_z=0.05), directions(12, 200, min_z=0.05)
    assert np.all(np.isfinite(evaluate(holed, wi, wo)))
    assert np.all(np.isfinite(jax.jit(jax.grad(lambda w: jnp.sum(holed(wi, w))))(wo)))


@pytest.mark.parametrize("case", CASES)
def test_random_tables_agree_with_mitsuba(case, tmp_path):
    """Anisotropic and spectral ones, against a file that `python -m tests.io.measured_reference` has made."""
    with np.load(FILE, allow_pickle=False) as reference:
        expected = reference[case]
    wi, wo = (jnp.asarray(w, DTYPE) for w in pairs())
    brdf, found = measured_rgl(written(tmp_path / "a.bsdf", packed(tables(case))))
    # The reference was evaluated in float32.
    np.testing.assert_allclose(evaluate(brdf, wi, wo), expected, rtol=5e-6 if X64 else 2e-3)
    assert found.channel_names == (("400 nm", "500 nm", "620 nm", "700 nm") if "spectral" in case else ("R", "G", "B"))
    assert found.format.endswith("anisotropic" if "turn" in case or "quarter" in case else "isotropic")
    assert found.entries == len(CASES[case][0]) * 4 * 4 * 4


def test_mitsuba_agrees_still(tmp_path):
    """The reference is what Mitsuba says, where its environment is there."""
    if not any(folder().glob("mitsuba-*")):
        pytest.skip("no environment of Mitsuba: python -m experiments.peers makes one")
    path = written(tmp_path / "a.bsdf", packed(tables("half a turn")))
    wi, wo = pairs()
    value = run("mitsuba", "mitsuba_measured", {"path": str(path), "wi": wi, "wo": wo, "variant": "scalar_rgb"})[
        "value"
    ]
    with np.load(FILE, allow_pickle=False) as reference:
        np.testing.assert_allclose(value, reference["half a turn"], rtol=1e-5)
    write_rgl(path, GLOSSY, slices=8, size=16)
    value = run("mitsuba", "mitsuba_measured", {"path": str(path), "wi": wi, "wo": wo, "variant": "scalar_rgb"})[
        "value"
    ]
    np.testing.assert_allclose(read_rgl(path)(*map(jnp.asarray, (wi, wo))), value, rtol=1e-4 if X64 else 1e-2)


GLOSSY = Lambert(jnp.asarray([0.3, 0.2, 0.1])) + GGX(jnp.asarray([0.5, 0.4, 0.3]), 0.2)


def test_what_is_written_comes_back(tmp_path):
    path = tmp_path / "a.bsdf"
    write_rgl(path, GLOSSY, description="Glanz")
    brdf = read_rgl(path)
    assert brdf.description == "Glanz"
    wi, wo = directions(21, 2000, min_z=0.17), directions(22, 2000, min_z=0.17)
    exact = np.asarray(evaluate(GLOSSY, wi, wo))
    error = np.abs(np.asarray(evaluate(brdf, wi, wo)) / exact - 1)
    print(f"relative error, median {np.median(error):.1e}, 99 % {np.quantile(error, 0.99):.1e}")
    # 24 angles of incidence, 64 x 64 values: what linear interpolation between them misses.
    assert np.median(error) < 2e-3
    assert np.quantile(error, 0.99) < 0.03
    assert set(read_tensor_file(path)) >= {"luminance", "vndf", "sigma", "ndf", "theta_i", "phi_i", "jacobian", "rgb"}


def test_finer_tables_are_nearer(tmp_path):
    wi, wo = directions(23, 1000, min_z=0.3), directions(24, 1000, min_z=0.3)
    errors = []
    for slices, size in ((6, 12), (12, 24), (24, 48)):
        write_rgl(tmp_path / "a.bsdf", GLOSSY, slices=slices, size=size)
        errors.append(np.median(np.abs(evaluate(read_rgl(tmp_path / "a.bsdf"), wi, wo) / evaluate(GLOSSY, wi, wo) - 1)))
    assert errors[0] > 2 * errors[1] > 4 * errors[2]


def test_spectra_are_written(tmp_path):
    path = tmp_path / "a.bsdf"
    write_rgl(path, Lambert(jnp.asarray([0.4, 0.2])), slices=6, size=8, wavelengths=[450, 632.8])
    brdf = read_rgl(path)
    assert brdf.channel_names == ("450 nm", "632.8 nm")
    pole = jnp.asarray([[0, 0, 1]], DTYPE)
    tilted = jnp.asarray([[0.6, 0, 0.8]], DTYPE)
    assert_close(brdf(pole, tilted)[0], np.array([0.4, 0.2]) / np.pi, tolerance=5e-3)  # a coarse table


def test_what_the_writer_refuses(tmp_path):
    path = tmp_path / "a.bsdf"
    for keywords, message in (
        ({}, "3 channels, got 1"),
        ({"wavelengths": [500, 600]}, "wavelengths must be 1"),
        ({"slices": 1}, "2 slices"),
    ):
        with pytest.raises(ValueError, match=message):
            write_rgl(path, Lambert(jnp.asarray([0.5])), **({"slices": 3, "size": 4} | keywords))
    with pytest.raises(ValueError, match="isotropic"):
        write_rgl(path, lambda wi, wo: jnp.repeat(wi[..., :1] + 2, 3, axis=-1), slices=3, size=4)
    assert not path.exists()


def test_negatives(tmp_path):
    path = written(tmp_path / "a.bsdf", packed(edited("rgb", -0.5)))
    assert measured_rgl(path).found.negative == 1
    assert float(measured_rgl(path).data.values.min()) == -0.5
    assert float(measured_rgl(path, negatives="clip").data.values.min()) == 0
    with pytest.raises(ValueError, match="cannot be masked"):
        measured_rgl(path, negatives="mask")


def test_an_anisotropic_table_is_saved(tmp_path):
    brdf = read_rgl(written(tmp_path / "a.bsdf", packed(tables("a turn"))))
    save_model(tmp_path / "a.hshjax", brdf)
    loaded = load_model(tmp_path / "a.hshjax")
    assert np.array_equal(loaded.phi_i, brdf.phi_i)
    assert np.array_equal(loaded.values, brdf.values)


def test_gigabytes_of_nothing(tmp_path):
    assert "2147483648" in str(refused(read_rgl, sparse(tmp_path / "a.bsdf", CONTENT)))


def test_hostile_files_are_read_or_refused(tmp_path):
    for name, content in placed_variants(CONTENT, counts={"fields": 14}).items():
        error = refused(read_rgl, written(tmp_path / "a.bsdf", content))
        if name.startswith("fields") or name == "empty" or (name.startswith("cut") and int(name[7:-3]) < 60):
            assert error is not None, name


def changed(**changes) -> dict[str, np.ndarray]:
    return {name: t for name, t in (material() | changes).items() if t is not None}


def edited(name: str, value: float) -> dict[str, np.ndarray]:
    tensor = material()[name].copy()
    tensor.flat[1] = value
    return changed(**{name: tensor})


WRONG = {
    "no wavelengths": (changed(rgb=None, spectra=np.ones((1, 3, 9, 4, 5), np.float32)), "'wavelengths'", "'spectra'"),
    "azimuths that stand still": (changed(phi_i=np.zeros(8, np.float32)), "'phi_i'", "0"),
    "a third of a turn": (changed(phi_i=np.float32([-np.pi, -2, -np.pi / 3])), "'phi_i'", "-3.14159 ... -1.0472"),
    "azimuths from 0": (changed(phi_i=np.linspace(0, np.pi, 3).astype(np.float32)), "'phi_i'", "0 ... 3.14159"),
    "more than a turn": (changed(phi_i=np.float32([-4, 4])), "'phi_i'", "-4"),
    "azimuths without tables": (
        changed(phi_i=np.linspace(-np.pi, 0, 3).astype(np.float32)),
        "'vndf'",
        r"\(1, 3, 7, 6\)",
    ),
    "wavelengths that fall": (
        changed(rgb=None, spectra=np.ones((1, 3, 2, 4, 5), np.float32), wavelengths=np.float32([500, 400])),
        "'wavelengths'",
        "400",
    ),
    "a spectrum too few": (
        changed(rgb=None, spectra=np.ones((1, 3, 2, 4, 5), np.float32), wavelengths=np.float32([400])),
        "'spectra'",
        r"\(1, 3, 2, 4, 5\)",
    ),
    "no rgb": (changed(rgb=None), "'rgb'", "'theta_i'"),
    "no description": (changed(description=None), "'description'", "'vndf'"),
    "no jacobian": (changed(jacobian=None), "'jacobian'", "'vndf'"),
    "another convention": (changed(jacobian=np.zeros(1, np.uint8)), "'jacobian'", "0"),
    "elevations that fall": (changed(theta_i=np.float32([0, 1, 0.5])), "'theta_i'", "0.5"),
    "elevations below": (changed(theta_i=np.float32([0, 1, 2])), "'theta_i'", "2"),
    "one elevation": (changed(theta_i=np.float32([0])), "'theta_i'", r"\[0\.\]"),
    "integer elevations": (changed(theta_i=np.arange(3, dtype=np.int32)), "'theta_i'", "int32"),
    "a slice too few": (changed(vndf=np.ones((1, 2, 7, 6), np.float32)), "'vndf'", r"\(1, 2, 7, 6\)"),
    "two channels": (changed(rgb=np.ones((1, 3, 2, 4, 5), np.float32)), "'rgb'", r"\(1, 3, 2, 4, 5\)"),
    "one column": (changed(ndf=np.ones((2, 1), np.float32)), "'ndf'", r"\(2, 1\)"),
    "NaN": (edited("rgb", np.nan), "'rgb'", r"nan at \(0, 0, 0, 0, 1\) \(1 of 180\)"),
    "infinity": (edited("ndf", np.inf), "'ndf'", "inf"),
    "no area": (edited("sigma", 0), "'sigma'", "0.0"),
    "negative density": (edited("vndf", -1), "'vndf'", "-1.0"),
    "no mass": (changed(vndf=np.zeros((1, 3, 7, 6), np.float32)), "'vndf'", "0"),
    "a short mask": (changed(valid=np.zeros(3, np.uint8)), "'valid'", "3 of uint8"),
    "a description that is no text": (changed(description=np.full(3, 255, np.uint8)), "'description'", "0xff"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_materials_are_refused_with_the_field(case, tmp_path):
    tensors, field, got = WRONG[case]
    (tmp_path / "wrong.bsdf").write_bytes(packed(tensors))
    with pytest.raises(FileFormatError, match=f"wrong.bsdf: field {field}: expected .*, got .*{got}"):
        read_rgl(tmp_path / "wrong.bsdf")


def test_the_mask_is_optional(tmp_path):
    (tmp_path / "a.bsdf").write_bytes(packed(changed(valid=None)))
    assert read_rgl(tmp_path / "a.bsdf").unmeasured is None


CONTENT = packed(material())


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.integers(0, len(CONTENT) - 1), st.integers(0, 255)), max_size=3))
def test_damaged_files_are_read_or_refused(tmp_path, flips):
    content = bytearray(CONTENT)
    for position, byte in flips:
        content[position] = byte
    (tmp_path / "a.bsdf").write_bytes(content)
    try:
        brdf = read_rgl(tmp_path / "a.bsdf")
    except FileFormatError:
        return
    assert np.all(np.isfinite(brdf.marginal))
