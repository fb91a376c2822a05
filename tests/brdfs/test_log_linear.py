"""BRDFs whose logarithm is a series: positive, reciprocal, bounded, of any channels."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, HalfVectorBasis, IsotropicBasis, TensorBasis, Zernike
from hshjax.brdfs import ExpBRDF, LogLinearBRDF, contrasts
from hshjax.io import load_model, save_model
from tests.helpers import DTYPE, assert_close, directions

BASIS = HalfVectorBasis(12)


def parts(*sizes):
    rng = np.random.default_rng(0)
    return [jnp.asarray(0.3 * rng.normal(size=size), DTYPE) for size in sizes]


def test_channels_share_a_shape():
    """ln ρ = shape + contrasts, over leading functions."""
    wi, wo, components = directions(0, 7), directions(1, 7), parts(12, 4, 2)
    brdf = LogLinearBRDF(BASIS, components)
    assert (brdf.channels, brdf.count) == (3, 18)
    rows = np.asarray(BASIS(wi, wo))
    expected = np.exp(
        sum(np.outer(rows[:, : c.size] @ c, row) for c, row in zip(components, contrasts(3), strict=True))
    )
    assert_close(brdf(wi, wo), expected)
    assert np.all(brdf(wi, wo) > 0)
    assert_close(brdf(wo, wi), brdf(wi, wo))


def test_contrasts_are_those_of_helmert():
    assert_close(contrasts(1), [[1.0]])
    rows = contrasts(5)
    assert_close(rows[1:] @ rows[1:].T, np.eye(4))
    assert_close(rows[1:].sum(1), np.zeros(4))
    assert_close(rows[0], np.ones(5))


def test_the_same_as_an_exponential_of_independent_channels():
    wi, wo, basis = directions(0, 5), directions(1, 5), IsotropicBasis(Zernike(2))
    columns = parts(basis.count, basis.count)
    brdf = LogLinearBRDF(basis, columns, jnp.eye(2, dtype=DTYPE))
    assert_close(brdf(wi, wo), ExpBRDF(basis, jnp.stack(columns, axis=1))(wi, wo))


def test_bounds_hold_and_are_no_parameters():
    wi, wo = directions(0, 50), directions(1, 50)
    brdf = LogLinearBRDF(BASIS, [10 * parts(12)[0]], low=[np.log(0.1)], high=[np.log(2.0)])
    value = brdf(wi, wo)
    assert float(value.min()) == pytest.approx(0.1, rel=1e-5)
    assert float(value.max()) == pytest.approx(2.0, rel=1e-5)
    gradient = eqx.filter_grad(lambda brdf: jnp.sum(brdf(wi, wo)))(brdf)
    assert gradient.low == gradient.high == 0
    assert np.any(gradient.coefficients != 0)


def test_terms_are_functions_of_components():
    """In any order; the others are 0."""
    wi, wo = directions(0, 6), directions(1, 6)
    dense = np.zeros((12, 3))
    terms = np.array([[7, 2], [0, 0], [3, 0], [11, 1]])
    dense[terms[:, 0], terms[:, 1]] = [0.1, -0.2, 0.3, 0.4]
    brdf = LogLinearBRDF(BASIS, jnp.asarray([0.1, -0.2, 0.3, 0.4], DTYPE), terms=terms)
    assert (brdf.count, brdf.channels) == (4, 3)
    assert_close(brdf.matrix, dense)
    assert_close(brdf(wi, wo), LogLinearBRDF(BASIS, list(jnp.asarray(dense.T, DTYPE)))(wi, wo))


def test_spectra_of_few_components():
    mixing = jnp.asarray(np.random.default_rng(0).normal(size=(2, 31)), DTYPE)
    assert LogLinearBRDF(BASIS, parts(12, 3), mixing)(directions(0, 4), directions(1, 4)).shape == (4, 31)


def test_saved_and_loaded(tmp_path):
    brdf = LogLinearBRDF(BASIS, parts(12, 4, 2), high=jnp.ones(3, DTYPE))
    save_model(tmp_path / "model.hshjax", brdf)
    loaded = load_model(tmp_path / "model.hshjax")
    wi, wo = directions(0, 5), directions(1, 5)
    np.testing.assert_array_equal(loaded(wi, wo), brdf(wi, wo))
    assert loaded.basis.functions == BASIS.functions


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((TensorBasis(HSH(1)), [np.ones(3)]), "needs a reciprocal basis"),
        ((BASIS, [np.ones(13)]), r"of 12 functions and 1 components, got numbers up to \[12, 0\]"),
        ((BASIS, [np.ones(3)] * 3, np.ones((2, 3))), r"2 components, got numbers up to \[2, 2\]"),
        ((BASIS, [np.ones((2, 2))]), r"got shapes \[\(2, 2\)\]"),
        ((BASIS, [np.ones(3)], np.ones(3)), r"shape \(components, channels\), got \(3,\)"),
        ((BASIS, [np.ones(3)], None, np.ones(2)), r"low must have shape \(1,\), got \(2,\)"),
        ((BASIS, []), r"for each component, got shapes \[\]"),
    ],
)
def test_refusals(arguments, message, unchecked):
    with pytest.raises(ValueError, match=message):
        LogLinearBRDF(*arguments)


@pytest.mark.parametrize(
    ("coefficients", "terms", "message"),
    [
        (np.ones(2), [[0, 0], [0, 0]], "stands twice"),
        (np.ones(2), [[0, 0], [-1, 0]], "got numbers up to"),
        (np.ones(2), [[0, 0]], r"\(terms, 2\), got \(2,\) and \(1, 2\)"),
    ],
)
def test_terms_that_are_none(coefficients, terms, message, unchecked):
    with pytest.raises(ValueError, match=message):
        LogLinearBRDF(BASIS, coefficients, terms=terms)
