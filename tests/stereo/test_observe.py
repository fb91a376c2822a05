"""What photometric stereo looks at: pixels of which nothing is known are no part of what is learned."""

import numpy as np

from hshjax.stereo import angular_errors, solve_calibrated
from hshjax.stereo._observe import Observations
from tests.stereo.cases import ball, changed


def test_most_pixels_may_be_unknown():
    """They leave no residual, and would fit best of all: the shared unknowns were not numbers, learned from none."""
    photographs = ball()
    values = photographs.values.copy()
    blind = np.arange(len(values)) % 5 > 1
    values[blind] = np.nan
    some = changed(photographs, values)
    np.testing.assert_array_equal(Observations(some).seen, ~blind)
    found = solve_calibrated(some, pixels=200, rounds=3, sweeps=1)
    assert np.isfinite(found.stray)
    assert np.median(angular_errors(found.normals, photographs.truth)[~blind]) < 1.5


def test_pixels_to_learn_from_are_seen_and_each_once():
    photographs = ball(size=12, lights=6)
    values = photographs.values.copy()
    values[:40] = np.nan
    found = Observations(changed(photographs, values)).some(1000, np.random.default_rng(0))
    np.testing.assert_array_equal(found, np.arange(40, photographs.pixels))
    assert len(Observations(photographs).some(7, np.random.default_rng(0))) == 7
