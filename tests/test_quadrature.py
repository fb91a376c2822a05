"""Every rule is exact to the degree that it states, and wrong above it."""

import numpy as np
import pytest

from hshjax.quadrature import (
    azimuth_nodes,
    graded_azimuths,
    hemisphere_rule,
    isotropic_pair_rule,
    pair_rule,
    polar_nodes,
)
from tests.helpers import DTYPE, assert_close

DEGREES = [0, 1, 2, 5, 8, 32]


@pytest.mark.parametrize("degree", DEGREES)
def test_polar_nodes(degree):
    """∫_0^1 z^a dz = 1 / (a + 1); the square of the polynomial that vanishes at the nodes integrates to 0 instead."""
    z, weight = polar_nodes(degree)
    assert np.all((z > 0) & (z < 1))
    for a in range(degree + 1):
        assert_close(weight @ z**a, 1 / (a + 1), tolerance=1e-14)
    missed = np.polynomial.legendre.Legendre.basis(degree // 2 + 1)(2 * z - 1) ** 2
    assert_close(weight @ missed, 0)
    assert abs(weight @ np.sqrt(z) - 2 / 3) > 1e-7


@pytest.mark.parametrize("degree", DEGREES)
def test_polar_nodes_with_square_roots(degree):
    """z^{a/2}, a <= 2 degree; above, the square of the polynomial in sqrt(z) that vanishes at the nodes is missed."""
    z, weight = polar_nodes(degree, sqrt=True)
    assert z.size == degree + 1
    for a in range(2 * degree + 1):
        assert_close(weight @ z ** (a / 2), 1 / (a / 2 + 1), tolerance=1e-14)
    missed = np.polynomial.legendre.Legendre.basis(degree + 1)(2 * np.sqrt(z) - 1) ** 2
    assert_close(weight @ missed, 0)


@pytest.mark.parametrize("degree", DEGREES)
def test_azimuth_nodes(degree):
    """∫ cos bφ = 0 for b <= degree, and aliased to 2π at degree + 1."""
    phi = azimuth_nodes(degree)
    weight = 2 * np.pi / phi.size
    for b in range(1, degree + 1):
        assert_close([weight * np.cos(b * phi).sum(), weight * np.sin(b * phi).sum()], [0, 0], tolerance=1e-12)
    assert_close(weight * np.cos((degree + 1) * phi).sum(), 2 * np.pi, tolerance=1e-12)


def test_negative_degree_is_refused():
    for rule in (hemisphere_rule, pair_rule, isotropic_pair_rule):
        with pytest.raises(ValueError, match="degree must be >= 0, got -1"):
            rule(-1)


@pytest.mark.parametrize("sqrt", [False, True])
@pytest.mark.parametrize("degree", [0, 1, 4, 7])
def test_hemisphere_rule(degree, sqrt):
    """Unit directions above the horizon, weights with sum 2π, z^a cos bφ exact; cosines are not in the weights."""
    rule = hemisphere_rule(degree, sqrt=sqrt, dtype=DTYPE)
    w, weight = np.asarray(rule.w, np.float64), np.asarray(rule.weight, np.float64)
    assert rule.degree == degree
    assert rule.w.dtype == rule.weight.dtype == DTYPE
    assert_close(np.linalg.norm(w, axis=-1), np.ones(len(w)))
    assert_close(weight.sum(), 2 * np.pi)
    z, phi = w[:, 2], np.arctan2(w[:, 1], w[:, 0])
    assert np.all(z > 0)
    for a in range(degree + 1):
        for b in range(degree + 1):
            exact = 2 * np.pi / (a + 1) if b == 0 else 0
            assert_close([weight @ (z**a * np.cos(b * phi)), weight @ (z**a * np.sin(b * phi))], [exact, 0 * exact])
    assert_close(weight @ np.cos((degree + 1) * phi), 2 * np.pi)
    root = weight @ np.sqrt(z) - 4 * np.pi / 3
    assert (abs(root) < 1e-5) == (sqrt and degree > 0)


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_pair_rule_is_the_product_of_two(degree):
    rule, one = pair_rule(degree, dtype=DTYPE), hemisphere_rule(degree, dtype=DTYPE)
    assert rule.weight.shape == (one.weight.size**2,)
    assert (rule.degree, rule.isotropic) == (degree, False)
    assert_close(rule.weight.sum(), (2 * np.pi) ** 2)

    def moments(w, weight):
        return np.asarray(weight) @ np.asarray(w) ** degree

    product = np.multiply.outer(moments(*one[:2]), moments(*one[:2]))
    found = np.einsum("p,pa,pb->ab", rule.weight, np.asarray(rule.wi) ** degree, np.asarray(rule.wo) ** degree)
    assert_close(found, product)


@pytest.mark.parametrize("degree", [2, 3])
def test_isotropic_rule_is_the_full_one_for_isotropic_integrands(degree):
    """Polynomials in z_i, z_o and x_i x_o + y_i y_o; an integrand that is not isotropic comes out wrong."""

    def isotropic(wi, wo):
        cosine = wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]
        return (1 + wi[:, 2] - 0.5 * wo[:, 2]) * (1 + cosine) ** (degree - 1)

    def integral(function, rule):
        return float(np.asarray(rule.weight) @ np.asarray(function(rule.wi, rule.wo)))

    full, iso = pair_rule(2 * degree, dtype=DTYPE), isotropic_pair_rule(2 * degree, dtype=DTYPE)
    assert iso.isotropic
    assert iso.degree == 2 * degree
    assert_close(iso.weight.sum(), (2 * np.pi) ** 2)
    assert np.all(np.asarray(iso.wi)[:, 1] == 0)
    assert_close(integral(isotropic, iso), integral(isotropic, full))
    assert abs(integral(lambda wi, wo: wi[:, 0], iso) - integral(lambda wi, wo: wi[:, 0], full)) > 1


def test_azimuths_are_raised_and_lowered_alone():
    """More azimuths do not raise the degree; fewer lower it."""
    assert isotropic_pair_rule(4, azimuths=65).degree == 4
    assert isotropic_pair_rule(4, azimuths=65).weight.size == 3 * 3 * 65
    assert isotropic_pair_rule(4, azimuths=3).degree == 2
    assert_close(isotropic_pair_rule(4, azimuths=65).weight.sum(), (2 * np.pi) ** 2)


@pytest.mark.parametrize(("levels", "order"), [(3, 0), (10, 8), (14, 40)])
def test_graded_azimuths(levels, order):
    """Symmetric nodes in (-π, π); narrow lobes at 0 and at ±π, where as many equispaced ones fail, and cos² order φ."""
    phi, weight = graded_azimuths(levels, order)
    assert np.all(np.abs(phi) < np.pi)
    assert np.all(np.diff(phi) > 0)
    assert np.all(weight > 0)
    assert_close(phi, -phi[::-1], tolerance=1e-14)
    assert_close(weight.sum(), 2 * np.pi, tolerance=1e-13)
    if order:
        assert_close(weight @ np.cos(order * phi) ** 2, np.pi, tolerance=1e-12)
    width = 3 * np.pi / 2**levels
    even = azimuth_nodes(phi.size - 1)
    for centre in (0, np.pi):
        distance = np.minimum(np.abs(phi - centre), 2 * np.pi - np.abs(phi - centre))
        expected = np.sqrt(np.pi) * width
        if width < 0.1:  # the lobe is over before it meets its periodic image
            assert_close(weight @ np.exp(-((distance / width) ** 2)) / expected, 1, tolerance=1e-8)
            off = np.minimum(np.abs(even - centre), 2 * np.pi - np.abs(even - centre))
            coarse = np.exp(-((off / width) ** 2)).sum() * 2 * np.pi / even.size
            assert levels < 14 or abs(coarse / expected - 1) > 0.1
