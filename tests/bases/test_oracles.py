"""The bases against scipy, mpmath and closed forms, and their orthonormality."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special

from hshjax import HSH, SHR, SphericalHarmonics, Zernike, hemisphere_rule
from hshjax.geometry import to_disk, to_sphere
from tests.bases import oracles
from tests.bases.cases import ALL_BASES
from tests.helpers import DTYPE, X64, assert_close, directions

ORDERS = [0, 3, 32] if X64 else [0, 3, 16]
"""The functions of a lower order are the first columns of a higher one (see test_laws): these three cover the rest."""
ORACLE_TOLERANCE = 1e-12 if X64 else 5e-5
"""The issue's figures, absolute: the largest value of a function of order 32 is 4.5."""

PRECISIONS = [pytest.param(jnp.float64, marks=pytest.mark.skipif(not X64, reason="needs x64")), jnp.float32]
GRAM = {jnp.float64: ([0, 3, 32], 1e-12), jnp.float32: ([0, 3, 16], 5e-5)}


def closed_hemisphere(seed: int, n: int):
    """Random directions, the pole, and two directions on the horizon."""
    edges = jnp.asarray([[0, 0, 1], [1, 0, 0], [0.6, -0.8, 0]], DTYPE)
    return jnp.concatenate([directions(seed, n), edges])


# --- orthonormality ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", PRECISIONS)
@pytest.mark.parametrize("name", ALL_BASES)
def test_gram_is_the_identity(name, dtype):
    orders, bound = GRAM[dtype]
    for order in orders:
        rule = hemisphere_rule(2 * order, dtype=dtype)
        # Summed in float64 in either precision: the error of the functions is meant, not that of the sum.
        y, weight = np.asarray(ALL_BASES[name](order)(rule.w), np.float64), np.asarray(rule.weight, np.float64)
        assert rule.w.dtype == dtype
        assert np.max(np.abs(y.T @ (weight[:, None] * y) - np.eye(y.shape[1]))) <= bound


def test_gram_of_a_rule_too_coarse_is_not_the_identity():
    """The test above can fail: a rule that is exact to 2N - 2 only."""
    rule = hemisphere_rule(8, dtype=DTYPE)
    y = np.asarray(HSH(5)(rule.w), np.float64)
    assert np.max(np.abs(y.T @ (np.asarray(rule.weight)[:, None] * y) - np.eye(36))) > 0.1


@pytest.mark.parametrize("order", [0, 16])
def test_spherical_harmonics_are_orthonormal_on_the_sphere(order):
    """Gauss-Legendre in z over [-1, 1] x equispaced φ; the Gram matrix of the upper half alone is far from it."""
    z, weight = np.polynomial.legendre.leggauss(order + 1)
    phi = 2 * np.pi * np.arange(2 * order + 1) / (2 * order + 1)
    z, phi = (a.ravel() for a in np.meshgrid(z, phi, indexing="ij"))
    weight = np.repeat(weight, 2 * order + 1) * 2 * np.pi / (2 * order + 1)
    rim = np.sqrt(1 - z**2)
    y = SphericalHarmonics(order)(jnp.asarray(np.stack([rim * np.cos(phi), rim * np.sin(phi), z], -1), DTYPE))
    y = np.asarray(y, np.float64)
    error = np.abs(y.T @ (weight[:, None] * y) - np.eye((order + 1) ** 2)).max()
    assert error <= (1e-12 if X64 else 5e-5)


# --- values -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", ALL_BASES)
def test_values_are_the_formula_in_cartesian_components(name, order):
    """scipy's Jacobi polynomials (HSH, Zernike), moments orthonormalised in 80 digits (SHR); pole and horizon too."""
    w = closed_hemisphere(0, 10 if name == "shr" else 200)
    expected = oracles.cartesian(name, order, np.asarray(w))
    assert_close(ALL_BASES[name](order)(w), expected, tolerance=ORACLE_TOLERANCE)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", ["hsh", "zernike", "spherical"])
def test_values_are_the_formula_in_angles(name, order):
    """scipy's associated Legendre functions and Jacobi polynomials, with cos mφ and sin mφ.

    Away from the horizon, where odd HSH go like sqrt(z) and the z of the angle is already rounded; in float32 that
    square root costs digits further up as well.
    """
    w = np.asarray(directions(1, 200, min_z=1e-3 if X64 else 0.05), np.float64)
    theta, phi = np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2]), np.arctan2(w[:, 1], w[:, 0])
    basis = SphericalHarmonics(order) if name == "spherical" else ALL_BASES[name](order)
    actual = basis(jnp.asarray(w, DTYPE))
    assert_close(actual, oracles.angular(name, order, theta, phi), tolerance=ORACLE_TOLERANCE)


@pytest.mark.skipif(not hasattr(scipy.special, "sph_harm_y"), reason="sph_harm_y needs scipy >= 1.15")
def test_spherical_harmonics_are_those_of_scipy_on_the_whole_sphere():
    """Y^{±m} = sqrt2 (-1)^m Re|Im of scipy's complex function: the sign takes off the one of Condon and Shortley."""
    w = np.asarray(directions(2, 100), np.float64) * np.where(np.arange(100) % 2, 1, -1)[:, None]
    theta, phi = np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2]), np.arctan2(w[:, 1], w[:, 0])
    basis = SphericalHarmonics(12)
    for column, (n, m) in zip(np.asarray(basis(jnp.asarray(w, DTYPE))).T, basis.modes, strict=True):
        y = scipy.special.sph_harm_y(n, abs(m), theta, phi)
        part = y.real if m == 0 else math.sqrt(2) * (-1) ** m * (y.real if m > 0 else y.imag)
        assert_close(column, part)


def test_zernike_is_the_circle_polynomial_of_the_disk():
    """Z(u) = Z_disk(to_disk(u)) / sqrt2, with R_n^m by the sum over factorials."""
    w, basis = closed_hemisphere(3, 100), Zernike(12)
    x, y = np.asarray(to_disk(w), np.float64).T
    rho, phi = np.hypot(x, y), np.arctan2(y, x)
    for column, (n, m) in zip(np.asarray(basis(w)).T, basis.modes, strict=True):
        disk = math.sqrt((2 - (m == 0)) * (n + 1) / math.pi) * oracles.circle_polynomial(n, abs(m), rho)
        # In float32 ρ = 1 is rounded, and the derivative of R there is n (n + 2) / 2 at most: 85 roundings.
        azimuth = np.sin(-m * phi) if m < 0 else np.cos(m * phi)
        assert_close(column, disk * azimuth / math.sqrt(2), tolerance=None if X64 else 1e-4)


def test_hsh_is_the_spherical_harmonic_on_the_stretched_hemisphere():
    """HSH(u) = sqrt2 Y(to_sphere(u))."""
    w = closed_hemisphere(4, 100)
    expected = math.sqrt(2) * SphericalHarmonics(12)(to_sphere(w))
    assert_close(HSH(12)(w), expected, tolerance=None if X64 else 5e-5)  # float32: two ways to round s¹²


def test_zonal_zernike_is_zonal_hsh_at_twice_the_order():
    """Z_{2l}^0 = (-1)^l H_l^0."""
    w, hsh, zernike = closed_hemisphere(5, 100), HSH(8), Zernike(16)
    h, z = np.asarray(hsh(w)), np.asarray(zernike(w))
    for n in range(9):
        column = (-1) ** n * z[:, zernike.modes.index((2 * n, 0))]
        assert_close(column, h[:, hsh.modes.index((n, 0))])


def test_hsh_vanishes_on_the_horizon_but_for_the_zonal_ones():
    w = jnp.asarray([[1, 0, 0], [0.6, -0.8, 0]], DTYPE)
    zonal = np.array([m == 0 for _, m in HSH(6).modes])
    y = np.asarray(HSH(6)(w))
    assert np.all(y[:, ~zonal] == 0)
    assert np.all(np.abs(y[:, zonal]) > 0.1)
    assert np.any(np.abs(np.asarray(SHR(6)(w))[:, ~zonal]) > 0.1)


def test_cosine_is_tridiagonal_on_hsh():
    """<H_l^m, z H_l^m> = 1/2, <H_l^m, z H_{l+1}^m> = sqrt(((l+1)² - m²) / ((2l+1)(2l+3))) / 2, all else 0."""
    basis, rule = HSH(7), hemisphere_rule(15, dtype=DTYPE)
    y = basis(rule.w)
    actual = y.T @ ((rule.weight * rule.w[:, 2])[:, None] * y)

    def entry(a, b):
        (n, m), (p, q) = sorted([a, b])
        if m != q or p - n > 1:
            return 0.0
        return 0.5 if n == p else 0.5 * math.sqrt(((n + 1) ** 2 - m**2) / ((2 * n + 1) * (2 * n + 3)))

    assert_close(actual, [[entry(a, b) for b in basis.modes] for a in basis.modes])


def test_shr_spans_the_polynomials_of_its_degree():
    """Every monomial x^a y^b z^c with a + b + c <= N is its own projection."""
    order = 4
    rule, w = hemisphere_rule(2 * order, dtype=DTYPE), closed_hemisphere(6, 50)

    def monomials(w):
        powers = [(a, b, c) for a in range(5) for b in range(5 - a) for c in range(5 - a - b)]
        return np.stack([np.prod(np.asarray(w) ** np.array(power), -1) for power in powers], -1)

    coefficients = np.asarray(SHR(order)(rule.w)).T @ (np.asarray(rule.weight)[:, None] * monomials(rule.w))
    assert_close(np.asarray(SHR(order)(w)) @ coefficients, monomials(w))
