"""MERL files: their layout, what is not measured, what is written and read back, and what is refused."""

import struct

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.recipes._surrogate import read_surrogates
from hshjax import GGX, HSH, IsotropicBasis, Lambert, LinearBRDF
from hshjax.geometry import from_half_difference
from hshjax.io import FileFormatError, measured_merl, merl, read_merl, write_merl
from tests.helpers import DTYPE, X64, assert_close
from tests.io.hostile_binary import placed_variants, refused, replaced, sparse, written

STEPS = (4, 3, 6)
SCALES = np.array([1, 1.15, 1.66]) / 1500


def planes(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(1, 900, (3, *STEPS))


def packed(values: np.ndarray, order: str = "<") -> bytes:
    """The bytes of a file, planes first, independently of the writer."""
    return struct.pack(order + "3i", *values.shape[1:]) + values.astype(order + "f8").tobytes()


def angles(h, d, f):
    return (h / STEPS[0]) ** 2 * np.pi / 2, d / STEPS[1] * np.pi / 2, f / STEPS[2] * np.pi


def test_layout(tmp_path):
    values = planes()
    (tmp_path / "a.binary").write_bytes(packed(values))
    table, found = measured_merl(tmp_path / "a.binary")
    assert_close(table.values, np.moveaxis(values, 0, -1) * SCALES, tolerance=1e-12 if X64 else 1e-6)
    assert table.measured is None
    assert (found.entries, found.channel_names, found.negative, found.invalid_share) == (72, ("R", "G", "B"), 0, 0)
    assert "4 x 3 x 6 steps" in " ".join(found.notes)
    h, d, f = np.meshgrid([1, 2], [1], [1, 2, 5], indexing="ij")
    wi, wo = (jnp.asarray(w, DTYPE) for w in from_half_difference(*map(jnp.asarray, angles(h, d, f))))
    above = np.minimum(wi[..., 2], wo[..., 2]) > 0
    assert above.sum() >= 4
    expected = np.moveaxis(values, 0, -1)[h, d, f] * SCALES
    assert_close(np.asarray(table(wi, wo))[above], expected[above], tolerance=1e-9 if X64 else 1e-4)


def test_negative_values_mark_what_was_not_measured(tmp_path):
    values = planes()
    values[:, 1, 1, 2] = -1
    values[1, 2, 1, 0] = -0.5  # one channel is enough
    values[:, 3, 2, 0] = -1  # 25 and 60 degrees: below the horizon
    (tmp_path / "a.binary").write_bytes(packed(values))
    table, found = measured_merl(tmp_path / "a.binary")
    assert found.masked == {"negative": 2, "negative, a direction on or below the horizon": 1}
    assert np.sum(~np.asarray(table.measured)) == 3
    # At the node itself nothing is known, and next to it the measured corners share what there is.
    at_node, beside = (
        table(*(jnp.asarray(w, DTYPE) for w in from_half_difference(*map(jnp.asarray, angles(1.0, 1.0, f)))))
        for f in (2.0, 2.5)
    )
    assert np.all(at_node == 0)
    assert_close(beside, values[:, 1, 1, 3] * SCALES, tolerance=1e-8 if X64 else 1e-3)


def test_nothing_measured_is_an_error(tmp_path):
    (tmp_path / "a.binary").write_bytes(packed(-planes()))
    with pytest.raises(FileFormatError, match="none among 72"):
        read_merl(tmp_path / "a.binary")


def test_a_material_of_the_database_is_written_and_read_back(tmp_path, data):
    brdf = next(iter(read_surrogates(data / "merl_surrogate/merl_surrogate.npz").values()))
    write_merl(tmp_path / "a.binary", brdf, negatives="clip")
    assert (tmp_path / "a.binary").stat().st_size == 12 + 24 * 90 * 90 * 180
    table, found = measured_merl(tmp_path / "a.binary")
    assert found.notes[-1].startswith("Nodes with a negative value")
    assert list(found.masked) == ["negative, a direction on or below the horizon"]
    rng = np.random.default_rng(0)
    h, d, f = rng.integers(1, 60, 300), rng.integers(1, 60, 300), rng.integers(0, 180, 300)
    half = (h / 90) ** 2 * np.pi / 2, np.radians(d), np.radians(f)
    wi, wo = (np.asarray(w) for w in from_half_difference(*map(jnp.asarray, half)))
    above = np.minimum(wi[:, 2], wo[:, 2]) > 0.01
    wi, wo = jnp.asarray(wi[above]), jnp.asarray(wo[above])
    expected = np.maximum(np.asarray(brdf(wi, wo) + brdf(wo, wi)) / 2, 0)
    got = np.asarray(table.values)[h, d, f][above]
    # The networks are evaluated in float32 in that leg; their output goes through expm1.
    assert_close(got, expected, tolerance=1e-9 if X64 else 1e-3)


def test_written_bytes_follow_the_layout(tmp_path):
    brdf = Lambert(jnp.asarray([0.1, 0.2, 0.3])) + GGX(jnp.asarray([0.04, 0.04, 0.04]), 0.3)
    write_merl(tmp_path / "a.binary", brdf, steps=STEPS)
    content = (tmp_path / "a.binary").read_bytes()
    assert struct.unpack("<3i", content[:12]) == STEPS
    values = np.frombuffer(content[12:], "<f8").reshape(3, *STEPS)
    with jax.enable_x64(True):
        for h, d, f in ((0, 0, 0), (1, 1, 2), (2, 1, 5), (3, 2, 0)):
            wi, wo = from_half_difference(*map(jnp.float64, angles(h, d, f)))
            if min(wi[2], wo[2]) > 0:
                np.testing.assert_allclose(values[:, h, d, f] * SCALES, brdf(wi, wo), rtol=1e-6)  # of float32 fields
            else:
                assert np.all(values[:, h, d, f] == -1)


def test_what_a_writer_refuses(tmp_path):
    grey = Lambert(jnp.asarray([0.5]))
    path = tmp_path / "a.binary"
    with pytest.raises(ValueError, match=r"3 channels, got 1: repeat=True"):
        write_merl(path, grey, steps=STEPS)
    write_merl(path, grey, steps=STEPS, repeat=True)
    assert_close(read_merl(path).values[0, 0, 0], np.full(3, 0.5 / np.pi), tolerance=1e-6)
    basis = IsotropicBasis(HSH(1))
    dark = LinearBRDF(basis, -jnp.ones((basis.count, 3), DTYPE))
    with pytest.raises(ValueError, match='negatives="clip"'):
        write_merl(path, dark, steps=STEPS)
    with pytest.raises(ValueError, match="isotropic"):
        write_merl(path, lambda wi, wo: jnp.repeat(wi[..., :1] + 2, 3, axis=-1), steps=STEPS)
    with pytest.raises(ValueError, match="finite"):
        write_merl(path, lambda wi, wo: jnp.repeat(wi[..., 2:] + jnp.nan, 3, axis=-1), steps=STEPS)
    with pytest.raises(ValueError, match="steps"):
        write_merl(path, grey, steps=(1, 3, 6))
    assert [name.name for name in tmp_path.iterdir()] == ["a.binary"]


CONTENT = packed(planes())
VARIANTS = placed_variants(CONTENT, counts={"theta_h": 0, "theta_d": 4, "phi_d": 8}, numbers=(12, len(CONTENT) - 8))


def test_hostile_files_are_read_or_refused(tmp_path):
    for name, content in VARIANTS.items():
        error = refused(read_merl, written(tmp_path / "a.binary", content))
        if not name.startswith("bit"):
            assert error is not None, name
            assert "byte" in error.where, name
    for name in ("nan at byte 12", "inf at byte 12"):
        assert "byte 12, value 0" in str(refused(read_merl, written(tmp_path / "a.binary", VARIANTS[name])))


def test_the_other_byte_order_is_named(tmp_path):
    error = refused(read_merl, written(tmp_path / "a.binary", packed(planes(), ">")))
    assert "in the other byte order it would fit" in str(error)


def test_gigabytes_of_nothing(tmp_path):
    assert "the size of the file" in str(refused(read_merl, sparse(tmp_path / "a.binary", CONTENT)))
    # Counts that fit the hole.
    huge = 600 * 600 * 600
    content = replaced(CONTENT, 0, "<3i", 600, 600, 600)
    error = refused(read_merl, sparse(tmp_path / "a.binary", content, 12 + 24 * huge))
    assert "at most 8388608 nodes" in str(error)


def test_directories_and_missing_files_stay_what_they_are(tmp_path):
    with pytest.raises(IsADirectoryError):
        read_merl(tmp_path)
    with pytest.raises(FileNotFoundError):
        read_merl(tmp_path / "none.binary")


def test_sniff():
    assert merl.sniff(CONTENT[:64], len(CONTENT))
    assert not merl.sniff(CONTENT[:64], len(CONTENT) + 1)
    assert not merl.sniff(packed(planes(), ">")[:64], len(CONTENT))
    assert not merl.sniff(b"", 0)
