"""Terms: each against its definition, and what every one has in common."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, HelmholtzBasis, IsotropicBasis, TensorBasis, Zernike
from hshjax.brdfs import CookTorrance, Lambert, LinearBRDF, OrenNayar
from hshjax.fitting import (
    Cauchy,
    CosineWeighted,
    CubeRoot,
    EnergyConservation,
    GemanMcClure,
    Huber,
    Identity,
    LogCosineWeighted,
    LogRelative,
    NonNegativity,
    Of,
    Prior,
    Reciprocity,
    SampleMisfit,
    Smoothness,
    Sparsity,
)
from hshjax.metrics import albedo
from hshjax.quadrature import hemisphere_rule, isotropic_pair_rule, pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close, directions

MAPPINGS = {m.__name__: m() for m in (Identity, CosineWeighted, LogCosineWeighted, LogRelative, CubeRoot)}
ROBUST = {r.__name__: r(0.3) for r in (Huber, Cauchy, GemanMcClure)}

WI, WO = directions(0, 40), directions(1, 40)


def tensor(seed, target="brdf"):
    basis = TensorBasis(Zernike(2))
    # So large that it violates every law: negative here, brighter than its light there.
    return LinearBRDF(basis, jnp.asarray(np.random.default_rng(seed).normal(0, 5, (36, 2)), DTYPE), target)


def scattered(brdf):
    return Samples.scattered(WI, WO, brdf(WI, WO))


PAIRS = isotropic_pair_rule(3, dtype=DTYPE)
DIFFUSE = scattered(Lambert(jnp.asarray([0.2, 0.7], DTYPE)))
ALL_TERMS = {
    **{f"misfit_{name}": SampleMisfit(DIFFUSE, mapping=mapping) for name, mapping in MAPPINGS.items()},
    **{f"misfit_{name}": SampleMisfit(DIFFUSE, robust=robust) for name, robust in ROBUST.items()},
    "reciprocity": Reciprocity(),
    "reciprocity_on_pairs": Reciprocity(PAIRS),
    "non_negativity": NonNegativity(PAIRS),
    "energy": EnergyConservation(hemisphere_rule(8, dtype=DTYPE), directions(2, 5)),
    "smoothness": Smoothness(),
    "prior": Prior(tensor(3), 2.0),
}
each_term = pytest.mark.parametrize("term", ALL_TERMS.values(), ids=ALL_TERMS.keys())


def loss(term, model):
    return sum(jnp.sum(r * r) for r in jax.tree.leaves(term(model))) / 2


@each_term
def test_finite_value_and_gradient_in_the_dtype_of_the_model(term):
    model = tensor(0)
    value, gradient = jax.jit(jax.value_and_grad(lambda c: loss(term, LinearBRDF(model.basis, c))))(model.coefficients)
    assert jnp.isfinite(value)
    assert jnp.all(jnp.isfinite(gradient))
    assert gradient.dtype == DTYPE
    assert jnp.any(gradient != 0)


@each_term
def test_gradients_are_finite_differences(term):
    if not X64:
        pytest.skip("a difference quotient in float32 has three digits")
    model, change = tensor(0), jnp.asarray(np.random.default_rng(9).normal(size=(36, 2)))
    value = jax.jit(lambda t: loss(term, LinearBRDF(model.basis, model.coefficients + t * change)))
    step = 1e-6
    # The loss is C1, its second derivative may jump: a quotient is off by a step times the jump.
    assert_close(jax.grad(value)(0.0), (value(step) - value(-step)) / (2 * step), tolerance=1e-5)


@each_term
def test_a_weight_scales_the_loss(term):
    assert_close(loss(3.0 * term, tensor(0)), 3 * loss(term, tensor(0)))
    assert_close(loss(term * 0.0, tensor(0)), 0.0)


@pytest.mark.parametrize("name", MAPPINGS)
def test_mappings_are_odd_and_increase(name):
    rho = jnp.linspace(-2, 2, 81, dtype=DTYPE)[:, None]
    wi = wo = jnp.broadcast_to(jnp.asarray([0, 0.6, 0.8], DTYPE), (81, 3))
    value = MAPPINGS[name](rho, wi, wo)
    assert_close(value, -value[::-1])
    assert jnp.all(jnp.diff(value[:, 0]) > 0)
    slope = jax.vmap(jax.grad(lambda r, i, o: MAPPINGS[name](r[None, None], i[None], o[None])[0, 0]))(rho[:, 0], wi, wo)
    assert jnp.all(slope > 0)


def test_mappings_are_their_formulas():
    rho, z = jnp.asarray([[0.1, 2.0]], DTYPE), 0.8 * 0.6
    wi, wo = jnp.asarray([[0.6, 0, 0.8]], DTYPE), jnp.asarray([[0, 0.8, 0.6]], DTYPE)
    x = np.asarray(rho, np.float64)
    expected = {
        "Identity": x,
        "CosineWeighted": x * z,
        "LogCosineWeighted": np.log1p(x * z),
        "LogRelative": np.log((x * z + 1e-3) / 1e-3),
        "CubeRoot": np.cbrt(x * z + 1e-3) - 0.1,
    }
    for name, value in expected.items():
        assert_close(MAPPINGS[name](rho, wi, wo), value)


@pytest.mark.parametrize("name", ROBUST)
def test_robust_losses_are_their_formulas(name):
    r = np.concatenate([np.linspace(-3, 3, 61), [1e-9, 1e-4, -1e-3, 0.01]])
    c = 0.3
    expected = {
        "Huber": np.where(np.abs(r) <= c, r**2 / 2, c * np.abs(r) - c * c / 2),
        "Cauchy": c * c / 2 * np.log1p((r / c) ** 2),
        "GemanMcClure": r**2 / 2 / (1 + (r / c) ** 2),
    }[name]
    mapped = ROBUST[name](jnp.asarray(r, DTYPE))
    assert_close(mapped**2 / 2, expected)
    assert jnp.all(jnp.sign(mapped) == np.sign(r))
    slope = jax.vmap(jax.grad(ROBUST[name]))(jnp.asarray([0.0, 1e-8, 0.3, 100.0], DTYPE))
    assert_close(slope[:2], jnp.ones(2))
    assert jnp.all(jnp.isfinite(slope))


def test_masked_samples_may_hold_anything():
    samples = scattered(OrenNayar(0.6, 0.4))
    bad = Samples.scattered(
        WI.at[3, 2].multiply(-1), WO, samples.value.at[3].set(jnp.nan), jnp.ones(40, DTYPE).at[3].set(0)
    )
    good = samples.reweighted(bad.weight)
    for mapping in MAPPINGS.values():
        assert_close(loss(SampleMisfit(bad, mapping), Lambert(0.2)), loss(SampleMisfit(good, mapping), Lambert(0.2)))
    gradient = jax.grad(lambda a: loss(SampleMisfit(bad), Lambert(a)))(jnp.asarray(0.2, DTYPE))
    assert jnp.isfinite(gradient)


def test_another_number_of_channels_is_refused():
    with pytest.raises(ValueError, match=r"values of shape \(40, 2\), the samples have \(40, 1\)"):
        SampleMisfit(scattered(Lambert(0.5)))(tensor(0))


def test_closed_form_reciprocity_is_the_integral():
    """∫∫ (ρ(i,o) - ρ(o,i))² = ||A - Aᵀ||², on a rule that is exact for the products of order 2."""
    rule = pair_rule(4, dtype=DTYPE)
    assert_close(loss(Reciprocity(), tensor(1)), loss(Reciprocity(rule), tensor(1)))


def test_closed_form_reciprocity_is_refused_where_there_is_none():
    model = LinearBRDF(HelmholtzBasis(HSH(1)), jnp.zeros((10, 1), DTYPE))
    with pytest.raises(ValueError, match="needs a LinearBRDF over a TensorBasis"):
        Reciprocity()(model)


def test_reciprocal_and_positive_and_dim_models_cost_nothing():
    brdf = Lambert(0.9) + 0.1 * OrenNayar(0.5, 0.3)
    assert_close(loss(Reciprocity(PAIRS), CookTorrance(0.3, 0.4, 0.3)), 0.0)
    assert loss(NonNegativity(PAIRS), brdf) == 0
    assert loss(ALL_TERMS["energy"], brdf) == 0


def test_energy_is_the_excess_of_the_albedo():
    term = ALL_TERMS["energy"]
    brdf = 1.7 * Lambert(jnp.asarray([0.9, 0.2], DTYPE))
    excess = jnp.maximum(albedo(brdf, term.wo, term.rule) - 1, 0)
    assert jnp.any(excess > 0)
    assert_close(term(brdf), excess)


def test_smoothness_is_the_spectral_prior():
    basis = IsotropicBasis(HSH(2))
    model = LinearBRDF(basis, jnp.ones((basis.count, 1), DTYPE))
    expected = [(n * (n + 1) + p * (p + 1)) ** 2 for n, p in basis.degrees()]
    assert_close(2 * loss(Smoothness(), model), float(np.sum(expected)))


def test_a_prior_on_a_part_leaves_the_rest_free():
    import equinox as eqx

    mean = eqx.tree_at(lambda b: b.slope, CookTorrance(0.2, 0.4, 0.25), None)
    near = CookTorrance(0.3, 0.4, 0.9)
    assert_close(loss(Prior(mean, 0.1), near), 0.5, tolerance=10 * TOLERANCE)


def test_a_term_of_a_part():
    scene = {"brdf": tensor(0), "other": jnp.ones(3)}
    assert_close(loss(Of(lambda s: s["brdf"], Reciprocity()), scene), loss(Reciprocity(), tensor(0)))


def test_sparsity_is_no_residual():
    with pytest.raises(ValueError, match="ProximalGradient"):
        Sparsity()(tensor(0))
