"""UTIA files: their layout, and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.geometry import direction
from hshjax.io import measured_utia, read_utia, utia
from tests.helpers import DTYPE, X64, assert_close
from tests.io.hostile_binary import placed_variants, refused, sparse, written

SIZE = 3 * 288 * 288 * 8


def planes(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 1, (3, 288, 288))


def value(brdf, *degrees):
    theta_i, phi_i, theta_o, phi_o = (jnp.asarray(np.radians(x), DTYPE) for x in degrees)
    return brdf(direction(theta_i, phi_i), direction(theta_o, phi_o))


@pytest.fixture
def path(tmp_path):
    return written(tmp_path / "a.bin", planes().astype("<f8").tobytes())


def test_layout(path):
    brdf, found = measured_utia(path)
    assert (found.entries, found.negative, found.units) == (288 * 288, 0, "not declared: taken as sr^-1")
    # 30 and 60 degrees are rows 2 and 4 of 48 azimuths, 45 and 352.5 degrees azimuths 6 and 47.
    assert_close(value(brdf, 30, 45, 60, 352.5), planes()[:, 2 * 48 + 6, 4 * 48 + 47], tolerance=1e-9 if X64 else 1e-4)
    assert_close(value(brdf, 60, 352.5, 30, 45), planes()[:, 4 * 48 + 47, 2 * 48 + 6], tolerance=1e-9 if X64 else 1e-4)


def test_beyond_the_last_elevation_the_nearest_holds(path):
    brdf = read_utia(path)
    assert_close(value(brdf, 85, 15, 30, 0), value(brdf, 75, 15, 30, 0), tolerance=1e-9 if X64 else 1e-4)


def test_negative_values(tmp_path):
    changed = planes()
    changed[1, 5 * 48, 3] = -0.25
    path = written(tmp_path / "a.bin", changed.astype("<f8").tobytes())
    kept, found = measured_utia(path)
    assert found.negative == 1
    assert float(kept.values[5, 0, 0, 3, 1]) == -0.25
    assert float(read_utia(path, negatives="clip").values.min()) == 0
    masked, found = measured_utia(path, negatives="mask")
    assert found.masked == {"a negative value": 1}
    assert masked.node_samples().size == 288 * 288 - 1
    # Its neighbours take its share; θ_o is the normal, where φ counts as 0.
    assert_close(
        value(masked, 75, 3.75, 0, 0), changed[:, [5 * 48, 5 * 48 + 1], 0].mean(1), tolerance=1e-9 if X64 else 1e-4
    )


def test_hostile_files_are_read_or_refused(path):
    content = path.read_bytes()
    variants = placed_variants(content, numbers=(0, SIZE - 8), flips=24)
    del variants["zeros"]  # which are values like others
    for name, changed in variants.items():
        error = refused(read_utia, written(path, changed))
        if not name.startswith("bit"):
            assert error is not None, name
    assert f"byte {SIZE - 8}, value {SIZE // 8 - 1}" in str(
        refused(read_utia, written(path, variants[f"nan at byte {SIZE - 8}"]))
    )
    swapped = refused(read_utia, written(path, planes().astype(">f8").tobytes()))
    assert swapped is not None
    assert "finite" in str(swapped) or "another byte order" in str(swapped)


def test_gigabytes_of_nothing_and_directories(tmp_path):
    assert str(SIZE) in str(refused(read_utia, sparse(tmp_path / "a.bin", b"")))
    with pytest.raises(IsADirectoryError):
        read_utia(tmp_path)


def test_sniff(path):
    head = path.read_bytes()[:64]
    assert utia.sniff(head, SIZE)
    assert not utia.sniff(head, SIZE - 8)
    assert not utia.sniff(b"\xff" * 64, SIZE)
