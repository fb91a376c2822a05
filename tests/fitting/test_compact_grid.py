"""Samples on a grid: found as such, and their sums those of the same samples one by one."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HalfVectorBasis, IdentityWarp, LogWarp
from hshjax.fitting import half_vector_samples
from hshjax.fitting._compact_grid import GridRows, find_grid
from hshjax.fitting._compact_rows import ScatteredRows
from hshjax.geometry import from_half_difference
from tests.helpers import X64, directions

pytestmark = pytest.mark.skipif(not X64, reason="found on the host in float64, whatever the leg")

SHAPE = (24, 10, 4)


def pairs():
    samples = half_vector_samples(lambda wi, wo: wi[:, 2], shape=SHAPE)
    return np.asarray(samples.wi), np.asarray(samples.wo)


def test_a_grid_is_found():
    wi, wo = pairs()
    grid = find_grid(wi, wo)
    assert grid is not None
    assert grid.shape == SHAPE
    assert np.unique(grid.cell).size == len(wi)


def test_a_grid_is_found_in_any_order_and_turned():
    """As MERL files have it: all φ_d in [0, π), which cos 2φ_d folds; turned about the normal, with a pair twice."""
    theta_h, theta_d, phi = (
        part.ravel()
        for part in np.meshgrid(np.linspace(0, 1, 9) ** 2, np.linspace(0, 0.5, 6), np.arange(8) * np.pi / 8)
    )
    wi, wo = (np.asarray(w) for w in from_half_difference(*map(jnp.asarray, (theta_h, theta_d, phi))))
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    order = np.r_[np.random.default_rng(0).permutation(len(wi)), 5]
    grid = find_grid((wi @ turn)[order], (wo @ turn)[order])
    assert grid is not None
    # At θ_h = 0 and at θ_d = 0 there is no φ_d: both have a level of it for themselves at most.
    assert grid.shape[:2] == (9, 6)
    assert grid.shape[2] <= 6
    assert grid.cell[-1] == grid.cell[np.flatnonzero(order[:-1] == 5)[0]]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_default_grid_is_found(dtype):
    """The one that every BRDF is sampled on: whether it is found decides about the time of a fit."""
    samples = half_vector_samples(lambda wi, wo: wi[:, 2])
    wi, wo = (np.asarray(w).astype(dtype).astype(np.float64) for w in (samples.wi, samples.wo))
    grid = find_grid(wi, wo, float(np.finfo(dtype).eps))
    assert grid is not None
    assert grid.shape == (92, 24, 6)


def test_scattered_pairs_are_none():
    assert find_grid(np.asarray(directions(0, 500)), np.asarray(directions(1, 500))) is None


@pytest.mark.parametrize("back", [IdentityWarp(), LogWarp(jnp.asarray(0.01))], ids=["plain", "back"])
def test_sums_are_those_of_rows(back):
    """Gram, moment, evaluation; a warped θ_d; several sets of weights."""
    wi, wo = pairs()
    basis = HalfVectorBasis(60, LogWarp(jnp.asarray(1e-3)), back)
    grid = find_grid(wi, wo)
    assert grid is not None
    on_grid, one_by_one = GridRows(basis, grid), ScatteredRows(basis, wi, wo)
    rng = np.random.default_rng(0)
    weight, columns = rng.uniform(size=(len(wi), 2)), rng.normal(size=(60, 3))
    for got, expected in (
        (on_grid.gram(weight), one_by_one.gram(weight)),
        (on_grid.moment(weight), one_by_one.moment(weight)),
        (on_grid.evaluate(columns), one_by_one.evaluate(columns)),
    ):
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())
    rows = np.asarray(basis(jnp.asarray(wi), jnp.asarray(wo)))
    np.testing.assert_allclose(one_by_one.gram(weight)[1], rows.T @ (weight[:, 1:] * rows), rtol=1e-9, atol=1e-9)


def test_sines_have_no_place():
    grid = find_grid(*pairs())
    assert grid is not None
    with pytest.raises(ValueError, match="cannot tell sines"):
        GridRows(HalfVectorBasis([(1, 2, -2)]), grid)


def test_directions_in_float32_are_on_the_same_grid():
    """Half angles near the mirror direction have three digits left there: enough to tell levels."""
    wi, wo = pairs()
    coarse = (w.astype(np.float32).astype(np.float64) for w in (wi, wo))
    exact, found = find_grid(wi, wo), find_grid(*coarse, precision=float(np.finfo(np.float32).eps))
    assert exact is not None
    assert found is not None
    np.testing.assert_array_equal(found.cell, exact.cell)
    np.testing.assert_allclose(np.sqrt(found.half), np.sqrt(exact.half), atol=1e-6)
    assert find_grid(wi.astype(np.float32).astype(np.float64), wo) is None  # as if they were exact


def test_angles_of_two_digits_are_a_grid_or_none():
    """Levels that rounding has spread into each other are not taken for one."""
    rng = np.random.default_rng(0)
    wi, wo = (w + rng.uniform(-1, 1, w.shape) * 1e-3 for w in pairs())
    wi, wo = (w / np.linalg.norm(w, axis=1, keepdims=True) for w in (wi, wo))
    assert find_grid(wi, wo, precision=1e-3) is None
