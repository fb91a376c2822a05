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
