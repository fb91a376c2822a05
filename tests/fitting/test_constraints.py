"""Physically valid fits: against closed forms, independent solvers and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from hshjax.bases import HSH, SHR, HelmholtzBasis, IsotropicBasis, TensorBasis, Zernike
from hshjax.brdfs import CookTorrance, Lambert, LinearBRDF, OrenNayar
from hshjax.fitting import Outcome, project
from hshjax.fitting._least_distance import InfeasibleError, least_distance
from hshjax.geometry import direction
from hshjax.io import read_rgl
from hshjax.metrics import albedo, negativity
from hshjax.quadrature import isotropic_pair_rule, pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close, directions, slow_unless

BASIS = IsotropicBasis(HSH(3))
"""One basis nearly throughout: what is compiled for its inequalities serves every norm with the same target."""
BOTH = ("non_negative", "energy")
EPS = float(jnp.finfo(DTYPE).eps)
MISSED = 1e-6
"""What a certificate lets a value or an albedo miss."""
ASKED = 2e-6 if X64 else 1e-3
"""How far an optimum lies within its constraints: the margin, and in float32 the rounding that it covers."""


def samples_of(brdf, degree=12, factor=1.0):
    rule = isotropic_pair_rule(degree, dtype=DTYPE)
    return Samples.from_function(lambda wi, wo: factor * brdf(wi, wo), rule)


def lobe(width=0.2):
    """A specular lobe on a dark ground: where a series of low order rings."""
    return CookTorrance(jnp.asarray([0.02]), jnp.asarray([0.4]), width)


def pairs_at_random(n=4000, min_z=0.02):
    return directions(11, n, min_z=min_z), directions(12, n, min_z=min_z)


# --- the small program ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_least_distance_satisfies_kkt_and_equals_another_solver(seed):
    rng = np.random.default_rng(seed)
    n, m = 6, 15
    root = np.linalg.qr(rng.normal(size=(20, n)))[1]
    start, rows = rng.normal(size=n), rng.normal(size=(m, n))
    inside = rng.normal(size=n)
    bounds = rows @ inside - rng.uniform(0, 1, m)
    point, multiplier = least_distance(root, start, rows, bounds)
    slack = rows @ point - bounds
    assert np.min(slack) > -1e-10
    assert np.min(multiplier) >= 0
    assert 0 < np.count_nonzero(multiplier) <= n
    assert_close(slack[multiplier > 0], 0, tolerance=1e-10)
    assert_close(root.T @ root @ (point - start), rows.T @ multiplier, tolerance=1e-10)
    oracle = minimize(
        lambda c: np.sum((root @ (c - start)) ** 2),
        inside,
        jac=lambda c: 2 * root.T @ root @ (c - start),
        constraints={"type": "ineq", "fun": lambda c: rows @ c - bounds, "jac": lambda c: rows},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert_close(point, oracle.x, tolerance=1e-6)  # what SLSQP reaches


def test_a_point_within_all_inequalities_stays():
    point, multiplier = least_distance(np.eye(2), np.array([1.0, 2]), np.eye(2), np.zeros(2))
    assert_close(point, [1, 2], tolerance=0)
    assert_close(multiplier, [0, 0], tolerance=0)


@pytest.mark.parametrize("rows", [[[1.0, 0], [-1, 0]], [[0.0, 0], [1, 0]]], ids=["opposite", "empty"])
def test_inequalities_that_exclude_each_other(rows):
    with pytest.raises(InfeasibleError):
        least_distance(np.eye(2), np.zeros(2), np.array(rows), np.array([1.0, 1]))


# --- optima that are known --------------------------------------------------------------------------------------------


def test_a_lambertian_surface_brighter_than_white_becomes_white():
    """In norm A the multipliers κ z_o push along (κ z_i z_o / z_i z_o): the optimum is the constant of albedo 1."""
    fit = project(BASIS, samples_of(Lambert(jnp.asarray([1.4]))), norm="A", constraints=("energy",), reciprocity=False)
    wi, wo = pairs_at_random(50)
    assert_close(fit.model(wi, wo), np.full((50, 1), 1 / np.pi), tolerance=ASKED)
    assert_close(fit.certificate.albedo, [1], tolerance=ASKED)
    assert fit.certificate.albedo <= 1 + MISSED
    assert fit.certificate.holds
    assert fit.result == Outcome.converged


@pytest.mark.parametrize("norm", ["A", "B", "C", "D", "E"])
def test_a_negative_surface_becomes_black(norm):
    samples = samples_of(Lambert(jnp.asarray([0.2])), factor=-1.0)
    fit = project(BASIS, samples, norm=norm, constraints=("non_negative",), reciprocity=False)
    series = fit.model.basis.evaluate(fit.model.coefficients, *pairs_at_random(50))
    assert_close(series, np.zeros((50, 1)), tolerance=ASKED)
    assert fit.certificate.holds
    assert fit.certificate.smallest >= -MISSED


@pytest.mark.parametrize("norm", ["A", "C", "D"])
def test_constraints_that_hold_anyway_change_nothing(norm):
    basis, samples = BASIS, samples_of(Lambert(jnp.asarray([0.3, 0.8])))
    free = project(basis, samples, norm=norm, reciprocity=False)
    fit = project(basis, samples, norm=norm, constraints=BOTH, reciprocity=False)
    assert_close(fit.model.coefficients, free.model.coefficients, tolerance=max(TOLERANCE, 100 * EPS))
    assert fit.certificate.active == (0, 0)
    assert_close(fit.certificate.albedo, [0.3, 0.8], tolerance=max(TOLERANCE, 1e-3 * (not X64)))
    assert_close(fit.certificate.lift, [0, 0], tolerance=0)
    assert free.certificate is None
    assert free.result == Outcome.converged


# --- certified fits ---------------------------------------------------------------------------------------------------


def assert_valid(fit, constraints, turn=True):
    """Certified, and so it looks on directions that are drawn here."""
    certificate = fit.certificate
    assert certificate.holds
    assert fit.result == Outcome.converged
    lowest = np.cos(certificate.max_theta)
    wi, wo = pairs_at_random(min_z=lowest)
    mirror = wi * jnp.asarray([[-1, -1, 1]], DTYPE)
    grazing = direction(jnp.full(60, certificate.max_theta - 1e-3, DTYPE), jnp.linspace(0, 6.2, 60, dtype=DTYPE))
    # Values in float32 are rounded where the model is evaluated, in proportion to the series, not to ρ.
    p = {"brdf": 0, "half_foreshortened": 0.5, "foreshortened": 1}[fit.model.target]
    for a, b in ((wi, wo), (wi, mirror), (wi, wi), (grazing, grazing[::-1]), (grazing, wi[:60])):
        if "non_negative" in constraints:
            allowed = MISSED + 30 * EPS * float(jnp.abs(fit.model.coefficients).max()) / (a[:, 2:] * b[:, 2:]) ** p
            assert np.all(fit.model(a, b) >= -allowed)
    if "energy" in constraints:
        edge = jnp.maximum(wo[:, 2:], 0.05)
        outgoing = jnp.concatenate([wo[:, :2] / jnp.linalg.norm(wo[:, :2], axis=1, keepdims=True)
                                    * jnp.sqrt(1 - edge**2), edge], axis=1)[:40]
        assert np.all(albedo(fit.model, outgoing) <= 1 + (1e-4 if X64 else 1e-2))  # the rule's own error


@pytest.mark.parametrize("norm", ["A", "B", "C", "D", "E"])
@pytest.mark.parametrize("constraints", [("non_negative",), ("energy",), BOTH], ids=str)
def test_a_lobe_that_rings_is_certified(constraints, norm):
    """Bright enough to reflect more than comes in, so that either constraint has something to do."""
    basis, samples = BASIS, samples_of(lobe(0.3), 16, factor=12.0)
    free = project(basis, samples, norm=norm, reciprocity=False)
    rule = isotropic_pair_rule(16, dtype=DTYPE)
    assert negativity(free.model, rule).minimum < -0.1
    assert np.max(albedo(free.model, direction(jnp.linspace(0, 1.5, 16, dtype=DTYPE), jnp.zeros(16, DTYPE)))) > 1.1
    fit = project(basis, samples, norm=norm, constraints=constraints, reciprocity=False)
    assert_valid(fit, constraints)
    assert np.all(fit.relative >= free.relative)
    assert fit.certificate.active[0] > 0
    assert fit.certificate.smallest.dtype == DTYPE
