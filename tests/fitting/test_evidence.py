"""The algebra of evidence and posteriors against dense formulas, refits and higher precision."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from hshjax.fitting._compact_posterior import _updated
from hshjax.fitting._evidence import PSEUDO, TYPICAL, evidence, posterior, spectrum
from hshjax.fitting._generalised_log import generalised_log, linearised, log_density


def problem(samples=30, functions=12, seed=0):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(samples, functions)) / (1 + np.arange(functions))
    return rows, rows @ rng.normal(size=functions) + 0.1 * rng.normal(size=samples)


SIZES = {"more samples": (30, 12), "more functions": (12, 30)}


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_evidence_is_the_density_of_all_samples(size):
    """By covariance matrices of the samples. The size of the noise has a prior; its term is added by hand."""
    problems, ratios = [problem(*size, seed=k) for k in range(3)], np.array([0.1, 3.0, 200.0])
    known, variances = evidence([spectrum(*one) for one in problems], ratios)
    for ratio, logarithm, variance in zip(ratios, known, variances, strict=True):
        dense = -PSEUDO * TYPICAL**2 / variance / 2
        best = 0.0
        for rows, target in problems:
            covariance = np.eye(len(rows)) + ratio * rows @ rows.T
            dense += multivariate_normal.logpdf(target, np.zeros(len(rows)), variance * covariance)
            best += target @ np.linalg.solve(covariance, target)
        assert logarithm == pytest.approx(dense, rel=1e-10)
        assert variance == pytest.approx((best + PSEUDO * TYPICAL**2) / (3 * size[0] + PSEUDO), rel=1e-10)


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_posterior_is_that_of_the_covariances_of_samples(size):
    """Kriging, which never forms the normal matrix of the coefficients."""
    rows, target = problem(*size)
    ratio, variance = 5.0, 0.02
    found = posterior(spectrum(rows, target), ratio, variance)
    gain = ratio * rows.T @ np.linalg.inv(np.eye(len(rows)) + ratio * rows @ rows.T)
    np.testing.assert_allclose(found.mean, gain @ target, rtol=1e-9, atol=1e-12)
    covariance = ratio * variance * (np.eye(rows.shape[1]) - gain @ rows)
    np.testing.assert_allclose(found.root @ found.root.T, covariance, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_what_is_left_out_is_predicted_by_a_refit(size):
    rows, target = problem(*size)
    ratio, variance = 5.0, 0.02
    found = posterior(spectrum(rows, target), ratio, variance)
    for k in range(len(rows)):
        rest = np.arange(len(rows)) != k
        refit = posterior(spectrum(rows[rest], target[rest]), ratio, variance)
        predicted = np.sum((rows[k] @ refit.root) ** 2) + variance
        assert found.variances[k] == pytest.approx(predicted, rel=1e-9)
        assert found.scores[k] == pytest.approx((target[k] - rows[k] @ refit.mean) / np.sqrt(predicted), rel=1e-8)


def test_a_sample_more_updates_the_root():
    rows, target = problem()
    before = posterior(spectrum(rows[1:], target[1:]), 5.0, 0.02).root
    after = posterior(spectrum(rows, target), 5.0, 0.02).root
    updated = _updated(before, rows[0] @ before, 0.02)
    np.testing.assert_allclose(updated @ updated.T, after @ after.T, rtol=1e-9, atol=1e-12)


def test_generalised_log():
    """ln of bright values; odd about ln(dark / 2); no cancellation where values are negative."""
    np.testing.assert_allclose(generalised_log(np.array([5.0]), 1e-9), np.log(5), rtol=1e-12)
    value = np.array([1e-6, 0.1, 30.0])
    up, down = generalised_log(value, 0.01), generalised_log(-value, 0.01)
    np.testing.assert_allclose(up + down, 2 * np.log(0.01 / 2), rtol=1e-12)


def test_noise_of_two_parts_becomes_alike():
    """Deviations of the generalised logarithm at dark, middling and bright values, by drawing."""
    rng = np.random.default_rng(0)
    value = np.array([0.0, 0.01, 0.1, 10.0])
    noise = 0.02 * np.hypot(value, 0.1) * rng.normal(size=(20000, 4))
    # 20000 draws tell a deviation to 0.5 %.
    np.testing.assert_allclose(generalised_log(value + noise, 0.1).std(axis=0), 0.02, rtol=0.02)


def test_linearised_is_the_first_order():
    """Where the value is what was expected, so is the response; a small change is seen in proportion."""
    logarithm, dark = np.array([-6.0, -2.0, 1.0]), 0.05
    value = np.exp(logarithm)
    response, weight = linearised(value, logarithm, dark)
    np.testing.assert_allclose(response, logarithm, rtol=1e-13)
    np.testing.assert_allclose(weight, value**2 / (value**2 + dark**2), rtol=1e-12)
    moved, _ = linearised(value * np.exp(1e-5), logarithm, dark)
    np.testing.assert_allclose(moved - logarithm, 1e-5, rtol=1e-4)
    step = generalised_log(value + 1e-6, dark) - generalised_log(value - 1e-6, dark)
    assert log_density(value, dark) == pytest.approx(np.sum(np.log(step / 2e-6)), rel=1e-6)
