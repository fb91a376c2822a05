"""Derivatives with respect to directions and coefficients: at pole and horizon, and against differences."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases._base import BLOCK
from tests.bases import oracles
from tests.bases.cases import ALL_BASES, ALL_PAIRS, EVERY_BASIS, SOME_PAIRS
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close, directions, mostly_slow

ORDER = 5
TINY = jnp.finfo(DTYPE)
PLACES = {
    "inside": [[0.48, 0.6, 0.64], [-0.36, 0.48, 0.8]],
    "pole": [[0, 0, 1]],
    "horizon": [[1, 0, 0], [0.6, -0.8, 0]],
    "just above": [[0.6, -0.8, 1e-6]],
    "around": [[1, 0, z] for z in (-0.1, -0.0, TINY.tiny, TINY.eps**2, 3 * TINY.eps**2, TINY.eps)],
}
EDGES = [*PLACES["pole"], *PLACES["horizon"]]


def array(values):
    return jnp.asarray(values, DTYPE)


def normal(seed: int, *shape: int):
    return array(np.random.default_rng(seed).normal(size=shape))


@lru_cache
def jets(name: str) -> dict[str, list[np.ndarray]]:
    """Value, gradient (forward, reverse) and Hessian of every function, `(points, modes, ...)`, at the places above."""
    basis = ALL_BASES[name](ORDER)
    jet = jax.jit(jax.vmap(lambda w: (basis(w), jax.jacfwd(basis)(w), jax.jacrev(basis)(w), jax.hessian(basis)(w))))
    found = jet(array([w for place in PLACES.values() for w in place]))
    ends = np.cumsum([len(place) for place in PLACES.values()])[:-1]
    parts = [np.split(np.asarray(d, np.float64), ends) for d in found]
    return {place: [part[i] for part in parts] for i, place in enumerate(PLACES)}


# --- finite at the edges ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL_BASES)
def test_derivatives_are_finite_at_the_edges(name):
    """First and second derivatives of the row at the pole and on, just above and below the horizon."""
    for place, derivatives in jets(name).items():
        assert all(np.all(np.isfinite(d)) for d in derivatives), place
    for place in ("inside", "pole", "horizon"):
        _, forward, reverse, _ = jets(name)[place]
        assert_close(forward / 100, reverse / 100)  # derivatives of size 100


def test_derivatives_of_sums_are_finite_at_the_edges():
    """The same of `evaluate`, of odd HSH above all, and of the gradient of a gradient."""
    basis = ALL_BASES["hsh"](ORDER)
    c, w = normal(0, len(basis.modes), 2), array([*EDGES, *PLACES["around"]])

    def loss(w):
        return jnp.sum(basis.evaluate(c, w) ** 2)

    def slope(w):
        return jnp.sum(jax.grad(loss)(w) ** 2)

    found = jax.jit(jax.vmap(lambda w: (loss(w), jax.grad(loss)(w), jax.hessian(loss)(w), jax.grad(slope)(w))))(w)
    assert all(bool(jnp.all(jnp.isfinite(d))) for d in found)


@pytest.mark.parametrize("m_is_one", [True, False])
def test_odd_hsh_have_zero_derivatives_on_the_horizon_by_convention(m_is_one):
    """For m = 1 the true derivative in z is infinite, as the values just above show."""
    basis = ALL_BASES["hsh"](ORDER)
    columns = np.array([abs(m) == 1 if m_is_one else abs(m) in (3, 5) for _, m in basis.modes])
    value, gradient, _, hessian = (d[:, columns] for d in jets("hsh")["horizon"])
    assert np.all(value == 0)
    assert np.all(gradient == 0)
    assert np.all(hessian == 0)
    above = jets("hsh")["just above"][1][:, columns]
    assert (np.max(np.abs(above)) > 100) == m_is_one


# --- finite differences of the oracle ---------------------------------------------------------------------------------

DIRECTIONS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]])
"""First and second derivatives along these six determine the gradient and the Hessian."""


def differences(function, w, along, nodes):
    """First and second derivative of t -> function(w + t along) at 0, exact for polynomials through the nodes."""
    step = 1e-2
    powers = np.vander(nodes, increasing=True).T
    first, second = np.eye(nodes.size)[1], 2 * np.eye(nodes.size)[2]
    values = function(w + step * nodes[:, None] * along)
    return (np.linalg.solve(powers, d) @ values / step**k for k, d in ((1, first), (2, second)))


@pytest.mark.parametrize("name", ALL_BASES)
@pytest.mark.parametrize("place", ["inside", "pole", "horizon"])
def test_derivatives_are_the_differences_of_the_formula(name, place):
    """Nine nodes: one-sided where z is 0 (below, the function is constant in z), even m of HSH there.

    Tolerances: (1e-2)^8 times a ninth derivative is near 1e-8 of the largest derivative; second derivatives
    lose two digits more. In float32 the roundings of order 5, squared, are added to the library's side.
    """
    basis = ALL_BASES[name](ORDER)
    nodes = np.arange(0.0, 9.0) if place == "horizon" else np.arange(-4.0, 5.0)
    smooth = np.array([name != "hsh" or place != "horizon" or m % 2 == 0 for _, m in basis.modes])
    _, gradient, _, hessian = (d[:, smooth] for d in jets(name)[place])

    def formula(w):
        return oracles.cartesian(name, ORDER, w)[:, smooth]

    for p, w in enumerate(np.array(PLACES[place], np.float64)):
        for along in DIRECTIONS:
            first, second = differences(formula, w, along, nodes)
            assert_close(gradient[p] @ along / 10, first / 10, tolerance=1e-6 if X64 else 2e-5)
            assert_close(hessian[p] @ along @ along / 100, second / 100, tolerance=1e-5 if X64 else 1e-4)


# --- evaluate and the row agree ---------------------------------------------------------------------------------------


def losses(basis):
    """A nonlinear function of (coefficients, *directions), by `evaluate` and by the design row."""

    def fused(c, *w):
        return jnp.sum(jnp.sin(basis.evaluate(c, *w)))

    def by_row(c, *w):
        return jnp.sum(jnp.sin(basis(*w) @ c))

    return fused, by_row


@pytest.mark.parametrize("name", mostly_slow(ALL_BASES, ["hsh"]))
def test_gradients_of_evaluate_are_those_of_the_row(name):
    """With more points than a block; and second derivatives, mixed ones too, on a few points."""
    basis, w = EVERY_BASIS[name](3), directions(0, BLOCK + 300, min_z=0.01)
    c = normal(1, len(basis.modes), 2)
    fused, by_row = (jax.jit(jax.grad(f, (0, 1))) for f in losses(basis))
    for a, b in zip(fused(c, w), by_row(c, w), strict=True):
        # float32: a sum of 1324 terms, and gradients of size 30 near the horizon.
        assert_close(a, b, tolerance=TOLERANCE if X64 else 1e-3)
    if name != "hsh":  # the derivatives are the same code for all
        return
    fused, by_row = (jax.jit(jax.hessian(f, (0, 1))) for f in losses(basis))
    few = directions(2, 3, min_z=0.2)
    for a, b in zip(jax.tree.leaves(fused(c, few)), jax.tree.leaves(by_row(c, few)), strict=True):
        assert_close(a, b, tolerance=TOLERANCE if X64 else 1e-3)  # float32: second derivatives of size 100


@pytest.mark.parametrize("name", mostly_slow(SOME_PAIRS, ["helmholtz-zernike", "isotropic-hsh"]))
def test_gradients_of_pair_evaluate_are_those_of_the_row(name):
    pairs, basis = ALL_PAIRS[name]
    pairs = pairs(basis(2))
    wi, wo = directions(3, 700, min_z=0.05), directions(4, 700, min_z=0.05)  # more than a block of 512
    c = normal(5, len(pairs.modes), 2)
    fused, by_row = (jax.jit(jax.grad(f, (0, 1, 2))) for f in losses(pairs))
    for a, b in zip(fused(c, wi, wo), by_row(c, wi, wo), strict=True):
        assert_close(a, b, tolerance=TOLERANCE if X64 else 1e-3)  # float32: sums of 700 terms


@pytest.mark.parametrize("name", ["helmholtz-hsh", "isotropic-hsh"])
def test_derivatives_of_pairs_are_finite_at_the_edges(name):
    pairs, basis = ALL_PAIRS[name]
    pairs = pairs(basis(3))
    c = normal(6, len(pairs.modes))
    edges = array(EDGES)
    wi, wo = jnp.repeat(edges, 3, axis=0), jnp.tile(edges, (3, 1))
    both = jnp.stack([wi, wo], 1)
    found = jax.jit(jax.vmap(jax.hessian(lambda w: pairs.evaluate(c, w[0], w[1]))))(both)
    assert bool(jnp.all(jnp.isfinite(found)))
    assert found.shape == (9, 2, 3, 2, 3)


@pytest.mark.skipif(not X64, reason="finite differences of the program itself need float64")
def test_gradients_are_finite_differences():
    """Central differences of `evaluate` along random tangents of coefficients and directions, and of its gradient."""
    basis, w = ALL_BASES["hsh"](3), directions(7, 6, min_z=0.2)
    c = normal(8, len(basis.modes), 2)
    dc, dw, step = normal(9, *c.shape), normal(10, *w.shape), 1e-5
    loss = losses(basis)[0]

    @jax.jit
    def along(t):
        value, gradient = jax.value_and_grad(loss, (0, 1))(c + t * dc, w + t * dw)
        return value, jnp.sum(gradient[0] * dc) + jnp.sum(gradient[1] * dw)

    (low, slope_low), (high, slope_high) = along(-step), along(step)
    # Truncation step² x third derivative, near 1e-10 x 1e4; rounding 1e-14 / step.
    assert_close(along(0.0)[1], (high - low) / (2 * step), tolerance=1e-5)
    curvature = jax.jvp(lambda t: along(t)[1], (0.0,), (1.0,))[1]
    assert_close(curvature, (slope_high - slope_low) / (2 * step), tolerance=1e-4)


def test_gradient_in_coefficients_is_the_sum_of_the_rows():
    basis, w = EVERY_BASIS["spherical"](3), directions(11, 5)
    c = normal(12, len(basis.modes))
    gradient = jax.jit(jax.grad(lambda c: jnp.sum(basis.evaluate(c, w))))(c)
    assert_close(gradient, np.asarray(basis(w)).sum(0))
