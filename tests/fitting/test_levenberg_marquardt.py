"""The solver for few unknowns: against optimistix's own, and where steps have nowhere to go."""

import jax
import jax.numpy as jnp
import optimistix as optx

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


def test_a_batch_is_each_by_itself():
    starts = jnp.asarray([0.1, 3.0, 20.0], DTYPE)
    found = jax.vmap(lambda start: minimise(lambda y, _: jnp.log(y), start).value)(starts)
    one_by_one = jnp.stack([minimise(lambda y, _: jnp.log(y), start).value for start in starts])
    assert_close(found, one_by_one)
