"""Derivatives through whole fits: by the implicit function theorem, for every term and every model.

Samples lie at the pole, near the horizon, at retro-reflection and at mirror pairs, and NaN is an error wherever it
comes up.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from hshjax.bases import HSH, IsotropicBasis, TensorBasis, Zernike
from hshjax.brdfs import (
    GGX,
    BlinnPhong,
    CookTorrance,
    ExpBRDF,
    Lambert,
    LinearBRDF,
    OrenNayar,
    SchlickFresnel,
    SoftplusBRDF,
    SquaredBRDF,
    Ward,
)
from hshjax.fitting import (
    Cauchy,
    CosineWeighted,
    CubeRoot,
    EnergyConservation,
    GemanMcClure,
    Huber,
    LevenbergMarquardt,
    LogCosineWeighted,
    LogRelative,
    NonNegativity,
    Prior,
    Reciprocity,
    SampleMisfit,
    Smoothness,
    fit,
    project,
)
from hshjax.quadrature import hemisphere_rule, isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import X64, directions, mostly_slow, slow_unless

pytestmark = pytest.mark.skipif(not X64, reason="a difference quotient of a fit in float32 has no digits")

EXACT = LevenbergMarquardt(rtol=1e-12, atol=1e-12)


def edges():
    """Pairs at the pole, near the horizon, retro-reflecting and mirrored, among scattered ones."""
    theta = jnp.asarray([0.0, 0.0, 0.7, 0.7, 1.57, 1.57, 0.3])
    phi = jnp.asarray([0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 0.0])
    turn = jnp.asarray([0.0, 0.0, 0.0, np.pi, 0.0, np.pi, np.pi])
    tilt = jnp.asarray([0.0, 0.5, 0.7, 0.7, 1.57, 1.57, 1.569])

    def at(theta, phi):
        return jnp.stack([jnp.sin(theta) * jnp.cos(phi), jnp.sin(theta) * jnp.sin(phi), jnp.cos(theta)], axis=-1)

    wi, wo = (
        jnp.concatenate([at(theta, phi), directions(0, 80)]),
        jnp.concatenate([at(tilt, phi + turn), directions(1, 80)]),
    )
    return wi, wo


WI, WO = edges()
NOISE = jnp.asarray(np.random.default_rng(2).normal(size=(WI.shape[0], 1)))


def check(fitted):
    """d fitted(t) / dt at 0.1 by the theorem against differences; without a NaN on the way."""
    with jax.debug_nans(True):
        fitted = jax.jit(fitted)
        # A loss that is not 0 is flat to rounding within 3e-9 of where it ends: a step of 1e-3 leaves 3e-6 of that, and
        # 2e-6 of the third derivative.
        check_grads(fitted, (0.1,), order=1, modes=("fwd", "rev"), eps=1e-3, atol=1e-5, rtol=1e-5)


def summary(model):
    """One number that knows all parameters."""
    return sum(
        jnp.sum(jnp.cos(jnp.arange(leaf.size)) * leaf.ravel())
        for leaf in jax.tree.leaves(eqx.filter(model, eqx.is_inexact_array))
    )


TENSOR = TensorBasis(Zernike(1))
PAIRS = isotropic_pair_rule(4)
MISFITS = {
    "cosine_weighted": {"mapping": CosineWeighted()},
    "log": {"mapping": LogCosineWeighted()},
    "log_relative": {"mapping": LogRelative()},
    "cube_root": {"mapping": CubeRoot()},
    "huber": {"robust": Huber(0.5)},
    "cauchy": {"robust": Cauchy(1.0)},
    "geman_mcclure": {"robust": GemanMcClure(3.0)},
}
TERMS = {
    "reciprocity": Reciprocity(),
    "reciprocity_on_pairs": Reciprocity(PAIRS),
    "non_negativity": 10.0 * NonNegativity(PAIRS),
    "energy": 10.0 * EnergyConservation(hemisphere_rule(4), directions(3, 4)),
    "smoothness": Smoothness(),
    "prior": Prior(LinearBRDF(TENSOR, jnp.ones((TENSOR.count, 1)))),
}


@pytest.mark.parametrize("name", mostly_slow(MISFITS, ["huber"]))
def test_misfits(name):
    def fitted(t):
        value = 0.5 + 0.2 * NOISE * (1 + t) + t * WI[:, 2:]
        objective = {
            "data": SampleMisfit(Samples.scattered(WI, WO, value), **MISFITS[name]),
            "ridge": 1e-2 * Prior(LinearBRDF(TENSOR, jnp.zeros((TENSOR.count, 1)))),
        }
        start = LinearBRDF(TENSOR, jnp.full((TENSOR.count, 1), 0.1))
        return summary(fit(start, objective, EXACT, max_steps=500).model)

    check(fitted)


@pytest.mark.parametrize("name", [slow_unless(name == "smoothness", name) for name in TERMS])
def test_terms(name):
    def fitted(t):
        samples = Samples.scattered(WI, WO, NOISE * (1 + t) + t * WI[:, 2:] + 0.4)
        objective = {"data": SampleMisfit(samples), "term": (1 + t) * TERMS[name]}
        start = LinearBRDF(TENSOR, jnp.zeros((TENSOR.count, 1)))
        return summary(fit(start, objective, EXACT, max_steps=500).model)

    check(fitted)


ISOTROPIC = IsotropicBasis(HSH(1))
ONES = jnp.full((ISOTROPIC.count, 1), 0.1)
MODELS = {
    "lambert": Lambert(0.3),
    "oren_nayar": OrenNayar(0.5, 0.4),
    "oren_nayar_full": OrenNayar(0.5, 0.4, full=True),
    "cook_torrance": CookTorrance(0.3, 0.4, 0.4),
    "cook_torrance_schlick": CookTorrance(0.3, 0.5, 0.4, SchlickFresnel(0.3)),
    "ggx": Lambert(0.2) + GGX(0.5, 0.5),
    "ggx_height_correlated": GGX(0.5, 0.5, height_correlated=True),
    "ward": Lambert(0.2) + Ward(0.4, 0.4, 0.5),
    "blinn_phong": Lambert(0.2) + BlinnPhong(0.4, 8.0),
    "linear": LinearBRDF(ISOTROPIC, ONES),
    "linear_half_foreshortened": LinearBRDF(ISOTROPIC, ONES, "half_foreshortened"),
    "linear_foreshortened": LinearBRDF(ISOTROPIC, ONES, "foreshortened"),
    "exp": ExpBRDF(ISOTROPIC, -ONES),
    "softplus": SoftplusBRDF(ISOTROPIC, ONES),
    "squared": SquaredBRDF(ISOTROPIC, jnp.full((ISOTROPIC.count, 1, 1), 0.2)),
}


@pytest.mark.parametrize("name", [slow_unless(name == "cook_torrance", name) for name in MODELS])
def test_models(name):
    """Data that no parameter meets, so that second derivatives of the model enter."""
    truth = MODELS[name]
    held = (lambda b: (b.diffuse, b.specular, b.slope)) if name == "cook_torrance_schlick" else None

    def fitted(t):
        value = truth(WI, WO) * (1 + 0.05 * NOISE + t * WI[:, 2:] * WO[:, 2:])
        objective = {"data": SampleMisfit(Samples.scattered(WI, WO, value), CosineWeighted())}
        return summary(fit(truth, objective, EXACT, trainable=held, max_steps=500).model)

    check(fitted)


@pytest.mark.slow
@pytest.mark.parametrize("ridge", [0.0, 0.1])
def test_second_order_through_project(ridge):
    wi, wo, noise = WI[:40], WO[:40], NOISE[:40]

    def fitted(t):
        samples = Samples.scattered(wi, wo, noise + t * wi[:, 2:], 1 + t**2 * wo[:, 2])
        return summary(project(ISOTROPIC, samples, norm="A", ridge=ridge).model)

    with jax.debug_nans(True):
        check_grads(jax.jit(fitted), (0.3,), order=2, modes=("fwd", "rev"), eps=1e-4, atol=1e-5, rtol=1e-5)


def test_a_parameter_without_effect_has_no_derivative():
    """A lobe that the fit has put out: its slope does nothing, and the Hessian is singular there."""

    def albedo(scale):
        samples = Samples.scattered(WI, WO, scale * Lambert(0.3)(WI, WO))
        found = fit(
            CookTorrance(0.5, 0.0, 0.5), {"data": SampleMisfit(samples)}, trainable=lambda b: (b.diffuse, b.slope)
        )
        return found.model.diffuse

    assert jax.grad(albedo)(1.0) == pytest.approx(0.3, abs=1e-6)  # the fit converges to 1e-8
