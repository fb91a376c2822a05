"""Materials from one format to another: what is known stays known, and what is not does not become black."""

import dataclasses
import json
import struct

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from hshjax import GGX, Lambert
from hshjax.brdfs import AbstractBRDF, HalfVectorTable, RGLTable
from hshjax.brdfs._isotropy import is_isotropic
from hshjax.brdfs._known import known, table_samples
from hshjax.cli import app
from hshjax.geometry import from_half_difference
from hshjax.io import (
    FileFormatError,
    measured_merl,
    measured_rgl,
    measured_utia,
    read_csv_samples,
    read_material,
    read_measured,
    read_merl,
    read_rgl,
    read_samples,
    save_model,
    write_csv_samples,
    write_merl,
    write_rgl,
)
from hshjax.io.write_material import write_material
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close
from tests.io.hostile_binary import written
from tests.io.tensor_files import material, packed

STEPS = (12, 10, 12)
HOLE = np.s_[2:5, 2:5]
"""3 x 3 x 12 nodes, all above the horizon: θ_h up to 10 degrees, θ_d up to 36."""

TRUTH = Lambert(jnp.asarray([0.45, 0.3, 0.2]))


@pytest.fixture
def holed(tmp_path):
    """A MERL file of `TRUTH` with a hole of 108 nodes."""
    path = tmp_path / "holed.binary"
    write_merl(path, TRUTH, steps=STEPS)
    content = bytearray(path.read_bytes())
    planes = np.frombuffer(content, "<f8", offset=12).reshape(3, *STEPS).copy()
    assert np.all(planes[:, *HOLE] > 0)
    planes[:, *HOLE] = -1
    path.write_bytes(bytes(content[:12]) + planes.tobytes())
    return path


def merl_nodes(steps):
    h, d, f = (np.arange(count) / count for count in steps)
    return h**2 * np.pi / 2, d * np.pi / 2, f * np.pi


def test_at_an_unmeasured_node_nothing_is_known(holed):
    """With measured neighbours or not; a thousandth of a cell towards one there is a value, which is theirs."""
    table = read_merl(holed)
    theta_h, theta_d, phi_d = merl_nodes(STEPS)
    grid = np.meshgrid(theta_h[2:5], theta_d[2:5], phi_d[1:], indexing="ij")
    wi, wo = (jnp.asarray(w, DTYPE) for w in from_half_difference(*(jnp.asarray(a.ravel()) for a in grid)))
    assert not np.any(table(wi, wo))
    assert not np.any(known(table, wi, wo))
    root = np.sqrt(theta_h)
    beyond = (root[4] + 2e-3 * (root[5] - root[4])) ** 2
    beside = np.full(11, beyond), np.full(11, theta_d[4]), phi_d[1:]
    wi, wo = (jnp.asarray(w, DTYPE) for w in from_half_difference(*map(jnp.asarray, beside)))
    assert_close(table(wi, wo), TRUTH(wi, wo), tolerance=1e-6)  # of float32 fields
    assert np.all(known(table, wi, wo))


def test_a_sum_knows_what_its_terms_know(holed):
    table = read_merl(holed)
    wi, wo = (
        jnp.asarray(w, DTYPE)[None] for w in from_half_difference(*(jnp.asarray(axis[3]) for axis in merl_nodes(STEPS)))
    )
    assert not np.any(known(2.0 * table + TRUTH, wi, wo))
    assert np.all(known(2.0 * TRUTH + TRUTH, wi, wo))


def test_a_hole_stays_one_in_merl(holed, tmp_path):
    """On the file's own nodes exactly; on others no value is black, and the hole is there."""
    table = read_merl(holed)
    assert write_merl(tmp_path / "same.binary", table, steps=STEPS) == 108
    again = read_merl(tmp_path / "same.binary")
    assert np.array_equal(again.measured, table.measured)
    assert_close(again.values[again.measured], table.values[table.measured], tolerance=1e-6)
    marked = write_merl(tmp_path / "fine.binary", table, steps=(24, 20, 24))
    fine = read_merl(tmp_path / "fine.binary")
    inside = ~np.asarray(fine.measured)[4:9, 4:9]
    assert inside.all()  # between unmeasured nodes, too
    assert marked == inside.size
    values = np.asarray(fine.values)[np.asarray(fine.measured)]
    np.testing.assert_allclose(values, np.broadcast_to(np.asarray([0.45, 0.3, 0.2]) / np.pi, values.shape), rtol=1e-5)


def test_a_hole_is_left_out_of_samples(holed, tmp_path):
    data, found = read_material(holed)
    notes = write_material(tmp_path / "a.csv", data, found=found, degree=16)
    rule = isotropic_pair_rule(16)
    lost = int(np.sum(table_samples(data, rule).weight == 0))
    assert lost > 0
    assert notes == (f"{lost} samples of weight 0, or where a table has no value, are left out.",)
    samples = read_csv_samples(tmp_path / "a.csv")
    assert samples.size == rule.weight.size - lost
    assert np.all(samples.weight > 0)
    assert_close(samples.value, TRUTH(samples.wi, samples.wo), tolerance=1e-6)


def test_a_hole_is_filled_and_marked_in_rgl(holed, tmp_path):
    table = read_merl(holed)
    filled = write_rgl(tmp_path / "a.bsdf", table, slices=8, size=16)
    brdf, found = measured_rgl(tmp_path / "a.bsdf")
    assert filled > 0
    assert brdf.unmeasured == filled
    assert f"{filled} entries were extrapolated" in " ".join(found.notes)
    theta_h, theta_d, phi_d = merl_nodes(STEPS)
    grid = np.meshgrid(theta_h[2:5], theta_d[2:5], phi_d, indexing="ij")
    wi, wo = (jnp.asarray(w, DTYPE) for w in from_half_difference(*(jnp.asarray(a.ravel()) for a in grid)))
    whole = tmp_path / "whole.bsdf"
    assert write_rgl(whole, TRUTH, slices=8, size=16) == 0
    assert read_rgl(whole).unmeasured is None
    # As near the truth as a table of so few entries is without a hole, twice over.
    errors = [np.max(np.abs(one(wi, wo) / TRUTH(wi, wo) - 1)) for one in (brdf, read_rgl(whole))]
    print(f"relative error in the hole, filled {errors[0]:.3f}, measured {errors[1]:.3f}")
    assert errors[0] < 2 * errors[1] + 0.02
    nothing = eqx.tree_at(lambda one: one.measured, table, jnp.zeros_like(table.measured))
    with pytest.raises(ValueError, match="no value"):
        write_rgl(tmp_path / "b.bsdf", nothing, slices=3, size=4)


class Weave(AbstractBRDF):
    """Which changes with the azimuth of the light alone."""

    def formula(self, wi, wo):
        return (2 + jnp.sin(2 * jnp.arctan2(wi[..., 1], wi[..., 0])))[..., None]


def test_anisotropic_materials_are_sampled_over_both_azimuths(tmp_path):
    weave = Weave()
    write_material(tmp_path / "a.csv", weave, degree=4)
    samples = read_csv_samples(tmp_path / "a.csv")
    assert not samples.isotropic
    assert samples.size == 3**2 * 5**2
    assert_close(samples.value, weave(samples.wi, samples.wo))
    assert np.ptp(np.asarray(samples.value)) > 0.5
    write_material(tmp_path / "b.csv", TRUTH, degree=4)
    assert read_csv_samples(tmp_path / "b.csv").size == 3**2 * 5


def scattered(path):
    """Three samples, one of them masked, two wavelengths, a material."""
    wi = jnp.asarray([[0, 0, 1], [0.6, 0, 0.8], [0.8, 0, 0.6]], DTYPE)
    value = jnp.asarray([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]], DTYPE)
    samples = Samples.scattered(wi, wi[::-1], value, jnp.asarray([1, 0, 2], DTYPE), isotropic=True)
    write_csv_samples(path, samples, ("450 nm", "650 nm"), material="red cloth")
    return samples


def test_csv_to_csv_keeps_names_and_material_and_leaves_out_what_is_masked(tmp_path):
    samples = scattered(tmp_path / "a.csv")
    done = CliRunner().invoke(app, ["convert", str(tmp_path / "a.csv"), str(tmp_path / "b.csv"), "--json"])
    assert done.exit_code == 0, done.output
    assert "1 samples of weight 0" in json.loads(done.stdout)["notes"][0]
    again, found = read_measured(tmp_path / "b.csv")
    assert (found.channel_names, found.material) == (("450 nm", "650 nm"), "red cloth")
    for name in ("wi", "wo", "value", "weight"):
        assert_close(getattr(again, name), np.asarray(getattr(samples, name))[[0, 2]])


def small(values, names, description=""):
    nodes = (np.array([0.0, 1.5]), np.array([0.0, 1.5]), np.array([0.0]))
    table = np.broadcast_to(np.asarray(values), (2, 2, 1, len(names)))
    return HalfVectorTable(
        *(jnp.asarray(part, DTYPE) for part in (table, *nodes)), description=description, channel_names=names
    )


@pytest.mark.parametrize(
    ("names", "written_as"),
    [
        (("650 nm",), ("650 nm",)),
        (("450 nm", "650.5 nm"), ("450 nm", "650.5 nm")),
        (("450 nm", "550 nm", "650 nm"), ("450 nm", "550 nm", "650 nm")),
        (("Y",), ("R", "G", "B")),
        (("R", "G", "B"), ("R", "G", "B")),
    ],
    ids=" ".join,
)
def test_channels_of_rgl_files(names, written_as, tmp_path):
    """Spectra by the names of channels, grey three times and said so."""
    values = np.linspace(0.1, 0.2, len(names))
    notes = write_material(tmp_path / "a.bsdf", small(values, names, "line 1\nline 2"))
    brdf, found = measured_rgl(tmp_path / "a.bsdf")
    assert brdf.channel_names == written_as
    assert found.material == "line 1\nline 2"
    assert ("as R, G and B" in " ".join(notes)) == (names == ("Y",))
    tilted = jnp.asarray([[0.6, 0, 0.8]], DTYPE)
    expected = values if len(values) == len(written_as) else np.repeat(values, 3)
    assert_close(brdf(tilted[:, [1, 0, 2]], tilted)[0], expected, tolerance=5e-3)  # a coarse table


def test_grey_is_said_of_merl_and_two_nameless_channels_are_refused(tmp_path):
    assert "as R, G and B" in write_material(tmp_path / "a.binary", Lambert(jnp.asarray([0.5])))[0]
    assert write_material(tmp_path / "b.hshjax", Lambert(jnp.asarray([0.5]))) == ()
    with pytest.raises(ValueError, match="got 2: wavelengths make it a spectral one, as names of channels like '650"):
        write_material(tmp_path / "a.bsdf", Lambert(jnp.asarray([0.5, 0.2])))


def test_a_material_of_several_lines_is_one_in_csv(tmp_path):
    write_material(tmp_path / "a.csv", small([0.1], ("Y",), "line 1\n line 2"), degree=4)
    _, found = read_measured(tmp_path / "a.csv")
    assert (found.material, found.channel_names) == ("line 1 line 2", ("Y",))


def test_a_table_may_begin_with_the_byte_of_a_model(tmp_path):
    """123 steps of θ_h are 0x7b, a brace; and a number of UTIA may begin with any byte."""
    values = np.ones((3, 123, 2, 1))
    path = written(tmp_path / "a.binary", struct.pack("<3i", 123, 2, 1) + values.astype("<f8").tobytes())
    assert path.read_bytes()[:1] == b"{"
    assert isinstance(read_material(path).data, HalfVectorTable)
    first = np.frombuffer(b"{" + np.float64(0.5).tobytes()[1:], "<f8")
    utia = np.concatenate([first, np.full(3 * 288 * 288 - 1, 0.5)]).astype("<f8").tobytes()
    found = read_material(written(tmp_path / "a.bin", utia)).found
    assert found is not None
    assert found.format == "UTIA BRDF"
    save_model(tmp_path / "a.hshjax", TRUTH)
    assert isinstance(read_material(tmp_path / "a.hshjax").data, Lambert)
    content = (tmp_path / "a.hshjax").read_bytes()
    with pytest.raises(FileFormatError, match="line 1"):
        read_material(written(tmp_path / "b.hshjax", content.replace(b'"version": 1', b'"version": 9')))


def test_another_word_for_negatives_is_refused_by_every_reader(tmp_path, unchecked):
    merl, rgl, utia = (
        written(tmp_path / "a.binary", struct.pack("<3i", 2, 2, 1) + np.ones(12).astype("<f8").tobytes()),
        written(tmp_path / "a.bsdf", packed(material())),
        written(tmp_path / "a.bin", np.full(3 * 288 * 288, 0.5).astype("<f8").tobytes()),
    )
    for read, path in ((measured_merl, merl), (measured_rgl, rgl), (measured_utia, utia)):
        for reader in (read, read_measured, read_samples, read_material):
            with pytest.raises(ValueError, match="negatives is one of keep, clip, mask, got 'bogus'"):
                reader(path, negatives="bogus")
    save_model(tmp_path / "a.hshjax", TRUTH)
    with pytest.raises(ValueError, match="got 'bogus'"):
        read_material(tmp_path / "a.hshjax", negatives="bogus")
    with pytest.raises(ValueError, match="got 'bogus'"):
        write_material(tmp_path / "b.hshjax", TRUTH, negatives="bogus")


def steep():
    """A highlight in the first node of a MERL table."""
    theta_h, theta_d, phi_d = merl_nodes((90, 90, 4))
    values = np.ones((90, 90, 4, 1))
    values[0] = 10
    return HalfVectorTable(
        *(jnp.asarray(part, float) for part in (values, theta_h, theta_d, phi_d)), channel_names=("Y",)
    )


NARROW = {
    "a highlight in a node": steep,
    "its multiple": lambda: 2.0 * steep(),
    "GGX 1e-4": lambda: GGX(0.5, 1e-4),
    "GGX 1e-5": lambda: GGX(0.5, 1e-5),
}


@pytest.mark.parametrize("x64", [True, False])
@pytest.mark.parametrize("case", NARROW)
def test_a_narrow_highlight_is_isotropic(case, x64):
    if x64 and not X64:
        pytest.skip("the leg of float32 has no other")
    with jax.enable_x64(x64):
        brdf = NARROW[case]()
        if not x64:
            brdf = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), brdf)
        assert is_isotropic(brdf)


def test_tables_by_type(tmp_path):
    brdf = read_rgl(written(tmp_path / "a.bsdf", packed(material())))
    assert isinstance(brdf, RGLTable)
    assert is_isotropic(brdf)
    turned = dataclasses.replace(
        brdf,
        phi_i=jnp.asarray([-np.pi, 0, np.pi], DTYPE),
        **{
            name: jnp.concatenate([getattr(brdf, name)] * 3)
            for name in ("density", "conditional", "row", "marginal", "values")
        },
    )
    assert not is_isotropic(turned)  # azimuths of its half vectors count from +x
