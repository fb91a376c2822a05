"""The path of L1 fits, on an orthonormal design where each is known."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import LinearBRDF
from hshjax.fitting import SampleMisfit, largest_sparsity_weight, sparsity_path
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close

BASIS = IsotropicBasis(HSH(2))
RULE = isotropic_pair_rule(4, dtype=DTYPE)
TRUTH = jnp.asarray(np.random.default_rng(5).normal(size=(BASIS.count, 1)), DTYPE)
OBJECTIVE = {"data": SampleMisfit(Samples.from_function(LinearBRDF(BASIS, TRUTH), RULE))}
ZERO = LinearBRDF(BASIS, jnp.zeros_like(TRUTH))


def test_every_fit_of_the_path_is_a_soft_threshold():
    largest = float(largest_sparsity_weight(ZERO, OBJECTIVE))
    assert_close(largest, float(jnp.max(jnp.abs(TRUTH))))
    weights = [1.01 * largest, 0.5 * largest, 0.1 * largest, 0.0]
    path = sparsity_path(ZERO, OBJECTIVE, weights)
    assert not jnp.any(path[0].model.coefficients)
    counts = [int(jnp.sum(found.model.coefficients != 0)) for found in path]
    assert counts == sorted(counts)
    assert 0 < counts[1] < BASIS.count == counts[-1]
    for weight, found in zip(weights, path, strict=True):
        expected = jnp.sign(TRUTH) * jnp.maximum(jnp.abs(TRUTH) - weight, 0)
        assert_close(found.model.coefficients, expected, tolerance=1e-7 if X64 else 1e-4)
        assert_close(found.losses["sparsity"], weight * jnp.sum(jnp.abs(expected)), tolerance=1e-6 if X64 else 1e-3)


@pytest.mark.parametrize("weights", [[], [1.0, 2.0], [1.0, -1.0]])
def test_weights_must_decrease(weights):
    with pytest.raises(ValueError, match="weights must be decreasing and >= 0"):
        sparsity_path(ZERO, OBJECTIVE, weights)
