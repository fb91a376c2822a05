"""Normals handed on: who is whose neighbour, and that a wrong minimum is left for a neighbour's right one."""

import jax.numpy as jnp
import numpy as np

import hshjax
from hshjax.stereo._chart import from_chart
from hshjax.stereo._propagate import neighbours, take_over
from hshjax.stereo._result import angular_errors
from hshjax.stereo._shading import shading_table
from hshjax.stereo._trust import initial_trust
from tests.stereo.cases import directions


def test_neighbours_are_those_beside_a_pixel():
    mask = np.array([[1, 1, 0], [0, 1, 1]], bool)
    around = neighbours(mask)
    assert [sorted(row[row >= 0].tolist()) for row in around] == [[1, 2], [0, 2, 3], [0, 1, 3], [1, 2]]


def test_neighbours_at_a_distance():
    around = neighbours(np.ones((5, 5), bool), 2)
    assert sorted(around[12][around[12] >= 0].tolist()) == [0, 2, 4, 10, 14, 20, 22, 24]
    assert sorted(around[0][around[0] >= 0].tolist()) == [2, 10, 12]


def test_no_neighbour_is_beyond_a_small_mask():
    assert np.all(neighbours(np.ones((1, 1), bool), 16) == -1)


def setup(count=30):
    rng = np.random.default_rng(0)
    table = shading_table((hshjax.Lambert(1.0),), jnp.asarray(directions()), 65)
    right = jnp.asarray(rng.uniform(-0.3, 0.3, (count, 2)), jnp.float32)
    values = table.at(right)[:, 0] * 0.7
    values = values / jnp.quantile(values, 0.9, axis=1, keepdims=True)
    wrong = -right + 0.2
    trust = initial_trust(values, jnp.ones_like(values))
    return table, right, wrong, values, trust, jnp.full((count, 1), 0.02, jnp.float32)


def run(smoothness, own, near, far, there=None):
    table, _, _, values, trust, scale = setup()
    there = jnp.ones(near.shape[:2], bool) if there is None else there
    return take_over(table, values, trust, scale, own, near, far, there, jnp.asarray(smoothness, jnp.float32))


def many(pq):
    return jnp.repeat(pq[:, None], 8, axis=1)


def test_a_right_normal_is_taken_over_from_near_and_from_far():
    _, right, wrong, *_ = setup()
    for near, far in ((many(right), many(wrong)), (many(wrong), many(right))):
        found = run(0.0, wrong, near, far)
        assert np.max(angular_errors(from_chart(found), from_chart(right))) < 0.5


def test_a_right_normal_is_kept_among_wrong_ones():
    _, right, wrong, *_ = setup()
    np.testing.assert_array_equal(run(0.0, right, many(wrong), many(wrong)), right)


def test_agreement_wins_where_it_counts_much():
    _, right, wrong, *_ = setup()
    found = run(10.0, right, many(wrong), many(wrong))
    assert np.max(angular_errors(from_chart(found), from_chart(wrong))) < 1e-3


def test_neighbours_that_do_not_exist_do_not_count():
    _, right, wrong, *_ = setup()
    nobody = jnp.zeros((len(right), 8), bool)
    np.testing.assert_array_equal(run(10.0, right, many(wrong), many(right), nobody), right)
