"""Which unknowns a least-squares problem can do without: against all subsets, and where the answer is known."""

from itertools import combinations

import numpy as np
import pytest

from hshjax.fitting._eliminate import eliminate


def problem(samples, unknowns, seed=0):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(samples, unknowns)) @ (np.eye(unknowns) + 0.3 * rng.normal(size=(unknowns, unknowns)))
    return rows, rng.normal(size=samples)


def misfit(rows, target, kept):
    return np.linalg.lstsq(rows[:, kept], target, rcond=None)[1][0]


def test_values_are_those_of_least_squares():
    rows, target = problem(60, 12)
    for count in (12, 7, 1):
        kept, value = eliminate(rows.T @ rows, rows.T @ target, count, ridge=1e-14)
        assert kept.size == count
        assert np.all(np.diff(kept) > 0)
        np.testing.assert_allclose(value, np.linalg.lstsq(rows[:, kept], target, rcond=None)[0], rtol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_one_that_leaves_is_the_best_to_leave(seed):
    """The cost of one absence is exact: no other subset of all but one fits better."""
    rows, target = problem(40, 9, seed)
    kept, _ = eliminate(rows.T @ rows, rows.T @ target, 8, ridge=1e-14)
    best = min(combinations(range(9), 8), key=lambda some: misfit(rows, target, list(some)))
    np.testing.assert_array_equal(kept, best)


def test_what_is_not_there_leaves_first():
    """Six of thirty explain the target: they stay, whatever the scales of the columns are."""
    rows, _ = problem(200, 30)
    rows *= np.logspace(-3, 3, 30)
    true = np.array([1, 4, 11, 17, 22, 29])
    target = rows[:, true] @ (1 / np.logspace(-3, 3, 30)[true])
    kept, value = eliminate(rows.T @ rows, rows.T @ target, 6, ridge=1e-13)
    np.testing.assert_array_equal(kept, true)
    np.testing.assert_allclose(value, 1 / np.logspace(-3, 3, 30)[true], rtol=1e-6)


def test_singular_equations_are_held_by_the_ridge():
    """Fewer samples than unknowns, and a function that is 0 everywhere."""
    rows, target = problem(5, 9)
    rows[:, 3] = 0
    kept, value = eliminate(rows.T @ rows, rows.T @ target, 4, ridge=1e-6)
    assert 3 not in kept
    assert np.all(np.isfinite(value))


def test_what_is_needed_stays():
    """Though it explains nothing."""
    rows, target = problem(50, 8)
    matrix, moment = rows.T @ rows, rows.T @ target
    moment[0] = 0
    kept, _ = eliminate(matrix, moment, 1, ridge=1e-14, needed=1)
    np.testing.assert_array_equal(kept, [0])
