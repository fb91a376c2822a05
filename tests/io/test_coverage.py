"""Which angles samples have, of samples made for it."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.geometry import direction
from hshjax.io import coverage
from hshjax.samples import Samples


def samples(theta_i, phi_i, theta_o, phi_o, weight=None, isotropic=True):
    grid = np.meshgrid(*(np.atleast_1d(np.asarray(a, float)) for a in (theta_i, phi_i, theta_o, phi_o)))
    theta_i, phi_i, theta_o, phi_o = (jnp.radians(jnp.asarray(a.ravel())) for a in grid)
    wi, wo = direction(theta_i, phi_i), direction(theta_o, phi_o)
    return Samples.scattered(wi, wo, jnp.ones((theta_i.size, 1)), weight, isotropic=isotropic)


def test_a_grid():
    found = coverage(samples([10, 30, 70], 0, [5, 40, 80], np.arange(0, 360, 10)))
    np.testing.assert_allclose(found.theta_i, (10, 70), atol=1e-4)
    np.testing.assert_allclose(found.theta_o, (5, 80), atol=1e-4)
    np.testing.assert_allclose(found.azimuths, (0, 180), atol=1e-3)
    assert found.incidences == 3
    assert found.azimuth_span == pytest.approx(350, abs=1e-3)


def test_an_arc_about_the_light():
    """Azimuths that lie on both sides of 0 are one arc of 40 degrees, not 360."""
    found = coverage(samples(30, 45, [10, 20], [25, 35, 45, 55, 65]))
    np.testing.assert_allclose(found.azimuths, (0, 20), atol=1e-3)
    assert found.azimuth_span == pytest.approx(40, abs=1e-3)


def test_what_does_not_count():
    weight = jnp.asarray([1.0, 0.0, 1.0])
    found = coverage(samples(20, 0, [10, 60, 30], 90, weight))
    np.testing.assert_allclose(found.theta_o, (10, 30), atol=1e-4)
    with pytest.raises(ValueError, match="none of the 3 samples"):
        coverage(samples(20, 0, [10, 60, 30], 90, jnp.zeros(3)))


def test_at_the_normal_azimuths_mean_nothing():
    found = coverage(samples(0, [0, 90], [10, 60], [0, 45]))
    assert found.azimuths is None
    assert found.azimuth_span is None
    assert found.incidences == 1


def test_incidences_of_anisotropic_samples_differ_by_azimuth():
    assert coverage(samples([20, 40], [0, 90, 359.9999], 10, 0, isotropic=False)).incidences == 4
    assert coverage(samples([20, 40], [0, 90, 359.9999], 10, 0)).incidences == 2
