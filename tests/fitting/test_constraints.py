"""Physically valid fits: against closed forms and independent solvers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from hshjax.bases import HSH, SHR, HelmholtzBasis, IsotropicBasis, TensorBasis, Zernike
from hshjax.brdfs import GGX, CookTorrance, Lambert, Ward
from hshjax.fitting import NORMS, Outcome, project
from hshjax.fitting._certificate import STAGES, STRIDE, Certifier
from hshjax.fitting._constraints import NonNegative
from hshjax.fitting._least_distance import InfeasibleError, least_distance
from hshjax.fitting._search import _predict, follow
from hshjax.geometry import direction
from hshjax.io import read_rgl
from hshjax.metrics import albedo, negativity
from hshjax.quadrature import isotropic_pair_rule, pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close, directions, mostly_slow, slow_unless

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


@pytest.mark.slow
def test_a_lambertian_surface_brighter_than_white_becomes_white():
    """In norm A the multipliers κ z_o push along (κ z_i z_o / z_i z_o): the optimum is the constant of albedo 1."""
    fit = project(BASIS, samples_of(Lambert(jnp.asarray([1.4]))), norm="A", constraints=("energy",), reciprocity=False)
    wi, wo = pairs_at_random(50)
    assert_close(fit.model(wi, wo), np.full((50, 1), 1 / np.pi), tolerance=ASKED)
    assert_close(fit.certificate.albedo, [1], tolerance=ASKED)
    assert fit.certificate.albedo <= 1 + MISSED
    assert fit.certificate.holds
    assert fit.result == Outcome.converged


@pytest.mark.parametrize("norm", mostly_slow(NORMS, ["A", "D"]))
def test_a_negative_surface_becomes_black(norm):
    samples = samples_of(Lambert(jnp.asarray([0.2])), factor=-1.0)
    fit = project(BASIS, samples, norm=norm, constraints=("non_negative",), reciprocity=False)
    series = fit.model.basis.evaluate(fit.model.coefficients, *pairs_at_random(50))
    assert_close(series, np.zeros((50, 1)), tolerance=ASKED)
    assert fit.certificate.holds
    assert fit.certificate.smallest >= -MISSED


@pytest.mark.parametrize("norm", mostly_slow(["A", "C", "D"], ["A"]))
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


@pytest.mark.slow
def test_what_has_changed_is_looked_at_again_and_only_that(monkeypatch):
    certifier = Certifier(BASIS, "brdf", BOTH, np.dtype(np.float64))
    rng = np.random.default_rng(0)
    first = rng.normal(size=(BASIS.count, 40)) / 100  # more channels than one block holds
    first[0] += 1
    second = first.copy()
    second[:, [3, 35]] *= 1.1
    nothing = tuple([0] * 40), np.zeros(40)
    with jax.enable_x64(True):
        certifier.certify(first, 1, *nothing)
        looked = []
        descend = certifier.values._descended
        monkeypatch.setattr(
            certifier.values, "_descended", lambda column, at: looked.append(column) or descend(column, at)
        )
        again, _ = certifier.certify(second, 2, *nothing)
        anew, _ = Certifier(BASIS, "brdf", BOTH, np.dtype(np.float64)).certify(second, 2, *nothing)
    np.testing.assert_array_equal(looked, second[:, [3, 35]].T)
    # The same columns in blocks of other neighbours: the products round differently.
    assert_close(again.smallest, anew.smallest)
    assert_close(again.albedo, anew.albedo)


def test_a_grid_that_wraps_has_no_first_node():
    """What is predicted about a node does not depend on where the grid was cut open."""
    gap = np.random.default_rng(0).normal(size=(7, 8))
    nodes = np.argwhere(np.ones(gap.shape, bool))
    faces = (("passes", "ends"), ("wraps", "wraps"))
    step, predicted = _predict(gap, nodes, faces)
    for turn in (1, 7):
        rolled = _predict(np.roll(gap, turn, axis=1), nodes, faces)
        assert_close(rolled[0].reshape(7, 8, 2), np.roll(step.reshape(7, 8, 2), turn, axis=1))
        assert_close(rolled[1].reshape(7, 8), np.roll(predicted.reshape(7, 8), turn, axis=1))


@pytest.mark.skipif(not X64, reason="a search in float64")
@pytest.mark.parametrize("seed", mostly_slow(range(3), [0]))
def test_descents_end_at_minima_on_and_off_the_faces(seed):
    """A minimiser of another make finds nothing lower beside any end: minima lie within, at Δφ = 0, on the horizon."""
    family = NonNegative(BASIS, (0, 0), np.pi)
    rng = np.random.default_rng(seed)
    column = rng.normal(size=BASIS.count)
    start = rng.uniform(*family.box, (40, 3))
    gaps = jax.jit(jax.value_and_grad(lambda x: family.sums(jnp.asarray(column)[:, None], x[None])[0, 0]))
    found = follow(family, column, 0.0, start, np.full(3, STRIDE), STAGES[-1][1])
    for x, gap in zip(found.x, found.gap, strict=True):
        # Not the horizon itself, where derivatives in α are those of |cos(α/2)|.
        bounds = [
            (a - 0.02, min(a + 0.02, top)) for a, top in zip(x, (np.pi - 1e-9, np.pi - 1e-9, np.inf), strict=True)
        ]
        begin = np.clip(x, *np.transpose(bounds))
        oracle = minimize(lambda x: tuple(map(np.asarray, gaps(x))), begin, jac=True, bounds=bounds)
        assert oracle.fun >= gap - 1e-9
    assert np.any(np.abs(np.sin(found.x[:, 2])) < 1e-5)
    assert np.any(found.x[:, :2] > np.pi - 1e-5)


# --- certified fits ---------------------------------------------------------------------------------------------------


def assert_valid(fit, constraints):
    """Certified, and so it looks on directions that are drawn here."""
    assert fit.certificate.holds
    assert fit.result == Outcome.converged
    assert fit.certificate.pairs > 1000
    wi, wo = pairs_at_random(min_z=np.cos(fit.certificate.max_theta))
    mirror = wi * jnp.asarray([[-1, -1, 1]], DTYPE)
    p = {"brdf": 0, "half_foreshortened": 0.5, "foreshortened": 1}[fit.model.target]
    size = float(jnp.linalg.norm(fit.model.coefficients, axis=0).max())
    if "non_negative" in constraints:
        for a, b in ((wi, wo), (wi, mirror), (wi, wi)):
            # The model is evaluated in the dtype of the leg: its series is rounded in proportion to the coefficients.
            allowed = MISSED + 30 * EPS * size / (a[:, 2:] * b[:, 2:]) ** p
            assert np.all(fit.model(a, b) >= -allowed)
    if "energy" in constraints:
        outgoing = directions(13, 40, min_z=0.1)
        # The rule of the albedo is exact for the series, but not for a quotient of it or its square roots.
        assert np.all(albedo(fit.model, outgoing) <= 1 + 1e-3)


@pytest.mark.parametrize(
    ("constraints", "norm"),
    [slow_unless((c, norm) == (BOTH, "A"), c, norm) for c in (("non_negative",), ("energy",), BOTH) for norm in NORMS],
)
def test_a_lobe_that_rings_is_certified(constraints, norm):
    """Bright enough to reflect more than comes in, so that either constraint has something to do."""
    samples = samples_of(lobe(0.3), 16, factor=12.0)
    free = project(BASIS, samples, norm=norm, reciprocity=False)
    rule = isotropic_pair_rule(16, dtype=DTYPE)
    assert negativity(free.model, rule).minimum < -0.1
    assert np.max(albedo(free.model, direction(jnp.linspace(0, 1.5, 16, dtype=DTYPE), jnp.zeros(16, DTYPE)))) > 1.1
    fit = project(BASIS, samples, norm=norm, constraints=constraints, reciprocity=False)
    assert_valid(fit, constraints)
    assert np.all(fit.relative >= free.relative)
    assert fit.certificate.active[0] > 0
    assert fit.certificate.smallest.dtype == DTYPE


@pytest.mark.parametrize(
    ("basis", "norm"),
    [
        slow_unless(norm == "D" and name == "tensor", basis, norm, id=f"{name}-{norm}")
        for name, basis in {
            "tensor": TensorBasis(HSH(1)),
            "helmholtz": HelmholtzBasis(Zernike(2)),
            "isotropic": IsotropicBasis(SHR(3), bilateral=False),
        }.items()
        for norm in "AD"
    ],
)
@pytest.mark.slow
def test_other_bases(basis, norm):
    value = lobe(0.3)
    if isinstance(basis, IsotropicBasis):
        samples = samples_of(value)
    else:
        samples = Samples.from_function(lambda wi, wo: 12.0 * value(wi, wo), pair_rule(8, dtype=DTYPE))
    fit = project(basis, samples, norm=norm, constraints=BOTH, reciprocity=False)
    assert_valid(fit, BOTH)
    assert fit.certificate.active[0] > 0


@pytest.mark.slow
def test_the_optimum_of_a_discretised_problem():
    """An independent solver, on the inequalities at dense nodes: it may pass between them, and is a little nearer."""
    basis, samples = IsotropicBasis(HSH(1)), samples_of(lobe(0.3))
    fit = project(basis, samples, norm="C", constraints=("non_negative",), reciprocity=False)
    start = np.asarray(project(basis, samples, norm="C", reciprocity=False).model.coefficients, np.float64)[:, 0]
    theta, turn = np.pi / 2 * np.sin(np.linspace(0, np.pi / 2, 41)), np.linspace(0, np.pi, 41)
    ti, to, phi = (jnp.asarray(axis.ravel(), DTYPE) for axis in np.meshgrid(theta, theta, turn, indexing="ij"))
    rows = np.asarray(basis(direction(ti, jnp.zeros_like(ti)), direction(to, phi)), np.float64)
    oracle = minimize(
        lambda c: np.sum((c - start) ** 2),
        start,
        jac=lambda c: 2 * (c - start),
        constraints={"type": "ineq", "fun": lambda c: rows @ c, "jac": lambda c: rows},
        method="SLSQP",
        options={"ftol": 1e-12},
    )
    assert np.linalg.norm(oracle.x - start) > 0.01
    # Nodes are at most 0.06 apart; what a parabola does between them is of second order.
    assert_close(np.asarray(fit.model.coefficients)[:, 0], oracle.x, tolerance=1e-2 * np.linalg.norm(oracle.x - start))


@pytest.mark.skipif(not X64, reason="the material is fitted in float64")
@pytest.mark.parametrize("norm", [slow_unless(False, norm) for norm in "AD"])
def test_a_measured_material(norm, data):
    samples = read_rgl(data / "rgl" / "paper_white_rgb.bsdf").samples(isotropic_pair_rule(32))
    free = project(BASIS, samples, norm=norm, reciprocity=False)
    assert negativity(free.model, isotropic_pair_rule(16)).minimum < -0.1
    fit = project(BASIS, samples, norm=norm, constraints=BOTH, reciprocity=False)
    assert_valid(fit, BOTH)
    assert np.all(fit.relative < 1.5 * free.relative)


# --- derivatives, refusals --------------------------------------------------------------------------------------------


SMALL = IsotropicBasis(HSH(1))


def small_fit(value, **settings):
    rule = isotropic_pair_rule(4, dtype=DTYPE)
    samples = Samples(rule.wi, rule.wo, value, rule.weight, rule.degree, True)
    return project(SMALL, samples, constraints=("non_negative",), reciprocity=False, **settings)


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap, jax.jacfwd], ids=["jit", "vmap", "jacfwd"])
def test_values_must_be_seen(transform):
    value = jnp.ones((2, isotropic_pair_rule(4).weight.size, 1), DTYPE)
    with pytest.raises(ValueError, match=r"jax\.jit, jax\.vmap and jax\.grad hide"):
        transform(lambda v: small_fit(v).model.coefficients)(value if transform is jax.vmap else value[0])


@pytest.mark.parametrize("constraints", [("energy", "positive"), "energy"], ids=str)
def test_unknown_constraints(constraints, unchecked):
    with pytest.raises(ValueError, match="constraints must be a tuple of names among non_negative, energy"):
        project(SMALL, samples_of(Lambert(jnp.asarray([0.5]))), constraints=constraints)


def test_no_rounds():
    with pytest.raises(ValueError, match="rounds must be >= 1"):
        small_fit(jnp.ones((isotropic_pair_rule(4).weight.size, 1), DTYPE), rounds=0)


def test_a_constant_cannot_vanish_at_the_horizon():
    samples = samples_of(Lambert(jnp.asarray([0.5])))
    with pytest.raises(ValueError, match="raise its order"):
        project(IsotropicBasis(HSH(0)), samples, norm="D", constraints=BOTH)


def test_rounds_that_do_not_suffice():
    samples = samples_of(lobe(0.3), 16, factor=12.0)
    fit = project(BASIS, samples, norm="A", constraints=("non_negative",), reciprocity=False, rounds=1)
    assert fit.result == Outcome.uncertified
    assert not fit.certificate.holds
    assert fit.certificate.smallest < -MISSED


def deepest(brdf, channel, seed=0, starts=60):
    """The smallest value above the last tenth of a degree, by a minimiser that the library does not use."""

    def value(angles):
        theta, phi = jnp.minimum(jnp.abs(angles[:2]), 1.569), angles[2:]
        return brdf(direction(theta[0], phi[0]), direction(theta[1], phi[1]))[channel]

    both = jax.jit(jax.value_and_grad(value))
    rng = np.random.default_rng(seed)
    found = []
    for start in rng.uniform([0, 0, -np.pi, -np.pi], [1.569, 1.569, np.pi, np.pi], (starts, 4)):
        bounds = [(0, 1.569)] * 2 + [(-10, 10)] * 2
        found.append(minimize(lambda x: tuple(map(np.asarray, both(x))), start, jac=True, bounds=bounds).fun)
    return min(found)


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="a certificate in float32 allows for the rounding of coefficients")
@pytest.mark.parametrize(
    ("basis", "norm"),
    [
        (IsotropicBasis(Zernike(4)), "A"),
        (HelmholtzBasis(HSH(2)), "A"),
        (HelmholtzBasis(HSH(2)), "D"),
    ],
    ids=str,
)
def test_no_other_minimiser_finds_what_the_certificate_missed(basis, norm):
    narrow = Lambert(0.02) + (GGX(0.9, 0.15) if isinstance(basis, IsotropicBasis) else Ward(0.5, 0.2, 0.6))
    rule = isotropic_pair_rule(24) if isinstance(basis, IsotropicBasis) else pair_rule(8)
    data = Samples.from_function(narrow, rule)
    fit = project(basis, data, norm=norm, constraints=("non_negative",), reciprocity=False)
    assert fit.result == Outcome.converged
    assert deepest(fit.model, 0) >= -MISSED
