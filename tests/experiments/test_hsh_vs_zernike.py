"""The derived statements of docs/hsh_vs_zernike.md, each held against numbers."""

import os
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax import HSH, SHR, SphericalHarmonics, Zernike, direction, hemisphere_rule

pytestmark = pytest.mark.skipif(
    os.environ.get("HSHJAX_TEST_DTYPE") == "float32", reason="errors down to 1e-13: a matter of float64"
)


@lru_cache
def _nodes():
    return hemisphere_rule(80, sqrt=True)


@lru_cache
def _rows(basis):
    return np.asarray(jax.jit(lambda w: basis(w))(_nodes().w))


def _error(basis, k: int, order: int) -> float:
    """Relative L2 error of the projection of z^k exp(2 a·w) on the functions up to `order`."""
    weight, w = np.asarray(_nodes().weight), np.asarray(_nodes().w)
    values = w[:, 2] ** k * np.exp(2 * w @ np.array([0.6, 0.0, 0.8]))
    rows = _rows(basis)[:, np.array(basis.modes)[:, 0] <= order]
    fit = rows @ (rows.T @ (weight * values))
    return float(np.sqrt(np.sum(weight * (values - fit) ** 2) / np.sum(weight * values**2)))


def test_even_hsh_lie_in_zernike_of_twice_the_order_and_odd_ones_do_not():
    hsh, zernike = _rows(HSH(3)), _rows(Zernike(6))
    inner = zernike.T @ (np.asarray(_nodes().weight)[:, None] * hsh)
    outside = 1 - np.sum(inner**2, axis=0)
    even = np.array(HSH(3).modes)[:, 1] % 2 == 0
    assert np.max(np.abs(outside[even])) < 1e-12
    assert np.min(outside[~even]) > 1e-4


@pytest.mark.parametrize("m", [1, 2, 3])
def test_hsh_vanish_on_the_horizon_like_a_power_and_the_others_do_not(m):
    z = np.array([1e-4, 1e-6])
    w = direction(jnp.asarray(np.arccos(z)), jnp.zeros(2))

    def values(basis):
        return np.abs(np.asarray(basis(w))[:, basis.modes.index((5, m) if m % 2 else (4, m))])

    near, nearer = values(HSH(5))
    # The exponent is that of the leading term; the next one is of relative size z.
    assert np.log(near / nearer) / np.log(z[0] / z[1]) == pytest.approx(m / 2, abs=2e-3)
    assert values(SHR(5))[1] > 0.1
    assert values(Zernike(5))[1] > 0.1


# Slopes between two finite orders: 15 % of the asymptotic rate is what they are off by.
@pytest.mark.parametrize("k", [0, 1, 3])
def test_rates_at_the_horizon(k):
    def rate(basis):
        return np.log(_error(basis, k, 16) / _error(basis, k, 24)) / np.log(24 / 16)

    assert rate(HSH(24)) == pytest.approx(2 * k + 1, rel=0.15)
    assert rate(SphericalHarmonics(24)) == pytest.approx(k + 0.5, rel=0.15)


def test_zernike_and_shr_converge_spectrally_on_smooth_functions():
    assert _error(SHR(16), 0, 16) < 1e-11
    assert _error(Zernike(24), 0, 24) < 1e-11
    assert _error(HSH(24), 0, 24) > 1e-3


def test_counts_at_equal_order():
    for n in range(10):
        assert len(HSH(n).modes) == len(SHR(n).modes) == (n + 1) ** 2
        assert len(Zernike(n).modes) == (n + 1) * (n + 2) // 2
        assert sum(m >= 0 for _, m in HSH(n).modes) == (n + 1) * (n + 2) // 2
        assert sum(m >= 0 for _, m in Zernike(n).modes) == (n // 2 + 1) * ((n + 1) // 2 + 1)
