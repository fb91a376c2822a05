"""The solver for few unknowns: against optimistix's own, and where steps have nowhere to go."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import lsq_linear

from hshjax.fitting import LevenbergMarquardt
from tests.helpers import DTYPE, X64, assert_close

FINE = 1e-10 if X64 else 1e-5
SOLVER = LevenbergMarquardt(FINE, FINE)


def minimise(residuals, start, max_steps=200):
    return optx.least_squares(residuals, SOLVER, start, max_steps=max_steps, throw=False)


def rosenbrock(y, _):
    return {"valley": 10 * (y["b"] - y["a"] ** 2), "far": 1 - y["a"]}


def test_a_curved_valley():
    """Rosenbrock's function from its customary start; residuals and unknowns are pytrees."""
    found = minimise(rosenbrock, {"a": jnp.asarray(-1.2, DTYPE), "b": jnp.asarray(1.0, DTYPE)})
    assert found.result == optx.RESULTS.successful
    # In float32 the loss, flat to 6e-8 of itself, leaves the end of the valley to a hundredth.
    assert_close(found.value["a"], 1.0, tolerance=1e-8 if X64 else 1e-2)
    assert_close(found.value["b"], 1.0, tolerance=1e-8 if X64 else 2e-2)


def test_an_optimum_with_residuals_left():
    """A decay fitted to noise: no solver sees but the gradient, and both end where it vanishes."""
    x = jnp.linspace(0, 3, 200, dtype=DTYPE)
    data = 2 * jnp.exp(-1.3 * x) + 0.1 * jnp.sin(37 * x)

    def residuals(y, _):
        return y[0] * jnp.exp(-y[1] * x) - data

    start = jnp.asarray([1.0, 0.5], DTYPE)
    theirs = optx.least_squares(residuals, optx.LevenbergMarquardt(FINE, FINE), start, throw=X64)
    assert_close(minimise(residuals, start).value, theirs.value, tolerance=1e-7 if X64 else 1e-3)


def test_an_unknown_without_effect_stays():
    found = minimise(lambda y, _: jnp.stack([y[0] - 3, 0 * y[1]]), jnp.asarray([1.0, 7.0], DTYPE))
    assert found.result == optx.RESULTS.successful
    assert_close(found.value, jnp.asarray([3.0, 7.0]), tolerance=1e-6 if X64 else 1e-3)


def test_a_step_where_the_residual_has_no_value_is_not_taken():
    """log(y) from far above its root: the first Gauss-Newton step, y (1 - log y), is negative."""
    found = minimise(lambda y, _: jnp.log(y), jnp.asarray(20.0, DTYPE))
    assert found.result == optx.RESULTS.successful
    assert_close(found.value, 1.0, tolerance=1e-8 if X64 else 1e-3)


def test_a_start_without_a_value_ends_at_once():
    found = minimise(lambda y, _: jnp.log(y), jnp.asarray(-1.0, DTYPE))
    assert found.result == optx.RESULTS.nonfinite
    assert found.stats["num_steps"] <= 2


def test_steps_that_are_rounding_are_the_end():
    """The optimum is 0, the loss is not: no step is small beside the unknown."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=3000)
    rest = rng.normal(size=3000)
    rest -= x * (x @ rest) / (x @ x)
    x, rest = jnp.asarray(x, DTYPE), jnp.asarray(2 * rest, DTYPE)
    solver = LevenbergMarquardt(1e-8 if X64 else 1e-4, 1e-16 if X64 else 1e-8)
    for start in (0.1, 1.0, 3.0, 10.0):
        found = optx.least_squares(lambda y, _: x * y - rest, solver, jnp.asarray(start, DTYPE), throw=False)
        assert found.result == optx.RESULTS.successful
        assert found.stats["num_steps"] < 30
        assert_close(found.value, 0, tolerance=1e-10 if X64 else 1e-4)


# --- boxes ------------------------------------------------------------------------------------------------------------


def minimise_in(residuals, start, lower, upper, max_steps=200):
    options = {"lower": jnp.full_like(start, lower), "upper": jnp.full_like(start, upper)}
    return optx.least_squares(residuals, SOLVER, start, options=options, max_steps=max_steps, throw=False)


@pytest.mark.parametrize("seed", [0, 2, 3, 4])
def test_linear_problems_in_a_box_against_scipy(seed):
    rng = np.random.default_rng(seed)
    matrix, data = rng.normal(size=(40, 6)), rng.normal(size=40)
    expected = lsq_linear(matrix, data, (-0.1, 0.15), tol=1e-14)
    assert 0 < np.count_nonzero(expected.active_mask) < 6
    a, b = jnp.asarray(matrix, DTYPE), jnp.asarray(data, DTYPE)
    start = jnp.asarray(rng.uniform(-0.1, 0.15, 6), DTYPE)
    found = minimise_in(lambda y, _: jnp.matmul(a, y, precision="highest") - b, start, -0.1, 0.15)
    assert found.result == optx.RESULTS.successful
    assert_close(found.value, expected.x, tolerance=1e-8 if X64 else 1e-3)
    on_bound = (found.value == jnp.asarray(-0.1, DTYPE)) | (found.value == jnp.asarray(0.15, DTYPE))
    np.testing.assert_array_equal(on_bound, expected.active_mask != 0)
    # The damping falls tenfold a step: a dozen to 1e-10, and a few for the bounds to be found.
    assert found.stats["num_steps"] < 25


def test_a_curved_valley_in_a_box():
    """Rosenbrock's function with x <= 1/2: the minimum on the bound is at (1/2, 1/4)."""

    def residuals(y, _):
        return jnp.stack([10 * (y[1] - y[0] ** 2), 1 - y[0]])

    start = jnp.asarray([-1.2, 1.0], DTYPE)
    options = {"lower": jnp.asarray([-2, -2], DTYPE), "upper": jnp.asarray([0.5, 2], DTYPE)}
    found = optx.least_squares(residuals, SOLVER, start, options=options, max_steps=60, throw=False)
    assert found.result == optx.RESULTS.successful
    assert_close(found.value, [0.5, 0.25], tolerance=1e-8 if X64 else 1e-4)


def test_a_start_in_a_corner_comes_away_from_it():
    target = jnp.asarray([0.3, 0.6, 2.0], DTYPE)
    found = minimise_in(lambda y, _: y - target, jnp.asarray([0, 1, 1], DTYPE), 0.0, 1.0)
    assert found.result == optx.RESULTS.successful
    assert_close(found.value, [0.3, 0.6, 1.0], tolerance=1e-8 if X64 else 1e-4)


def test_no_residual_is_taken_outside_of_the_box():
    """sqrt(y) has no value below 0, where the first Gauss-Newton step would lead."""
    found = minimise_in(lambda y, _: jnp.sqrt(y) - 1, jnp.asarray([9.0], DTYPE), 0.04, 10.0)
    assert found.result == optx.RESULTS.successful
    assert_close(found.value, [1.0], tolerance=1e-8 if X64 else 1e-3)


# --- batches ----------------------------------------------------------------------------------------------------------


def test_a_batch_is_each_by_itself():
    starts = jnp.asarray([0.1, 3.0, 20.0], DTYPE)
    found = jax.vmap(lambda start: minimise(lambda y, _: jnp.log(y), start).value)(starts)
    one_by_one = jnp.stack([minimise(lambda y, _: jnp.log(y), start).value for start in starts])
    assert_close(found, one_by_one)
