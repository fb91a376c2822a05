"""The half-vector basis against its formula in angles, and the laws that it promises."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.special import eval_jacobi, roots_legendre

from hshjax.bases import HalfVectorBasis, IdentityWarp, LogWarp, RationalWarp, RootWarp, total_order
from hshjax.geometry import from_half_difference
from tests.helpers import DTYPE, X64, assert_close, directions, mostly_slow

WARPS = {
    "identity": IdentityWarp(),
    "root": RootWarp(),
    "rational": RationalWarp(jnp.asarray(0.03)),
    "log": LogWarp(jnp.asarray(0.003)),
}
SMOOTH = ["identity", "rational", "log"]
PAIRS = [*((name, "identity") for name in WARPS), ("log", "log"), ("identity", "rational"), ("rational", "root")]
"""Of warps: of the half angle, and of the difference angle."""
TABLE = total_order(30, bilateral=False)

EYE, UP = [0.6, 0.0, 0.8], [0.0, 0, 1]
DEGENERATE = [
    *[(EYE, EYE), (UP, UP), (EYE, [-0.6, 0, 0.8]), (EYE, [0.8, 0, 0.6]), ([1.0, 0, 0], [-1.0, 0, 0])],
    *[([1.0, 0, 0], [0, 1.0, 0]), ([1.0, 0, 0], UP), ([1.0, 0, 0], [1.0, 0, 0])],
]
"""Equal directions, the normal, mirror pairs, the horizon."""


def u_of(name, o):
    """By the formula, in float64."""
    o = np.asarray(o, np.float64)
    return {
        "identity": lambda: o,
        "root": lambda: np.sqrt(o),
        "rational": lambda: 1.03 * o / (o + 0.03),
        "log": lambda: np.log1p(o / 0.003) / np.log1p(1 / 0.003),
    }[name]()


def rows_in_angles(table, names, theta_h, theta_d, phi_d):
    u, v = (u_of(name, 1 - np.cos(theta)) for name, theta in zip(names, (theta_h, theta_d), strict=True))
    columns = []
    for a, n, m in table:
        k = abs(m)
        half = np.sqrt(2 * a + 1) * u ** (k / 2) * eval_jacobi(a - k // 2, 0, k, 2 * u - 1)
        difference = np.sqrt(n + 1) * v ** (k / 2) * eval_jacobi((n - k) // 2, 0, k, 2 * v - 1)
        phase = np.sqrt(2) * np.cos(m * phi_d) if m > 0 else np.sqrt(2) * np.sin(k * phi_d) if m else 1.0
        columns.append(half * difference * phase)
    return np.stack(columns, axis=-1)


def make(table, names):
    return HalfVectorBasis(table, *(WARPS[name] for name in names))


def angles_of_pairs(n=60):
    rng = np.random.default_rng(0)
    return rng.uniform(0, 1.2, n), rng.uniform(0, 1.2, n), rng.uniform(-np.pi, np.pi, n)


# --- warps ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WARPS)
def test_warps_run_from_0_to_1(name):
    o = jnp.linspace(0, 1, 1001, dtype=DTYPE)
    u = WARPS[name](o)
    assert_close(u, u_of(name, o))
    assert u[0] == 0
    assert np.all(np.diff(u) > 0)
    assert_close(u[-1], 1.0)


@pytest.mark.parametrize("alpha", [1e-6, 1e-2, 1.0])
def test_the_log_warp_near_0(alpha):
    """Either side of where its series takes over, to rounding of a few units."""
    x = [1e-12, 1e-5, 3e-3, 9.9e-3, 1.01e-2, 0.5]
    o = jnp.asarray(np.array(x) * alpha, DTYPE)
    warp = LogWarp(jnp.asarray(alpha, DTYPE))
    exact = [mpmath.log1p(mpmath.mpf(float(p)) / float(warp.alpha)) / mpmath.mpf(float(p)) for p in o]
    expected = np.array([float(e / mpmath.log1p(1 / mpmath.mpf(float(warp.alpha)))) for e in exact])
    np.testing.assert_allclose(warp.ratio(o), expected, rtol=100 * np.finfo(DTYPE).eps)


def test_root_warp_has_a_derivative_at_0():
    assert jax.grad(RootWarp())(jnp.zeros((), DTYPE)) == 0


@pytest.mark.parametrize("warp", [LogWarp, RationalWarp])
@pytest.mark.parametrize(("alpha", "message"), [(0.0, "alpha > 0, got 0.0"), (np.ones(2), r"scalar alpha, got shape")])
def test_scales_that_are_refused(warp, alpha, message, unchecked):
    with pytest.raises(ValueError, match=message):
        warp(alpha)


# --- functions --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", mostly_slow(PAIRS, [*PAIRS[:5]]), ids="-".join)
def test_rows_are_the_formula_in_angles(names):
    """And fused sums are sums of rows."""
    angles = angles_of_pairs()
    basis = make(TABLE, names)
    rows = basis(*from_half_difference(*(jnp.asarray(a, DTYPE) for a in angles)))
    expected = rows_in_angles(TABLE, names, *angles)
    assert_close(rows, expected, tolerance=1e-9 if X64 else 2e-3)
    assert_close(
        basis.evaluate(jnp.ones((30, 2), DTYPE), *from_half_difference(*(jnp.asarray(a, DTYPE) for a in angles))),
        np.repeat(rows.sum(1, keepdims=True), 2, axis=1),
        tolerance=1e-10 if X64 else 1e-3,
    )


@pytest.mark.skipif(not X64, reason="a Gram matrix in float64")
@pytest.mark.parametrize("names", [("rational", "identity"), ("identity", "log")], ids="-".join)
def test_functions_are_orthonormal(names):
    """For du dv dφ / 2π, on a rule that is exact for them; pairs below the horizon count as well."""
    node, weight = roots_legendre(16)
    node, weight = (node + 1) / 2, weight / 2
    phi = 2 * np.pi * (np.arange(24) + 0.3) / 24
    o = {"identity": node, "rational": 0.03 * node / (1.03 - node), "log": 0.003 * np.expm1(node * np.log1p(1 / 0.003))}
    grid = np.meshgrid(*(np.arccos(1 - o[name]) for name in names), phi, indexing="ij")
    rows = np.asarray(make(TABLE, names)(*from_half_difference(*(jnp.asarray(x.ravel()) for x in grid))))
    w = (weight[:, None, None] * weight[:, None] * np.full(24, 1 / 24)).ravel()
    assert np.abs((rows * w[:, None]).T @ rows - np.eye(30)).max() < 1e-11


@pytest.mark.parametrize("names", [("log", "identity"), ("log", "log")], ids="-".join)
def test_laws(names):
    """Reciprocity to the bit; isotropy; bilateral symmetry of cosines, antisymmetry of sines."""
    basis, wi, wo = make(TABLE, names), directions(0, 50), directions(1, 50)
    rows = basis(wi, wo)
    np.testing.assert_array_equal(rows, basis(wo, wi))
    turn = jnp.asarray([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]], DTYPE)
    tolerance = 1e-10 if X64 else 1e-3
    assert_close(basis(wi @ turn.T, wo @ turn.T), rows, tolerance=tolerance)
    mirror, sign = jnp.asarray([1.0, -1, 1], DTYPE), np.array([1.0 if m >= 0 else -1.0 for *_, m in TABLE])
    assert_close(basis(wi * mirror[None], wo * mirror[None]), np.asarray(rows) * sign, tolerance=tolerance)
    assert basis.reciprocal
    assert basis.isotropic


@pytest.mark.parametrize("names", mostly_slow([(name, name) for name in SMOOTH], [("log", "log")]), ids="-".join)
def test_derivatives_where_angles_have_no_meaning(names):
    assert_finite_derivatives(make(TABLE, names))


def assert_finite_derivatives(basis):
    """Of first and second order where pairs are degenerate, and in the scales of its warps."""
    wi, wo = (jnp.asarray(side, DTYPE) for side in zip(*DEGENERATE, strict=True))
    arrays, static = eqx.partition(basis, eqx.is_array)

    def total(arrays, wi, wo):
        return jnp.sum(eqx.combine(arrays, static).evaluate(jnp.ones(basis.count, DTYPE), wi, wo))

    @jax.jit  # one program
    def everything(*arguments):
        gradient = jax.grad(total, (0, 1, 2))
        return total(*arguments), jax.jvp(gradient, arguments, jax.tree.map(jnp.ones_like, arguments))

    for leaf in jax.tree.leaves(everything(arrays, wi, wo)):
        assert np.all(np.isfinite(leaf))


@pytest.mark.skipif(not X64, reason="differences in float64")
def test_gradients_against_differences():
    """In coefficients, directions and the scales of both warps, at a mirror pair and at equal directions too."""
    wi = jnp.concatenate([directions(0, 4, min_z=0.2), jnp.asarray([[0.6, 0, 0.8], [0.6, 0, 0.8]])])
    wo = jnp.concatenate([directions(1, 4, min_z=0.2), jnp.asarray([[-0.6, 0, 0.8], [0.6, 0, 0.8]])])
    c = jnp.asarray(np.random.default_rng(0).normal(size=(12, 2)))

    @jax.jit
    def value(c, alphas, wi, wo):
        basis = HalfVectorBasis(total_order(12), *(LogWarp(jnp.asarray(alpha)) for alpha in alphas))
        return basis.evaluate(*map(jnp.asarray, (c, wi, wo)))

    alphas = jnp.asarray(0.05), jnp.asarray(0.08)
    check_grads(value, (c, alphas, wi, wo), order=1, modes=("fwd", "rev"), eps=1e-6, rtol=1e-6, atol=1e-6)


@pytest.mark.skipif(not X64, reason="least squares in float64")
def test_a_warp_of_the_difference_resolves_retro_reflection():
    """ln ρ of a lobe about wi = wo, 3 degrees wide, by least squares: an eighth of the error of the same functions."""
    theta_h, theta_d, phi = np.random.default_rng(0).uniform(size=(3, 600)) * [[1.2], [1.2], [np.pi]]
    theta_d **= 3  # denser at the lobe
    wi, wo = from_half_difference(*map(jnp.asarray, (theta_h, theta_d, phi)))
    target = np.log(0.1 + np.exp(-((theta_d / np.radians(3)) ** 2)))
    errors = {}
    for name in ("identity", "log"):
        rows = np.asarray(make([(a, n, 0) for a in range(3) for n in range(0, 14, 2)], ("identity", name))(wi, wo))
        c = np.linalg.lstsq(rows[::2], target[::2], rcond=None)[0]
        errors[name] = np.sqrt(np.mean((rows[1::2] @ c - target[1::2]) ** 2))
    assert errors["log"] < errors["identity"] / 8


def test_transforms():
    basis, wi, wo = HalfVectorBasis(20, WARPS["log"]), directions(0, 3, 5), directions(1, 3, 5)
    rows = basis(wi, wo)
    assert rows.shape == (3, 5, 20)
    assert rows.dtype == DTYPE
    assert_close(jax.jit(lambda b, i, o: b(i, o))(basis, wi, wo), rows, tolerance=1e-10 if X64 else 1e-4)
    assert_close(jax.vmap(basis)(wi, wo), rows, tolerance=1e-10 if X64 else 1e-4)
    assert basis(wi[:0], wo[:0]).shape == (0, 5, 20)
    many = jax.vmap(lambda alpha: HalfVectorBasis(5, LogWarp(alpha))(wi, wo))(jnp.asarray([0.1, 0.01], DTYPE))
    expected = HalfVectorBasis(5, LogWarp(jnp.asarray(0.01, DTYPE)))(wi, wo)
    assert_close(many[1], expected, tolerance=1e-10 if X64 else 1e-4)


# --- tables -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bilateral", [True, False])
def test_shorter_tables_are_prefixes(bilateral):
    long = total_order(200, bilateral=bilateral)
    assert len(set(long)) == 200
    assert long[:40] == total_order(40, bilateral=bilateral)
    assert all(m >= 0 for *_, m in long) == bilateral
    cost = [a / 1.4 + n / 2 + 1.2 * abs(m) for a, n, m in long]
    assert np.all(np.diff(cost) > -1e-12)


@pytest.mark.parametrize(
    ("functions", "message"),
    [
        (0, "at least one function, got a count of 0"),
        ((), "got an empty table"),
        ([(1, 1, 0)], "n and m even"),
        ([(3, 2, 1)], "n and m even"),
        ([(1, 2, 4)], r"\|m\| <= n"),
        ([(0, 2, 2)], r"\|m\| <= 2a"),
        ([(1, 2)], r"functions are \(a, n, m\)"),
        ([(1, 2, 0), (1, 2, 0)], "stands twice"),
    ],
)
def test_tables_that_are_refused(functions, message, unchecked):
    with pytest.raises(ValueError, match=message):
        HalfVectorBasis(functions)


@pytest.mark.parametrize("warps", [(0.1,), (IdentityWarp(), 0.1)])
def test_something_else_for_a_warp(warps, unchecked):
    with pytest.raises(ValueError, match=r"needs a warp, got 0\.1"):
        HalfVectorBasis(3, *warps)
