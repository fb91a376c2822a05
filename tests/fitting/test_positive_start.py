"""Positive BRDFs from samples: the start in closed form, and the fit from there on."""

import jax
import jax.numpy as jnp
import optimistix as optx
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import ExpBRDF, Lambert, SoftplusBRDF, SquaredBRDF
from hshjax.fitting import CosineWeighted, SampleMisfit, fit, positive_start, relative_error
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, slow_unless

KINDS = (ExpBRDF, SoftplusBRDF, SquaredBRDF)
BASIS = IsotropicBasis(HSH(2))
RULE = isotropic_pair_rule(10, dtype=DTYPE)


def lobe(wi, wo):
    """A soft retro-reflection, dark elsewhere."""
    return 0.02 + 0.5 * jnp.exp(-6 * jnp.sum((wi - wo) ** 2, axis=-1, keepdims=True)) * jnp.asarray([[1.0, 0.5]], DTYPE)


SAMPLES = Samples.from_function(lobe, RULE)


@pytest.mark.parametrize("kind", KINDS)
def test_a_constant_is_met_by_the_start(kind):
    samples = Samples.from_function(Lambert(jnp.asarray([0.6, 0.02], DTYPE)), RULE)
    start = positive_start(kind, BASIS, samples)
    # The ridge leaves the constant free; for all else there is nothing to damp.
    assert_close(start(RULE.wi, RULE.wo), samples.value, tolerance=1e-8 if X64 else 1e-4)


@pytest.mark.parametrize("kind", [slow_unless(kind is ExpBRDF, kind) for kind in KINDS])
def test_the_fit_improves_on_the_start(kind):
    start = jax.jit(lambda value: positive_start(kind, BASIS, Samples(RULE.wi, RULE.wo, value, RULE.weight)))(
        SAMPLES.value
    )
    assert relative_error(start, SAMPLES, "D").max() < 0.5
    found = fit(start, {"data": SampleMisfit(SAMPLES, CosineWeighted())}, optx.LevenbergMarquardt(1e-6, 1e-8))
    assert jnp.all(relative_error(found.model, SAMPLES, "D") < 0.9 * relative_error(start, SAMPLES, "D"))
    assert jnp.all(found.model(RULE.wi, RULE.wo) > 0)


@pytest.mark.slow
def test_more_squares_fit_better():
    errors = []
    for squares in (1, 2):
        start = positive_start(SquaredBRDF, BASIS, SAMPLES, squares=squares)
        assert start.coefficients.shape == (BASIS.count, squares, 2)
        found = fit(start, {"data": SampleMisfit(SAMPLES, CosineWeighted())}, optx.LevenbergMarquardt(1e-6, 1e-8))
        errors.append(relative_error(found.model, SAMPLES, "D"))
    assert jnp.all(errors[1] < errors[0])


def test_masked_samples_may_hold_anything():
    wi, value = RULE.wi.at[0].set(jnp.nan), SAMPLES.value.at[0].set(jnp.nan)
    bad = Samples(wi, RULE.wo, value, RULE.weight.at[0].set(0))
    good = Samples(RULE.wi, RULE.wo, SAMPLES.value, bad.weight)
    assert_close(positive_start(ExpBRDF, BASIS, bad).coefficients, positive_start(ExpBRDF, BASIS, good).coefficients)


def test_squares_are_those_of_a_squared_brdf():
    with pytest.raises(ValueError, match="squares must be at least 1, and 1 for a ExpBRDF, got 2"):
        positive_start(ExpBRDF, BASIS, SAMPLES, squares=2)
