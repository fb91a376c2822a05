"""Tables over the angles of both directions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from hshjax.brdfs import AngleTable
from hshjax.geometry import angles
from hshjax.io import load_model, save_model
from tests.helpers import DTYPE, X64, assert_close, directions

THETA_I, PHI_I = np.array([0.1, 0.5, 1.2]), np.array([0.3, 1.0, 4.0, 6.0])
THETA_O, PHI_O = np.array([0, 0.4, 0.9, np.pi / 2]), np.array([0, 2.5])


def table(measured=None, channels=2):
    shape = (THETA_I.size, PHI_I.size, THETA_O.size, PHI_O.size)
    values = np.random.default_rng(0).uniform(0.1, 1, (*shape, channels))
    arrays = (jnp.asarray(part, DTYPE) for part in (values, THETA_I, PHI_I, THETA_O, PHI_O))
    return AngleTable(*arrays, channel_names=tuple("RGB"[:channels]), measured=measured)


def test_between_the_nodes():
    """scipy's multilinear interpolation; the period is closed by one more node before and one after."""
    brdf, wi, wo = table(), directions(0, 300, min_z=0.05), directions(1, 300, min_z=0.05)
    values = np.asarray(brdf.values, np.float64)
    for axis in (1, 3):
        values = np.concatenate([values.take([-1], axis), values, values.take([0], axis)], axis)
    closed = [np.r_[phi[-1] - 2 * np.pi, phi, phi[0] + 2 * np.pi] for phi in (PHI_I, PHI_O)]
    (theta_i, phi_i), (theta_o, phi_o) = ((np.asarray(a, np.float64) for a in angles(w)) for w in (wi, wo))
    points = np.clip(theta_i, 0.1, 1.2), phi_i % (2 * np.pi), np.clip(theta_o, 0, np.pi / 2), phi_o % (2 * np.pi)
    expected = RegularGridInterpolator((THETA_I, closed[0], THETA_O, closed[1]), values)(np.stack(points, -1))
    assert_close(brdf(wi, wo), expected, tolerance=1e-9 if X64 else 1e-4)


def test_measured_nodes_share_the_weight_of_the_others():
    there = np.random.default_rng(1).random((3, 4, 4, 2)) < 0.7
    brdf, whole = table(jnp.asarray(there)), table()
    one = AngleTable(
        jnp.asarray(there[..., None], DTYPE), whole.theta_i, whole.phi_i, whole.theta_o, whole.phi_o,
        channel_names=("Y",),
    )  # fmt: skip
    held = jnp.where(jnp.asarray(there)[..., None], whole.values, 0)
    numerator = AngleTable(held, whole.theta_i, whole.phi_i, whole.theta_o, whole.phi_o, channel_names=("R", "G"))
    wi, wo = directions(2, 200, min_z=0.05), directions(3, 200, min_z=0.05)
    share = np.asarray(one(wi, wo))
    expected = np.where(share > 0, np.asarray(numerator(wi, wo)) / np.where(share > 0, share, 1), 0)
    assert_close(brdf(wi, wo), expected, tolerance=1e-8 if X64 else 1e-3)
    assert share.min() < 1


def test_node_samples():
    brdf = table()
    samples = brdf.node_samples()
    assert samples.size == 3 * 4 * 3 * 2  # without the horizon
    assert not samples.isotropic
    k = 2 + 2 * 1 + 6 * 3  # first elevation, last azimuth; second elevation of the three, first azimuth
    assert_close(samples.value[k], brdf.values[0, 3, 2, 0])
    # Cells of wi cover the hemisphere down to 1.2 + 0.35 radians; those of wo down to the middle of the last step.
    lowest = np.cos(1.2 + 0.35), np.cos((0.9 + np.pi / 2) / 2)
    assert_close(jnp.sum(samples.weight), (2 * np.pi) ** 2 * (1 - lowest[0]) * (1 - lowest[1]), tolerance=1e-6)
    some = table(jnp.zeros((3, 4, 4, 2), bool).at[0, 0, 0, 0].set(True)).node_samples()
    assert some.size == 1


def test_finite_derivatives_at_the_normal():
    brdf = table()
    pole, tilted = jnp.asarray([0, 0, 1], DTYPE), directions(4, 1, min_z=0.3)[0]
    for wi, wo in ((pole, tilted), (tilted, pole), (pole, pole)):
        for gradient in jax.jacobian(lambda *w: brdf(*w), (0, 1))(wi, wo):
            assert np.all(np.isfinite(gradient))


def test_saved_and_loaded(tmp_path):
    brdf = table(jnp.ones((3, 4, 4, 2), bool))
    save_model(tmp_path / "a.hshjax", brdf)
    loaded = load_model(tmp_path / "a.hshjax")
    assert np.array_equal(loaded.values, brdf.values)
    assert np.array_equal(loaded.measured, brdf.measured)


def test_what_is_refused(unchecked):
    whole = table()
    with pytest.raises(ValueError, match="values of a table must have shape"):
        AngleTable(whole.values[:2], whole.theta_i, whole.phi_i, whole.theta_o, whole.phi_o, channel_names=("R", "G"))
    with pytest.raises(ValueError, match="phi_o of a table must rise"):
        AngleTable(
            whole.values, whole.theta_i, whole.phi_i, whole.theta_o, jnp.asarray([0, 6.5], DTYPE),
            channel_names=("R", "G"),
        )  # fmt: skip
    with pytest.raises(ValueError, match="measured of a table"):
        table(jnp.ones((3, 4, 4, 1), bool))
