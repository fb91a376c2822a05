"""Projection by moments: the same as by QR."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, SHR, HelmholtzBasis, IsotropicBasis, Zernike
from hshjax.brdfs import HalfVectorTable, Lambert
from hshjax.fitting import project, project_by_moments
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, directions

BASES = {
    "HSH": IsotropicBasis(HSH(4)),
    "HSH of order 0": IsotropicBasis(HSH(0)),
    "Zernike": IsotropicBasis(Zernike(5)),
    "SHR": IsotropicBasis(SHR(3)),
    "HSH, not bilateral": IsotropicBasis(HSH(3), bilateral=False),
}


def samples(n: int = 6000, channels: int = 2) -> Samples:
    """Noise, with what fits cannot explain, some of it masked and not finite."""
    rng = np.random.default_rng(0)
    value, weight = rng.uniform(0, 1, (n, channels)), rng.uniform(0, 1, n)
    weight[:100] = 0
    value[:50] = np.nan
    wi, wo = directions(1, n, min_z=0.02), directions(2, n, min_z=0.02)
    return Samples.scattered(wi, wo, jnp.asarray(value, DTYPE), jnp.asarray(weight, DTYPE), isotropic=True)


@pytest.mark.parametrize("norm", ["A", "C", "D", "E"])
@pytest.mark.parametrize("name", BASES)
def test_the_same_as_by_qr(name, norm):
    basis, given = BASES[name], samples()
    expected = project(basis, given, norm=norm, reciprocity=False)
    fit = project_by_moments(basis, given, norm=norm)
    assert (fit.method, fit.samples, fit.unknowns) == ("moments", expected.samples, expected.unknowns)
    assert fit.model.coefficients.dtype == DTYPE
    # QR is in float32 in that leg.
    tolerance = 1e-10 if X64 else 2e-4
    assert_close(fit.model.coefficients, expected.model.coefficients, tolerance=tolerance)
    assert_close(fit.residual, expected.residual, tolerance=tolerance)
    assert_close(fit.relative, expected.relative, tolerance=tolerance)
    assert_close(fit.condition, expected.condition, tolerance=1e-9 if X64 else 1e-2)


def test_ridge_and_prior():
    given = samples()
    expected, fit = (solve(BASES["HSH"], given, ridge=3.0, prior="spectral") for solve in (project, project_by_moments))
    assert fit.method == "moments"
    assert_close(fit.model.coefficients, expected.model.coefficients, tolerance=1e-10 if X64 else 2e-4)


def test_an_exact_fit_has_its_small_residual():
    """Where a difference of squares would be nothing but rounding."""
    if not X64:
        pytest.skip("the reference is exact in float64 only")
    basis, given = BASES["HSH"], samples()
    truth = jnp.asarray(np.random.default_rng(3).normal(size=(basis.count, 2)))
    series = basis.evaluate(truth, given.wi, given.wo) / (given.wi[:, 2] * given.wo[:, 2])[:, None]
    noisy = series * (1 + 1e-5 * jnp.asarray(np.random.default_rng(4).normal(size=series.shape)))
    exact = Samples.scattered(given.wi, given.wo, noisy, given.weight, isotropic=True)
    fit, expected = project_by_moments(basis, exact), project(basis, exact, reciprocity=False)
    assert float(fit.relative.max()) < 1e-4
    np.testing.assert_allclose(fit.relative, expected.relative, rtol=1e-9)


def test_other_bases_go_to_qr():
    basis = HelmholtzBasis(HSH(1))
    given = samples(400)
    given = Samples.scattered(given.wi, given.wo, given.value, given.weight)
    fit = project_by_moments(basis, given)
    assert fit.method == "QR"
    assert_close(fit.model.coefficients, project(basis, given).model.coefficients)


def test_badly_conditioned_samples_go_to_qr():
    """All within 20 degrees of the normal."""
    basis, n = IsotropicBasis(HSH(3)), 3000
    wi, wo = directions(5, n, min_z=0.94), directions(6, n, min_z=0.94)
    given = Samples.scattered(wi, wo, wi[:, :1] ** 2 + wo[:, :1] ** 2, isotropic=True)
    fit = project_by_moments(basis, given, ridge=1e-12 if X64 else 1e-4)
    assert fit.method == "QR"


def test_what_is_refused():
    with pytest.raises(ValueError, match="lower the order"):
        project_by_moments(BASES["HSH"], samples(120))
    with pytest.raises(ValueError, match="norm must be"):
        project_by_moments(BASES["HSH"], samples(), norm="Z")


def table(mirror: bool = True, holes: bool = False) -> HalfVectorTable:
    """Noise; nodes of φ_d with mirror images, or without; lines with holes, which hold no number."""
    rng = np.random.default_rng(8)
    h, d, f = (np.arange(n) / n for n in (24, 16, 24))
    values = rng.uniform(0.1, 1, (24, 16, 24, 3))
    measured = None
    if holes:
        measured = rng.uniform(size=values.shape[:3]) < 0.7
        measured[3, 4] = measured[:, :, 5] = False
        values = np.where(measured[..., None], values, np.nan)
        measured = jnp.asarray(measured)
    phi_d = (f if mirror else f**1.1) * np.pi
    axes = (jnp.asarray(x, DTYPE) for x in (values, h**2 * np.pi / 2, d * np.pi / 2, phi_d))
    return HalfVectorTable(*axes, measured=measured)


def test_nodes_of_a_table_folded_or_not():
    basis, given = BASES["HSH"], table()
    expected = project(basis, given.node_samples(), reciprocity=False)
    for folded in (False, True):
        fit = project_by_moments(basis, given.node_samples(folded=folded))
        assert fit.method == "moments"
        assert_close(fit.model.coefficients, expected.model.coefficients, tolerance=1e-10 if X64 else 2e-4)
    assert np.all(np.asarray(fit.residual) < np.asarray(expected.residual))


@pytest.mark.parametrize(("name", "norm", "mirror", "holes"), [
    ("HSH", "D", True, False), ("HSH", "A", False, True), ("HSH", "E", True, True), ("HSH of order 0", "D", True, True),
    ("Zernike", "D", True, True), ("SHR", "C", False, False), ("HSH, not bilateral", "D", True, True),
])  # fmt: skip
def test_a_table_line_by_line(name, norm, mirror, holes):
    basis, given = BASES[name], table(mirror, holes)
    expected = project(basis, given.node_samples(folded=basis.bilateral), norm=norm, reciprocity=False)
    fit = project_by_moments(basis, given, norm=norm)
    assert (fit.method, fit.samples) == ("moments", expected.samples)
    assert fit.model.coefficients.dtype == DTYPE
    tolerance = 1e-10 if X64 else 5e-4
    assert_close(fit.model.coefficients, expected.model.coefficients, tolerance=tolerance)
    assert_close(fit.residual, expected.residual, tolerance=tolerance)
    assert_close(fit.condition, expected.condition, tolerance=1e-9 if X64 else 1e-2)


def test_a_table_that_cannot_be_fitted():
    given = table()
    broken = eqx.tree_at(lambda t: t.values, given, given.values.at[2, 3, 4, 1].set(jnp.nan))
    with pytest.raises(ValueError, match="NaN or infinite values"):
        project_by_moments(BASES["HSH"], broken)
    few = eqx.tree_at(lambda t: t.measured, given, jnp.zeros(given.values.shape[:3], bool).at[5, 2:4].set(True),
                      is_leaf=lambda leaf: leaf is None)  # fmt: skip
    with pytest.raises(ValueError, match="lower the order"):
        project_by_moments(BASES["HSH"], few)


def test_a_table_of_few_nodes_goes_to_qr():
    basis = IsotropicBasis(HSH(8))
    fit = project_by_moments(basis, table())
    assert fit.method == "QR"
    expected = project(basis, table().node_samples(folded=True), reciprocity=False)
    assert_close(fit.model.coefficients, expected.model.coefficients)


def test_what_moments_do_not_pay_for_goes_to_project():
    """Few samples, and the nodes of an exact rule."""
    basis = IsotropicBasis(HSH(4))
    assert project_by_moments(basis, samples(1000)).method == "QR"
    rule = Samples.from_function(Lambert(jnp.asarray([0.5], DTYPE)), isotropic_pair_rule(40, dtype=DTYPE))
    assert project_by_moments(basis, rule).method == "inner products"


def test_values_of_half_precision():
    """The dtype of the result is that of `project`."""
    given = samples()
    ones = Samples.scattered(given.wi, given.wo, jnp.ones((given.size, 1), jnp.float16), given.weight, isotropic=True)
    fit, expected = project_by_moments(BASES["SHR"], ones), project(BASES["SHR"], ones, reciprocity=False)
    assert fit.method == "moments"
    assert fit.model.coefficients.dtype == expected.model.coefficients.dtype
    assert_close(fit.model.coefficients, expected.model.coefficients, tolerance=1e-10 if X64 else 2e-4)
