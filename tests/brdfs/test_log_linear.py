"""BRDFs whose logarithm is a series: positive, reciprocal, bounded, of any channels."""

import jax
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
    gradient = jax.grad(lambda brdf: jnp.sum(brdf(wi, wo)))(brdf)
    assert gradient.low == gradient.high == 0
    assert np.any(gradient.coefficients[0] != 0)


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
        ((BASIS, [np.ones(13)]), r"at most 12,\), got \(13,\)"),
        ((BASIS, [np.ones((2, 2))]), r"got \(2, 2\)"),
        ((BASIS, [np.ones(3)], np.ones((2, 3))), r"shape \(1, channels\), a row for each component, got \(2, 3\)"),
        ((BASIS, [np.ones(3)], None, np.ones(2)), r"low must have shape \(1,\), got \(2,\)"),
        ((BASIS, []), "at least one channel, got 0"),
    ],
)
def test_refusals(arguments, message, unchecked):
    with pytest.raises(ValueError, match=message):
        LogLinearBRDF(*arguments)
