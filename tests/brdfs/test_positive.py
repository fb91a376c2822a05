"""BRDFs that are positive by construction."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, HelmholtzBasis, IsotropicBasis, TensorBasis, Zernike
from hshjax.brdfs import ExpBRDF, SoftplusBRDF, SquaredBRDF
from tests.helpers import DTYPE, X64, assert_close, directions

KINDS = (ExpBRDF, SoftplusBRDF, SquaredBRDF)
BASIS = IsotropicBasis(HSH(3), bilateral=False)
each_kind = pytest.mark.parametrize("kind", KINDS)


def model(kind, basis=BASIS, scale=1.0):
    shape = (basis.count, 2, 3) if kind is SquaredBRDF else (basis.count, 3)
    return kind(basis, jnp.asarray(np.random.default_rng(0).normal(0, scale, shape), DTYPE))


@each_kind
def test_positive_and_reciprocal_whatever_the_coefficients(kind):
    brdf = model(kind, scale=4.0)
    wi, wo = directions(0, 200), directions(1, 200)
    value = brdf(wi, wo)
    assert value.shape == (200, 3)
    assert jnp.all(value > 0)
    # exp of a series of size 20 amplifies its rounding by as much.
    assert_close(value / brdf(wo, wi), jnp.ones_like(value), tolerance=1e-9 if X64 else 2e-4)


@each_kind
def test_value_is_the_link_of_the_rows(kind):
    brdf = model(kind, HelmholtzBasis(Zernike(2)))
    wi, wo = directions(2, 20), directions(3, 20)
    series = np.einsum("nk,k...->n...", np.asarray(brdf.basis(wi, wo), np.float64), np.asarray(brdf.coefficients))
    expected = {
        ExpBRDF: np.exp,
        SoftplusBRDF: lambda s: 0.1 * np.log1p(np.exp(s / 0.1)),
        SquaredBRDF: lambda s: np.sum(s**2, axis=1),
    }[kind](series)
    assert_close(brdf(wi, wo), expected)


@each_kind
def test_the_link_has_an_inverse(kind):
    rho = jnp.asarray([1e-6, 1e-3, 0.1, 1.0, 50.0], DTYPE)
    # Of a softplus, the smallest value is a difference of numbers near 1.
    assert_close(kind.link(kind.inverse_link(rho)) / rho, jnp.ones(5), tolerance=1e-9 if X64 else 1e-3)


@each_kind
def test_zero_with_zero_gradient_below_the_horizon(kind):
    wi = jnp.asarray([[0.6, 0.0, -0.8], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], DTYPE)
    wo = jnp.asarray([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8], [0.0, 0.6, -0.8]], DTYPE)
    brdf = model(kind)
    value, gradient = jax.value_and_grad(lambda w: jnp.sum(brdf(w, wo)))(wi)
    assert value == 0
    assert jnp.all(gradient == 0)


@each_kind
def test_wrong_coefficients_and_bases_are_told(kind, unchecked):
    axes = "modes, squares, channels" if kind is SquaredBRDF else "modes, channels"
    expected = axes.replace("modes", str(BASIS.count))
    with pytest.raises(ValueError, match=rf"must have shape \({expected}\), got \(3, 1\)"):
        kind(BASIS, jnp.zeros((3, 1)))
    with pytest.raises(ValueError, match="needs a reciprocal basis, got TensorBasis"):
        kind(TensorBasis(HSH(1)), jnp.zeros((16, 2, 1) if kind is SquaredBRDF else (16, 1)))
