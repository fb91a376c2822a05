"""Where the study of error bars draws its samples, and how it counts."""

import numpy as np
import pytest
from scipy.stats import kstest

from experiments.recipes.compact_scattered import _share, angles_uniform, pairs_uniform
from tests.helpers import X64

pytestmark = pytest.mark.skipif(not X64, reason="studies choose their own precision")

FAR = np.cos(np.radians(80))


@pytest.mark.parametrize("draw", [pairs_uniform, angles_uniform])
def test_pairs_are_unit_and_below_80_degrees(draw):
    for w in draw(np.random.default_rng(0), 500):
        assert w.shape == (500, 3)
        np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1, rtol=1e-12)
        assert np.all(w[:, 2] > FAR)


def test_pairs_are_uniform_over_directions():
    for w in pairs_uniform(np.random.default_rng(1), 2000):
        assert kstest(w[:, 2], "uniform", (FAR, 1 - FAR)).pvalue > 1e-3
        assert kstest(np.arctan2(w[:, 1], w[:, 0]), "uniform", (-np.pi, 2 * np.pi)).pvalue > 1e-3


def test_angles_are_uniform_where_nothing_is_cut():
    """θ_h and θ_d below 35 degrees: both directions stay below 80."""
    wi, wo = angles_uniform(np.random.default_rng(2), 4000)
    total = wi + wo
    length = np.linalg.norm(total, axis=1)
    half, difference = np.arccos(np.minimum(total[:, 2] / length, 1)), np.arccos(np.minimum(length / 2, 1))
    limit = np.radians(35)
    kept = (half < limit) & (difference < limit)
    for angle in (half[kept], difference[kept]):
        assert kstest(angle, "uniform", (0, limit)).pvalue > 1e-3


def test_share_counts_channels():
    value = np.array([[0.0, 1.0], [2.0, 3.0]])
    assert _share(value, (value - np.array([1.0, 1.0]), value + np.array([1.0, -0.5]))) == 0.5
