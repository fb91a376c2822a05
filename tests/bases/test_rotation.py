"""Rotated series in spherical harmonics against the functions themselves, rotated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

from hshjax.bases import SphericalHarmonics
from hshjax.bases._rotation import OBLIQUE, quarter_turn, rotated, series_turned_by, turn_by
from hshjax.geometry import frame
from tests.helpers import DTYPE, X64, assert_close

TURNS = {
    "any": Rotation.from_rotvec([0.4, -1.2, 0.7]).as_matrix(),
    "none": np.eye(3),
    "upside down": np.diag([1.0, -1, -1]),
    "about z": Rotation.from_rotvec([0, 0, 2.0]).as_matrix(),
    "to where the poles are turned": turn_by(OBLIQUE).T,
}


def series(order):
    return jnp.asarray(np.random.default_rng(order).normal(size=((order + 1) ** 2, 2)), DTYPE)


def sphere_directions(n=30):
    w = np.random.default_rng(0).normal(size=(n, 3))
    return w / np.linalg.norm(w, axis=-1, keepdims=True)


@pytest.mark.parametrize("name", TURNS)
@pytest.mark.parametrize("order", [0, 1, 6])
def test_the_rotated_series_is_the_rotated_function(order, name):
    basis, turn, w = SphericalHarmonics(order), TURNS[name], sphere_directions()
    expected = basis.evaluate(series(order), jnp.asarray(w @ turn, DTYPE))  # turnᵀ w
    found = rotated(order, series(order), jnp.asarray(turn, DTYPE))
    assert_close(basis.evaluate(found, jnp.asarray(w, DTYPE)), expected, tolerance=None if X64 else 1e-4)


@pytest.mark.parametrize(
    ("turn", "message"),
    [(np.diag([1.0, 1, -1]), "determinant 1"), (2 * np.eye(3), "orthonormal"), (np.ones((2, 3, 3)), r"\(2, 3, 3\)")],
    ids=["a reflection", "a scale", "two"],
)
def test_refusals(turn, message, unchecked):
    with pytest.raises(ValueError, match=message):
        rotated(1, series(1), jnp.asarray(turn, DTYPE))


def test_a_turn_and_its_series():
    """Against scipy's rotations."""
    omega = (0.3, -0.8, 1.9)
    assert_close(turn_by(np.array(omega)), Rotation.from_rotvec(omega).as_matrix())
    basis, w = SphericalHarmonics(5), sphere_directions()
    rows, turned = (np.asarray(basis(jnp.asarray(x, DTYPE))) for x in (w, w @ turn_by(np.array(omega)).T))
    assert_close(rows @ series_turned_by(5, omega), turned, tolerance=1e-10 if X64 else 1e-4)


def test_high_orders_stay_orthogonal():
    j = quarter_turn(40)
    assert np.abs(j @ j.T - np.eye(j.shape[0])).max() < 1e-13


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="differences in float64")
@pytest.mark.parametrize("w", [[0, 0, 1.0], [0, 0, -1.0], [0.6, 0.0, 0.8]])
def test_derivatives_by_the_frame(w):
    """At the poles as anywhere: through all frames that follow a direction, and of second order."""

    @jax.jit
    def turned(c, x):
        return rotated(2, c, frame(x / jnp.linalg.norm(x)))

    def follow(*arguments):
        return turned(*map(jnp.asarray, arguments))

    check_grads(follow, (series(2), jnp.asarray(w)), order=2, modes=("fwd", "rev"), rtol=1e-5, atol=1e-5)


def test_rotated_under_vmap():
    turns = jnp.asarray(np.stack([TURNS["any"], TURNS["about z"]]), DTYPE)
    together = jax.vmap(lambda turn: rotated(4, series(4), turn))(turns)
    assert_close(together, jnp.stack([rotated(4, series(4), turn) for turn in turns]))
