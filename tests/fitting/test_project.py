"""The closed form against numpy on the materialised design, and the laws of least squares."""

from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, SHR, HelmholtzBasis, IsotropicBasis, SphericalHarmonics, TensorBasis, Zernike
from hshjax.brdfs import LinearBRDF, OrenNayar
from hshjax.fitting import NORMS, _project, project, relative_error
from hshjax.fitting._blocks import fold
from hshjax.geometry import direction
from hshjax.quadrature import isotropic_pair_rule, pair_rule
from hshjax.samples import Samples
from tests.fitting import oracle
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close, directions, mostly_slow, slow_unless

EPS = float(jnp.finfo(DTYPE).eps)

BASES = {
    "tensor": TensorBasis(HSH(1)),
    "helmholtz": HelmholtzBasis(Zernike(2)),
    "isotropic": IsotropicBasis(SHR(2), bilateral=False),
    "isotropic_bilateral": IsotropicBasis(HSH(3)),
}
SMALL = BASES["helmholtz"]
N = 900
"""Scattered samples: so many that the design is well determined, in one shape, so that little is compiled."""

each_norm = pytest.mark.parametrize("norm", mostly_slow(NORMS, ["A", "D"]))
# Every norm and every basis; the other combinations cost a compilation each and run in `make test-slow`.
KEPT = (("tensor", "A"), ("isotropic", "A"), ("isotropic", "D"), ("isotropic", "E"))
each_norm_and_basis = pytest.mark.parametrize(
    ("basis", "norm"),
    [
        slow_unless((name, norm) in KEPT, basis, norm, id=f"{name}-{norm}")
        for name, basis in BASES.items()
        for norm in NORMS
    ],
)


def normal(seed, *shape):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), DTYPE)


def coefficients_of(basis, channels=2, seed=0):
    return normal(seed, len(basis.modes), channels)


@lru_cache
def scattered(basis, norm, n=N, min_z=0.05):
    """Samples of a BRDF in the span (first two channels) and of noise (the third), under uneven weights."""
    wi, wo = directions(1, n, min_z=min_z), directions(2, n, min_z=min_z)
    inside = oracle.values(LinearBRDF(basis, coefficients_of(basis), NORMS[norm].target), wi, wo)
    value = jnp.concatenate([inside, normal(3, n, 1)], axis=1)
    return Samples.scattered(wi, wo, value, jnp.asarray(np.random.default_rng(4).uniform(0.2, 2, n), DTYPE))


def least_squares_tolerance(condition):
    """Wedin's bound for a residual as large as the data, eps x condition², with room for the rows' own rounding."""
    return max(TOLERANCE, 10 * EPS * float(condition) ** 2)


def fine_rule(basis):
    """Exact for the basis, and with nodes enough below 80 degrees for norm E."""
    degree = 2 * basis.basis.order + 4
    isotropic = isinstance(basis, IsotropicBasis)
    return isotropic_pair_rule(degree, dtype=DTYPE) if isotropic else pair_rule(degree, dtype=DTYPE)


def assert_coefficients(fit, expected):
    assert_close(fit.model.coefficients, expected, tolerance=least_squares_tolerance(fit.condition))


# --- recovery, and the oracle -----------------------------------------------------------------------------------------


@each_norm_and_basis
def test_scattered_samples(basis, norm):
    """Channels in the span are recovered; all equal numpy's least squares; figures are those of the fit."""
    samples = scattered(basis, norm)
    fit = project(basis, samples, norm=norm, reciprocity=False)
    assert_coefficients(fit, oracle.least_squares(basis, samples, norm))
    assert_close(
        fit.model.coefficients[:, :2],
        coefficients_of(basis),
        tolerance=max(TOLERANCE, 30 * EPS * float(fit.condition)),  # no residual: the first power of the condition
    )
    assert (fit.norm, fit.method, fit.samples, fit.unknowns) == (norm, "QR", N, len(basis.modes))
    assert fit.model.target == oracle.TARGETS[norm]
    assert fit.model.coefficients.dtype == DTYPE
    assert (fit.covariance, fit.noise, fit.reciprocity_before, fit.reciprocity_after) == (None, None, None, None)
    exact = oracle.condition(basis, samples, norm)
    assert exact / 3 <= fit.condition <= exact * (1 + 1e-3)
    residual, size = oracle.judged(fit.model, samples, norm)
    # The residual of what is in the span is rounding, relative to the size of the data.
    assert_close(fit.residual / size, residual / size, tolerance=max(TOLERANCE, 30 * EPS * float(fit.condition)))
    assert_close(fit.relative, fit.residual / size)
    assert np.all(fit.relative[:2] < 1e-4)
    assert fit.relative[2] > 0.5


@each_norm_and_basis
def test_nodes_of_an_exact_rule(basis, norm):
    """Inner products under a flat weight; QR elsewhere; the one equals the other."""
    rule = fine_rule(basis)
    model = LinearBRDF(basis, coefficients_of(basis), NORMS[norm].target)
    inside = oracle.values(model, rule.wi, rule.wo)
    outside = (rule.wi[:, 2:] - rule.wo[:, :1]) ** 3
    value = jnp.concatenate([inside, outside], axis=1)
    samples = Samples.from_function(lambda wi, wo: value, rule)
    fit = project(basis, samples, norm=norm, reciprocity=False)
    assert fit.method == ("inner products" if norm in "BCD" else "QR")
    assert_coefficients(fit, oracle.least_squares(basis, samples, norm))
    tolerance = max(TOLERANCE, 30 * EPS * float(fit.condition))
    assert_close(fit.model.coefficients[:, :2], coefficients_of(basis), tolerance=tolerance)
    if norm in "BCD":
        assert fit.condition == 1
        by_qr = project(basis, samples.reweighted(samples.weight), norm=norm, reciprocity=False)
        assert by_qr.method == "QR"
        assert_coefficients(by_qr, fit.model.coefficients)
        assert_close(by_qr.residual, fit.residual, tolerance=least_squares_tolerance(by_qr.condition))


def test_a_rule_that_is_not_exact_enough_is_solved_by_qr():
    rule = pair_rule(3, dtype=DTYPE)
    samples = Samples.from_function(LinearBRDF(SMALL, coefficients_of(SMALL)), rule)
    assert rule.degree < 2 * SMALL.basis.order
    fit = project(SMALL, samples, norm="C", ridge=1e-6, reciprocity=False)
    assert fit.method == "QR"


def test_isotropic_nodes_do_not_determine_a_basis_that_is_not():
    rule = isotropic_pair_rule(8, dtype=DTYPE)
    samples = Samples.from_function(OrenNayar(0.5, 0.3), rule)
    with pytest.raises(ValueError, match=r"say nothing of how HelmholtzBasis.* fit an IsotropicBasis"):
        project(SMALL, samples)


# --- penalties --------------------------------------------------------------------------------------------------------


def gamma_of(basis, prior, ridge):
    orders = np.array([[a[0], b[0]] for a, b in basis.modes], float)
    diagonal = {
        None: np.ones(len(orders)),
        "spectral": (orders[:, 0] * (orders[:, 0] + 1) + orders[:, 1] * (orders[:, 1] + 1)) ** 2,
        "array": np.linspace(0, 3, len(orders)),
    }[prior]
    return ridge * diagonal, (diagonal if prior == "array" else prior)


@pytest.mark.parametrize("norm", ["A", "D"])
@pytest.mark.parametrize("prior", [None, "spectral", "array"])
def test_penalties_are_rows_below_the_design(prior, norm):
    gamma, asked = gamma_of(SMALL, prior, 3.0)
    samples = scattered(SMALL, norm)
    fit = project(SMALL, samples, norm=norm, ridge=3.0, prior=asked, reciprocity=False)
    expected = oracle.least_squares(SMALL, samples, norm, gamma)
    assert_coefficients(fit, expected)
    free = oracle.least_squares(SMALL, samples, norm)
    assert np.abs(expected - free).max() > 1e-3  # the penalty is felt


@pytest.mark.parametrize("n", [1, 12])
def test_fewer_samples_than_unknowns_with_a_ridge(n):
    gamma, _ = gamma_of(SMALL, None, 0.1)
    samples = scattered(SMALL, "D", n)
    fit = project(SMALL, samples, ridge=0.1, reciprocity=False)
    assert_coefficients(fit, oracle.least_squares(SMALL, samples, "D", gamma))


def test_a_spectral_prior_leaves_the_constant_free():
    samples = scattered(SMALL, "C")
    lambert = Samples(samples.wi, samples.wo, jnp.full((N, 1), 0.25, DTYPE), samples.weight)
    fit = project(SMALL, lambert, norm="C", ridge=1e3, prior="spectral", reciprocity=False)
    assert_close(oracle.values(fit.model, samples.wi, samples.wo), lambert.value, tolerance=max(TOLERANCE, 100 * EPS))


# --- laws -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("norm", ["A", "D"])
def test_linear_in_the_data(norm):
    samples = scattered(SMALL, norm)

    def coefficients(value):
        new = Samples(samples.wi, samples.wo, value, samples.weight)
        return project(SMALL, new, norm=norm, reciprocity=False).model.coefficients

    a, b = samples.value, normal(7, N, 3)
    combined = coefficients(2.0 * a - 0.5 * b)
    assert_close(combined, 2.0 * coefficients(a) - 0.5 * coefficients(b), tolerance=max(TOLERANCE, 1e3 * EPS))


def test_channels_do_not_know_of_each_other():
    samples = scattered(SMALL, "A")
    together = project(SMALL, samples, norm="A", reciprocity=False)
    for c in range(3):
        one = Samples(samples.wi, samples.wo, samples.value[:, c : c + 1], samples.weight)
        alone = project(SMALL, one, norm="A", reciprocity=False)
        assert_coefficients(alone, together.model.coefficients[:, c : c + 1])
        assert_close(alone.condition, together.condition, tolerance=1e-3)


def test_the_order_of_samples_does_not_matter():
    samples = scattered(SMALL, "A")
    order = np.random.default_rng(5).permutation(N)
    shuffled = jax.tree.map(lambda a: a[order], samples)
    fit, other = (project(SMALL, s, norm="A", reciprocity=False) for s in (samples, shuffled))
    assert_coefficients(other, fit.model.coefficients)
    assert_close(other.residual / fit.residual[2], fit.residual / fit.residual[2], tolerance=max(TOLERANCE, 1e3 * EPS))


def test_weights_count_repetitions():
    samples = scattered(SMALL, "A")
    times = np.random.default_rng(6).integers(0, 3, N)
    weighted = project(SMALL, samples.reweighted(jnp.asarray(times, DTYPE)), norm="A", reciprocity=False)
    repeated = jax.tree.map(lambda a: jnp.repeat(a, times, axis=0), samples)
    counted = project(SMALL, repeated.reweighted(jnp.ones(times.sum(), DTYPE)), norm="A", reciprocity=False)
    assert_coefficients(weighted, counted.model.coefficients)
    assert_close(weighted.relative[2], counted.relative[2], tolerance=max(TOLERANCE, 1e3 * EPS))


@pytest.mark.parametrize("n", mostly_slow([4095, 4096, 4097, 8192, 10_000], [4097, 10_000]))
def test_any_number_of_samples_around_the_block(n):
    basis = IsotropicBasis(HSH(1))
    samples = scattered(basis, "A", n)
    fit = project(basis, samples, norm="A", reciprocity=False)
    assert_coefficients(fit, oracle.least_squares(basis, samples, "A"))
    residual, _ = oracle.judged(fit.model, samples, "A")
    assert_close(fit.residual[2], residual[2], tolerance=max(TOLERANCE, 100 * EPS))


@pytest.mark.parametrize(("n", "rows"), [(20, 7), (21, 7), (5, 7), (7, 7), (1, 7), (0, 7), (20, 1)])
def test_a_fold_sees_every_sample_once(n, rows):
    """Blocks overlap: a sample that comes back has weight 0."""
    w = jnp.tile(jnp.asarray([[0, 0, 1]], DTYPE), (n, 1))
    index = jnp.arange(n, dtype=DTYPE)
    samples = Samples.scattered(w, w, index[:, None], 1 + index)

    def visit(sums, wi, wo, value, weight):
        return sums + jnp.stack([jnp.sum(weight), jnp.sum(weight * value[:, 0])])

    i = np.arange(n)
    assert_close(fold(samples, rows, jnp.zeros(2, DTYPE), visit), [np.sum(1 + i), np.sum((1 + i) * i)])


# --- masks ------------------------------------------------------------------------------------------------------------


@each_norm
def test_masked_samples_do_not_enter_whatever_they_hold(norm):
    samples = scattered(SMALL, norm)
    mask = np.arange(N) % 7 == 3
    kept = jax.tree.map(lambda a: a[~mask], samples)
    rows = np.flatnonzero(mask)
    masked = Samples(
        # Tables of measurements hold values below the horizon, and mask them.
        samples.wi.at[rows[: rows.size // 2], 2].multiply(-1),
        samples.wo,
        samples.value.at[rows].set(jnp.nan).at[rows[::2]].set(jnp.inf),
        samples.weight.at[rows].set(0),
    )
    fit = project(SMALL, masked, norm=norm, reciprocity=norm == "B")
    expected = project(SMALL, kept, norm=norm, reciprocity=False)
    assert_coefficients(fit, expected.model.coefficients)
    tolerance = max(TOLERANCE, 30 * EPS * float(fit.condition))
    assert_close(fit.relative, expected.relative, tolerance=tolerance)
    if norm == "B":
        assert fit.reciprocity_after.relative < 100 * EPS


def test_masked_directions_that_are_not_finite():
    samples = scattered(SMALL, "D")
    masked = Samples(samples.wi.at[5].set(jnp.nan), samples.wo, samples.value, samples.weight.at[5].set(0))
    kept = samples.reweighted(samples.weight.at[5].set(0))
    fit, expected = (project(SMALL, s, reciprocity=False) for s in (masked, kept))
    assert_coefficients(fit, expected.model.coefficients)


# --- conditioning -----------------------------------------------------------------------------------------------------

# A narrow cap of directions makes an ill-conditioned design of any basis. The float32 leg takes a wider one: there
# eps x condition² is of order 1 at condition 3e3 already.
CAP = 0.9 if X64 else 0.6
CAP_BASIS = IsotropicBasis(HSH(2))


def cap_samples(n=N):
    wi, wo = directions(1, n, min_z=CAP), directions(2, n, min_z=CAP)
    value = oracle.values(LinearBRDF(CAP_BASIS, coefficients_of(CAP_BASIS, 1)), wi, wo)
    return Samples.scattered(wi, wo, value)


def test_the_condition_number_is_not_squared():
    samples = cap_samples()
    truth = np.asarray(coefficients_of(CAP_BASIS, 1), np.float64)
    condition = oracle.condition(CAP_BASIS, samples, "C")
    fit = project(CAP_BASIS, samples, norm="C", reciprocity=False)
    assert (1e5 < condition < 1e8) if X64 else (300 < condition < 1e4)
    assert condition / 3 <= fit.condition <= condition * 1.05

    design, target = (a.astype(DTYPE) for a in oracle.weighted_design(CAP_BASIS, samples, "C"))
    normal_equations = np.linalg.solve(design.T @ design, design.T @ target)

    def error(coefficients):
        return np.linalg.norm(np.asarray(coefficients, np.float64) - truth) / np.linalg.norm(truth)

    # The values themselves are rounded, and so are the rows: a few eps, times the condition number.
    assert error(fit.model.coefficients) < 10 * EPS * condition
    assert error(normal_equations) > 30 * error(fit.model.coefficients)


@pytest.mark.parametrize("power", [0, 1, 3, 5] + [8, 11] * X64)
def test_condition_estimate_of_a_triangular_matrix(power):
    """Spectra that are spread evenly, the hard case for power iterations."""
    n = 60
    rng = np.random.default_rng(power)
    u, v = (np.linalg.qr(rng.normal(size=(n, n)))[0] for _ in range(2))
    root = np.linalg.qr(u @ np.diag(np.logspace(0, -power, n)) @ v)[1]
    estimate = float(_project._condition(jnp.asarray(root, DTYPE)))
    assert 10.0**power / 3 <= estimate <= 10.0**power * (1 + 1e-3 if X64 else 3)  # float32 at 1e5: eps x condition


def test_an_exact_singularity_is_infinite():
    root = jnp.triu(jnp.ones((5, 5), DTYPE)).at[4, 4].set(0)
    assert _project._condition(root) == jnp.inf


# --- the posterior ----------------------------------------------------------------------------------------------------


@each_norm
@pytest.mark.parametrize("ridge", [0.0, 2.0])
def test_posterior_covariance_and_noise(ridge, norm):
    samples = scattered(SMALL, norm)
    settings = {"ridge": ridge, "prior": "spectral"} if ridge else {}
    gamma, _ = gamma_of(SMALL, "spectral", ridge)
    fit = project(SMALL, samples, norm=norm, covariance=True, reciprocity=False, **settings)
    design, target = oracle.weighted_design(SMALL, samples, norm)
    gram = design.T @ design
    covariance = np.linalg.inv(gram + np.diag(gamma))
    tolerance = max(TOLERANCE, 10 * EPS * oracle.condition(SMALL, samples, norm) ** 2)
    scale = np.abs(covariance).max()
    assert_close(fit.covariance / scale, covariance / scale, tolerance=tolerance)
    assert fit.covariance.shape == (len(SMALL.modes),) * 2

    misfit = target - design @ np.asarray(fit.model.coefficients, np.float64)
    counted = np.count_nonzero(np.any(design != 0, axis=1))
    freedom = counted - np.trace(covariance @ gram)
    expected = np.sum(misfit**2, axis=0) / freedom
    assert_close(fit.noise / expected[2], expected / expected[2], tolerance=max(TOLERANCE, 1e3 * EPS))


@pytest.mark.parametrize("norm", ["A", "C", "E"])
def test_error_bars_are_calibrated(norm):
    """200 fits to noise of the variance that the weights promise: chi² per unknown, and the estimate of the noise."""
    trials, sigma = 200, 0.3
    samples = scattered(SMALL, norm)
    weight = np.asarray(samples.weight * NORMS[norm].fit_weight(samples.wi, samples.wo), np.float64)
    truth = coefficients_of(SMALL, 1)
    model = LinearBRDF(SMALL, truth, NORMS[norm].target)
    clean = np.asarray(oracle.values(model, samples.wi, samples.wo), np.float64)
    noise = np.random.default_rng(8).normal(size=(N, trials)) * sigma
    value = clean + noise / np.sqrt(np.where(weight > 0, weight, 1))[:, None]
    noisy = Samples(samples.wi, samples.wo, jnp.asarray(value, DTYPE), samples.weight)
    fit = project(SMALL, noisy, norm=norm, covariance=True, reciprocity=False)

    error = np.asarray(fit.model.coefficients - truth, np.float64)
    chi2 = np.einsum("kt,kl,lt->t", error, np.linalg.inv(np.asarray(fit.covariance, np.float64)), error) / sigma**2
    unknowns, counted = len(SMALL.modes), np.count_nonzero(weight)
    # Four standard deviations of the mean over the trials; chi² of k degrees has variance 2k.
    assert abs(np.mean(chi2) / unknowns - 1) < 4 * np.sqrt(2 / (unknowns * trials))
    bound = 4 * np.sqrt(2 / ((counted - unknowns) * trials))
    assert abs(np.mean(np.asarray(fit.noise)) / sigma**2 - 1) < bound


def test_posterior_on_an_exact_rule_is_that_of_qr():
    samples = Samples.from_function(OrenNayar(0.5, 0.3), pair_rule(8, dtype=DTYPE))
    fit = project(SMALL, samples, norm="C", covariance=True, reciprocity=False)
    assert fit.method == "QR"
    assert_close(fit.covariance, np.eye(len(SMALL.modes)), tolerance=max(TOLERANCE, 100 * EPS))


# --- reciprocity ------------------------------------------------------------------------------------------------------


def lopsided(wi, wo):
    """ρ = 1 + z_i - z_o: its reciprocal part is 1."""
    return 1 + wi[..., 2:] - wo[..., 2:]


def swapped_pairs(function, n=N // 2):
    wi, wo = directions(1, n, min_z=0.05), directions(2, n, min_z=0.05)
    wi, wo = jnp.concatenate([wi, wo]), jnp.concatenate([wo, wi])
    return Samples.scattered(wi, wo, function(wi, wo))


def violation(function, samples):
    wi, wo, weight = oracle.host(samples.wi, samples.wo, samples.weight)
    here, there = oracle.host(function(samples.wi, samples.wo), function(samples.wo, samples.wi))
    mass = (weight * wi[:, 2] * wo[:, 2])[:, None]
    return np.sqrt(np.sum(mass * (here - there) ** 2) / np.sum(mass * here**2))


def test_a_reciprocal_basis_filters_the_violation_out():
    samples = swapped_pairs(lopsided)
    fit = project(SMALL, samples, norm="C")
    assert_close(fit.reciprocity_before.relative, violation(lopsided, samples))
    assert fit.reciprocity_before.relative > 0.3
    assert fit.reciprocity_before.pairs == N
    assert fit.reciprocity_after.relative < 100 * EPS
    assert_close(
        oracle.values(fit.model, samples.wi, samples.wo), jnp.ones((N, 1)), tolerance=max(TOLERANCE, 100 * EPS)
    )


def test_a_tensor_basis_keeps_it():
    samples = swapped_pairs(lopsided)
    fit = project(TensorBasis(HSH(1)), samples, norm="C")
    assert_close(fit.reciprocity_after.relative, fit.reciprocity_before.relative, tolerance=max(TOLERANCE, 100 * EPS))
    assert_close(fit.relative, [0], tolerance=max(TOLERANCE, 100 * EPS))


def test_the_nodes_of_a_rule_have_partners():
    fit = project(IsotropicBasis(HSH(2)), Samples.from_function(lopsided, isotropic_pair_rule(8, dtype=DTYPE)))
    assert fit.reciprocity_before.relative > 0.3
    assert fit.reciprocity_after.relative < 100 * EPS


def test_samples_without_partners_say_nothing_of_reciprocity():
    fit = project(SMALL, scattered(SMALL, "D"))
    assert fit.reciprocity_before.pairs == 0
    assert np.isnan(fit.reciprocity_before.relative)


def test_reciprocity_is_measured_unasked_only_where_it_is_cheap(monkeypatch):
    samples = swapped_pairs(lopsided)
    monkeypatch.setattr(_project, "SEARCHED", N)
    assert project(SMALL, samples).reciprocity_before is not None
    monkeypatch.setattr(_project, "SEARCHED", N - 1)
    fit = project(SMALL, samples)
    assert (fit.reciprocity_before, fit.reciprocity_after) == (None, None)
    assert project(SMALL, samples, reciprocity=True).reciprocity_before.pairs == N


# --- transformations, dtypes ------------------------------------------------------------------------------------------


def fit_of_values(value, norm, **settings):
    samples = scattered(SMALL, norm)
    return project(SMALL, Samples(samples.wi, samples.wo, value, samples.weight), norm=norm, **settings)


@pytest.mark.parametrize("norm", ["A", "D"])
def test_jit(norm):
    samples = scattered(SMALL, norm)
    fit = jax.jit(lambda s: project(SMALL, s, norm=norm))(samples)
    expected = project(SMALL, samples, norm=norm, reciprocity=False)
    assert_coefficients(fit, expected.model.coefficients)
    assert_close(fit.relative[2], expected.relative[2], tolerance=max(TOLERANCE, 100 * EPS))
    assert (fit.norm, fit.method, fit.samples) == (norm, "QR", N)
    assert fit.reciprocity_before is None


def test_an_undetermined_fit_under_jit_is_not_finite_in_its_condition_or_coefficients():
    samples = scattered(SMALL, "D", 12)
    fit = jax.jit(lambda s: project(SMALL, s))(samples)
    assert not np.all(np.isfinite(fit.model.coefficients)) or fit.condition > 1 / (len(SMALL.modes) * EPS)


@pytest.mark.slow
@pytest.mark.parametrize("norm", ["A", "D"])
def test_a_batch_of_materials(norm):
    values = normal(9, 3, N, 2)
    batch = jax.vmap(lambda value: fit_of_values(value, norm))(values)
    assert batch.model.coefficients.shape == (3, len(SMALL.modes), 2)
    for k in range(3):
        alone = fit_of_values(values[k], norm, reciprocity=False)
        assert_coefficients(alone, batch.model.coefficients[k])
        assert_close(batch.relative[k], alone.relative, tolerance=max(TOLERANCE, 100 * EPS))


@pytest.mark.slow
def test_inner_products_of_a_batch():
    rule = pair_rule(8, dtype=DTYPE)
    values = normal(9, 3, rule.weight.size, 1)
    coefficients = jax.vmap(
        lambda value: project(SMALL, Samples.from_function(lambda wi, wo: value, rule)).model.coefficients
    )(values)
    one = project(SMALL, Samples.from_function(lambda wi, wo: values[1], rule), reciprocity=False)
    assert one.method == "inner products"
    assert_close(coefficients[1], one.model.coefficients)


@pytest.mark.parametrize("settings", [{"norm": "A"}, {"norm": "C", "ridge": 0.5}], ids=str)
def test_gradient_with_respect_to_the_values(settings):
    """The coefficients are linear in the values: a difference is exact, whatever its step.

    Channels in the span leave R of [sqrt(w) B, sqrt(w) f] with zeros on its diagonal, where the derivative of a QR
    factorisation must not reach.
    """
    value = scattered(SMALL, settings["norm"]).value
    weights, direction = normal(10, len(SMALL.modes), 3), normal(11, N, 3)

    @jax.jit
    def loss(value):
        return jnp.sum(weights * fit_of_values(value, **settings).model.coefficients)

    gradient = jax.grad(loss)(value)
    expected = loss(value + direction) - loss(value)
    assert_close(jnp.sum(gradient * direction), expected, tolerance=max(TOLERANCE, 1e4 * EPS))


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="differences need float64")
def test_gradient_of_the_residual():
    value, direction = scattered(SMALL, "D").value[:, 2:], normal(11, N, 1)

    @jax.jit
    def error(value):
        return fit_of_values(value, "D").relative.sum()

    step = 1e-5
    slope = (error(value + step * direction) - error(value - step * direction)) / (2 * step)
    # The difference quotient is good to step² and eps / step.
    assert_close(jnp.sum(jax.grad(error)(value) * direction), slope, tolerance=1e-7)


@pytest.mark.skipif(not X64, reason="needs both dtypes")
def test_dtypes_follow_the_samples():
    samples = scattered(SMALL, "A")
    single = jax.tree.map(lambda a: a.astype(jnp.float32), samples)
    fit = project(SMALL, single, norm="A", covariance=True, reciprocity=False)
    for leaf in jax.tree.leaves(eqx.filter(fit, eqx.is_inexact_array)):
        assert leaf.dtype == jnp.float32
    expected = project(SMALL, samples, norm="A", reciprocity=False)
    tolerance = 10 * float(jnp.finfo(jnp.float32).eps) * float(expected.condition) ** 2
    assert_close(fit.model.coefficients, expected.model.coefficients, tolerance=tolerance)
    mixed = Samples(samples.wi, single.wo, single.value, single.weight)
    assert project(SMALL, mixed, norm="A", reciprocity=False).model.coefficients.dtype == jnp.float64


@pytest.mark.slow
def test_a_part_of_a_rule_is_no_rule():
    """Who slices or masks the arrays of samples leaves `degree` behind: the weights tell."""
    rule = fine_rule(SMALL)
    whole = Samples.from_function(LinearBRDF(SMALL, coefficients_of(SMALL), "foreshortened"), rule)
    masked = eqx.tree_at(lambda s: s.weight, whole, jnp.where(rule.wi[:, 2] > 0.05, rule.weight, 0))
    for part in (jax.tree.map(lambda a: a[::2], whole), masked):
        fit = project(SMALL, part, reciprocity=False)
        assert fit.method == "QR"
        assert_coefficients(fit, oracle.least_squares(SMALL, part, "D"))
        assert fit.samples == int(jnp.sum(part.weight > 0))


def test_a_basis_of_the_sphere_has_no_inner_products_on_the_hemisphere():
    basis = IsotropicBasis(SphericalHarmonics(1))
    samples = Samples.from_function(OrenNayar(0.5, 0.3), isotropic_pair_rule(8, dtype=DTYPE))
    assert project(basis, samples, reciprocity=False).method == "QR"


def test_no_noise_is_known_where_every_sample_is_met():
    count = IsotropicBasis(HSH(1)).count
    samples = scattered(IsotropicBasis(HSH(1)), "C", count)
    fit = project(IsotropicBasis(HSH(1)), samples, norm="C", covariance=True, reciprocity=False)
    assert jnp.all(jnp.isnan(fit.noise))


def test_nothing_compared_is_no_agreement():
    grazing = jnp.asarray([[np.sqrt(1 - 0.05**2), 0, 0.05]], DTYPE)
    samples = Samples.scattered(grazing, grazing, jnp.ones((1, 1), DTYPE))
    assert jnp.isnan(relative_error(OrenNayar(0.5, 0.3), samples, "E")[0])


def test_ninety_degrees_in_float32_are_the_horizon():
    wi = direction(jnp.radians(jnp.asarray([0.0, 30.0, 60.0, 90.0], jnp.float32)), jnp.zeros(4, jnp.float32))
    samples = Samples.scattered(wi, wi[::-1], jnp.ones((4, 1), jnp.float32))
    assert project(IsotropicBasis(HSH(0)), samples, norm="C").samples == 4
