"""Normals of pixels: the minimum is found, and steps are those of the cost."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np

import hshjax
from hshjax.stereo._chart import from_chart, to_chart
from hshjax.stereo._refine import normal_equations, predicted, refine, weigh
from hshjax.stereo._result import angular_errors
from hshjax.stereo._shading import shading_table
from tests.stereo.cases import directions

TABLE_OF = (hshjax.Lambert(1.0), hshjax.GGX(1.0, 0.4))


def pixels(count=60, seed=3):
    """Normals up to 60 degrees from the view, weights of both materials, and their values from the table itself."""
    rng = np.random.default_rng(seed)
    table = shading_table(TABLE_OF, jnp.asarray(directions()), 65)
    radius, angle = 0.55 * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    pq = jnp.asarray(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1), jnp.float32)
    weights = jnp.asarray(rng.uniform(0.2, 1, (count, 2)) * [1, 0.1], jnp.float32)
    return table, pq, weights, jnp.sum(weights[..., None] * table.at(pq), axis=1)


def test_exact_values_give_the_normals_back():
    table, pq, weights, values = pixels()
    near = pq + 0.05 * jnp.asarray(np.random.default_rng(0).normal(size=pq.shape), jnp.float32)
    found = refine(table, values, jnp.ones_like(values), near, 20)
    errors = angular_errors(from_chart(found.pq), from_chart(pq))
    assert np.median(errors) < 0.01
    assert np.mean(errors < 0.1) > 0.9
    good = errors < 0.05
    np.testing.assert_allclose(found.weights[good], weights[good], atol=0.01)
    np.testing.assert_allclose(predicted(table, found)[good], values[good], atol=2e-3)


def test_the_cost_never_rises():
    table, pq, _, values = pixels()
    noisy = values + 0.003 * jnp.asarray(np.random.default_rng(1).normal(size=values.shape), jnp.float32)
    costs = [np.asarray(refine(table, noisy, jnp.ones_like(values), pq * 0.7, steps).cost) for steps in (0, 1, 3, 8)]
    for before, after in itertools.pairwise(costs):
        assert np.all(after <= before)
    assert np.mean(costs[-1]) < 0.5 * np.mean(costs[0])


def test_the_gradient_is_that_of_the_projected_cost():
    """-g of the normal equations is half the gradient of the cost with weights projected out, by differences."""
    table, pq, _, values = pixels(40)
    values = values + 0.05 * jnp.asarray(np.random.default_rng(2).normal(size=values.shape), jnp.float32)
    trust = jnp.asarray(np.random.default_rng(4).uniform(0.2, 1, values.shape), jnp.float32)
    at = pq * 0.9
    shading, slope = table.with_slope(at)
    weights, _ = weigh(shading, values, trust)
    residual = values - jnp.sum(weights[..., None] * shading, axis=1)
    _, gradient = normal_equations(shading, slope, weights, residual, trust)
    expected = jax.jvp(lambda x: weigh(table.at(x), values, trust)[1], (at,), (jnp.ones_like(at),))[1]
    np.testing.assert_allclose(-2 * jnp.sum(gradient, axis=1), expected, rtol=2e-2, atol=2e-3)


def test_values_without_trust_do_not_count():
    table, pq, _, values = pixels(20)
    broken = values.at[:, ::4].set(50.0)
    trust = jnp.ones_like(values).at[:, ::4].set(0)
    found, clean = refine(table, broken, trust, pq * 0.9, 15), refine(table, values, trust, pq * 0.9, 15)
    np.testing.assert_allclose(found.pq, clean.pq, atol=1e-5)


def test_pixels_of_which_nothing_is_known_stay():
    table, pq, _, values = pixels(4)
    found = refine(table, values, jnp.zeros_like(values), pq, 5)
    np.testing.assert_array_equal(found.pq, pq)
    assert np.all(np.asarray(found.weights) == 0)
    assert np.all(np.asarray(found.cost) == 0)


def test_the_chart_has_no_direction_of_its_own():
    """A pixel whose normal is the view is solved like any other."""
    table, *_ = pixels(1)
    pole = to_chart(jnp.asarray([[0, 0, 1]], jnp.float32))
    values = 0.5 * table.at(pole)[:, 0]
    found = refine(table, values, jnp.ones_like(values), jnp.full((1, 2), 0.08, jnp.float32), 20)
    assert angular_errors(from_chart(found.pq), from_chart(pole))[0] < 0.02
