"""Non-negative weights, against scipy's solver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import nnls

from hshjax.stereo._weights import LIMIT, non_negative_weights, solve
from tests.helpers import DTYPE


def problems(rng, count, k, rows=12):
    """Matrices `(count, rows, k)` and right sides: many optima lie on the boundary."""
    return rng.normal(size=(count, rows, k)) + 0.5, rng.normal(size=(count, rows))


@pytest.mark.parametrize("k", range(1, LIMIT + 1))
def test_weights_are_those_of_scipy(k):
    matrices, right = problems(np.random.default_rng(k), 60, k)
    gram, moment = np.einsum("nri,nrj->nij", matrices, matrices), np.einsum("nri,nr->ni", matrices, right)
    weights, explained = non_negative_weights(jnp.asarray(gram, DTYPE), jnp.asarray(moment, DTYPE))
    expected = np.stack([nnls(a, b)[0] for a, b in zip(matrices, right, strict=True)])
    assert np.any(expected == 0)
    assert np.any(expected > 0)
    # Squared condition numbers of up to some hundreds.
    np.testing.assert_allclose(weights, expected, atol=1e-8 if DTYPE == "float64" else 5e-3)
    np.testing.assert_allclose(explained, np.sum(expected * moment, axis=1), atol=1e-7 if DTYPE == "float64" else 2e-2)


def test_nothing_to_explain_has_no_weights():
    weights, explained = non_negative_weights(jnp.zeros((3, 2, 2), DTYPE), jnp.zeros((3, 2), DTYPE))
    assert np.all(np.asarray(weights) == 0)
    assert np.all(np.asarray(explained) == 0)


def test_equal_columns_share_no_weight():
    gram, moment = jnp.ones((1, 2, 2), DTYPE), jnp.ones((1, 2), DTYPE)
    weights, explained = non_negative_weights(gram, moment)
    np.testing.assert_allclose(weights, [[1, 0]])
    np.testing.assert_allclose(explained, [1])


def test_too_many_materials_are_refused():
    with pytest.raises(ValueError, match=f"at most {LIMIT} materials, got {LIMIT + 1}"):
        non_negative_weights(jnp.eye(LIMIT + 1, dtype=DTYPE), jnp.ones(LIMIT + 1, DTYPE))


def test_small_systems_are_solved():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(5, 3, 3))
    matrix, right = root @ np.swapaxes(root, 1, 2) + np.eye(3), rng.normal(size=(5, 3))
    entries = [[jnp.asarray(matrix[:, i, j], DTYPE) for j in range(3)] for i in range(3)]
    found = jnp.stack(solve(entries, [jnp.asarray(right[:, i], DTYPE) for i in range(3)]), axis=1)
    expected = np.linalg.solve(matrix, right[..., None])[..., 0]
    np.testing.assert_allclose(found, expected, rtol=1e-9 if DTYPE == "float64" else 1e-3)


def test_a_lost_pivot_is_told():
    one = jnp.ones((), DTYPE)
    assert not np.all(np.isfinite(jnp.stack(solve([[one, one], [one, one]], [one, one]))))


def test_weights_have_derivatives_where_they_are_positive():
    gram = jnp.asarray([[2.0, 0.5], [0.5, 1.0]], DTYPE)
    slope = jax.jacobian(lambda moment: non_negative_weights(gram, moment)[0])(jnp.asarray([1.0, 1.0], DTYPE))
    np.testing.assert_allclose(slope, np.linalg.inv(gram), rtol=1e-5)
