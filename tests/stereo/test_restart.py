"""A second start: the best of all nodes, and the better of two minima."""

import jax.numpy as jnp
import numpy as np

import hshjax
from hshjax.stereo._chart import from_chart
from hshjax.stereo._misfit import CUT, misfit
from hshjax.stereo._refine import weigh
from hshjax.stereo._restart import refine_from_both
from hshjax.stereo._result import angular_errors
from hshjax.stereo._shading import shading_table
from tests.stereo.cases import directions

SIZE = 65


def pixels(count=40, seed=0):
    rng = np.random.default_rng(seed)
    table = shading_table((hshjax.Lambert(1.0), hshjax.GGX(1.0, 0.3)), jnp.asarray(directions(30, tilt=1.0)), SIZE)
    radius, angle = 0.5 * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    pq = jnp.asarray(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1), jnp.float32)
    weights = jnp.asarray(rng.uniform(0.2, 1, (count, 2)), jnp.float32)
    values = jnp.sum(weights[..., None] * table.at(pq), axis=1)
    return table, pq, values / jnp.max(values, axis=1, keepdims=True)


def test_the_best_node_is_the_best_of_all_that_are_looked_at():
    """Every node tried one by one, by the solver of weights."""
    table, _, values = pixels(12)
    trust = jnp.ones_like(values)
    found = table.best_node(values, trust)
    least = weigh(table.at(found), values, trust)[1]
    axis = (np.arange(SIZE)[SIZE // 2 % 6 :: 6] - SIZE // 2) / (SIZE // 2)
    for p in axis:
        for q in axis:
            if np.hypot(p, q) <= 0.99:
                here = jnp.broadcast_to(jnp.asarray([p, q], jnp.float32), (12, 2))
                assert np.all(least <= weigh(table.at(here), values, trust)[1] + 1e-5)


def test_the_number_of_pixels_is_free():
    table, _, values = pixels(700)
    trust = jnp.ones_like(values)
    np.testing.assert_array_equal(table.best_node(values, trust)[:3], table.best_node(values[:3], trust[:3]))
    assert table.best_node(values[:0], trust[:0]).shape == (0, 2)


def test_a_start_far_off_does_not_matter():
    table, pq, values = pixels()
    far = -pq + 0.3
    found = refine_from_both(table, values, jnp.ones_like(values), far, 3, 8)
    errors = angular_errors(from_chart(found), from_chart(pq))
    assert np.mean(errors < 0.2) > 0.9


def test_a_good_start_is_kept():
    """Values that leave two minima alike: the one that was given stays, and what fits no worse is not given up."""
    table, pq, values = pixels()
    trust = jnp.ones_like(values)
    found = refine_from_both(table, values, trust, pq, 3, 8)
    scale = jnp.full((len(pq), 1), 0.02, jnp.float32)
    assert np.all(misfit(table, values, trust, scale, found) <= misfit(table, values, trust, scale, pq) + 1e-4)


def test_no_value_costs_more_than_the_cut():
    table, pq, values = pixels()
    trust = jnp.ones_like(values)
    broken = values.at[:, :5].add(100.0)
    scale = jnp.full((len(pq), 1), 0.02, jnp.float32)
    cost = misfit(table, broken, trust, scale, pq)
    assert np.all(cost <= CUT * 30 / 30 + 1e-6)
