"""Shading tables against the reflectance equation itself; the chart of normals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax.stereo._chart import RIM, from_chart, grid, to_chart
from hshjax.stereo._columns import column_brdfs, combined, default_columns, first_guess
from hshjax.stereo._shading import shading_table
from tests.helpers import DTYPE


def lights(count=5):
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(count, 3)) + np.array([0, 0, 3])
    return jnp.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True), DTYPE)


def some_chart_points(count=200, reach=0.9):
    rng = np.random.default_rng(1)
    radius, angle = reach * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    return jnp.asarray(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1), DTYPE)


def test_the_chart_is_its_own_inverse():
    pq = some_chart_points()
    normals = from_chart(pq)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(to_chart(normals), pq, atol=1e-6)


def test_normals_that_face_away_are_moved_to_the_rim():
    away = jnp.asarray([[0.6, 0, -0.8], [0, 0, -1.0], [0, 1.0, 0]], DTYPE)
    pq = to_chart(away)
    assert np.all(np.linalg.norm(pq, axis=1) <= RIM * (1 + 1e-6))
    np.testing.assert_allclose(pq[0], [RIM, 0], rtol=1e-6)
    np.testing.assert_allclose(pq[2], [0, RIM], rtol=1e-6)


def test_nodes_beyond_the_rim_hold_the_normal_at_the_rim():
    normals, inside = grid(9)
    assert normals.shape == (81, 3)
    assert 0 < inside.sum() < 81
    assert np.all(normals[:, 2] > 0)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)


@pytest.mark.parametrize("size", [65, 129])
def test_a_table_is_the_reflectance_equation(size):
    """Up to what bilinear interpolation loses, which falls with the square of the step."""
    brdf = hshjax.Lambert(0.5) + hshjax.GGX(0.3, 0.4)
    table, pq, view = shading_table((brdf,), lights(), size), some_chart_points(), jnp.asarray([0, 0, 1.0], DTYPE)
    found = table.at(pq)
    for k, direction in enumerate(lights()):
        light = hshjax.DirectionalLight(direction, jnp.ones((), DTYPE))
        exact = hshjax.reflect(brdf, light, from_chart(pq), view)[:, 0]
        # A kink at the terminator: errors there are of first order in the step.
        lit = np.asarray(from_chart(pq) @ direction) > 0.1
        assert np.max(np.abs(found[:, 0, k] - exact)[lit]) < 20 / size**2
    assert found.shape == (200, 1, 5)
    assert found.dtype == DTYPE


def test_slopes_are_those_of_the_table():
    table, pq = shading_table((hshjax.Lambert(1.0),), lights(), 33), some_chart_points(20)
    value, slope = table.with_slope(pq)
    np.testing.assert_allclose(value, table.at(pq), rtol=1e-6)
    for axis in range(2):
        direction = jnp.zeros_like(pq).at[:, axis].set(1)
        _, expected = jax.jvp(table.at, (pq,), (direction,))
        np.testing.assert_allclose(slope[:, axis], expected, atol=1e-5)


def test_mixtures_of_columns_are_tables_of_combined_brdfs():
    columns = default_columns()
    table = shading_table(column_brdfs(columns), lights(), 17)
    coefficients = jnp.asarray(np.random.default_rng(2).normal(size=(2, table.values.shape[1])), DTYPE)
    expected = shading_table((combined(columns, coefficients),), lights(), 17)
    tolerance = 1e-10 if DTYPE == "float64" else 2e-4  # sums of thirteen terms of either sign
    np.testing.assert_allclose(table.mixed(coefficients).values, expected.values, atol=tolerance)


def test_what_materials_begin_with():
    assert [len(first_guess(count)) for count in (1, 2, 4)] == [1, 2, 4]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ((), "at least one column"),
        ((hshjax.HSH(2),), "bases of pairs or BRDFs"),
        ((hshjax.TensorBasis(hshjax.HSH(1)),), "reciprocal and isotropic"),
        ((hshjax.HelmholtzBasis(hshjax.HSH(1)),), "reciprocal and isotropic"),
    ],
)
def test_columns_that_cannot_be_learned_are_refused(columns, message, unchecked):
    with pytest.raises(ValueError, match=message):
        column_brdfs(columns)
