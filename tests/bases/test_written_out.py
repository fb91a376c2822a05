"""Short series, which are written out, against the products of matrices that all others are."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import (
    HSH,
    HalfVectorBasis,
    IsotropicBasis,
    RationalWarp,
    RootWarp,
    Zernike,
    _base,
    _pairs,
    _rows,
    _series,
    _written_out,
    total_order,
)
from tests.bases.cases import EVERY_BASIS
from tests.bases.test_laws import equations
from tests.helpers import DTYPE, assert_close, directions

POINTS = 33


def coefficients(count, channels=2):
    return jnp.asarray(np.random.default_rng(0).normal(size=(count, channels)), DTYPE)


def close(found, expected):
    scale = 1 + float(jnp.abs(expected).max())
    assert_close(found / scale, expected / scale)


@pytest.fixture(params=[True, False], ids=["at once", "one by one"])
def at_once(request, monkeypatch):
    if not request.param:
        monkeypatch.setattr(_written_out, "AT_ONCE", 0)


@pytest.mark.parametrize("order", [0, 3])
@pytest.mark.parametrize("name", EVERY_BASIS)
def test_the_same_as_products_of_matrices(name, order, at_once):
    basis, w = EVERY_BASIS[name](order), directions(0, POINTS, min_z=0.01)
    c = coefficients(basis.count)
    close(_written_out.sums(basis, c, w), _series.sums(basis, c, w))
    close(_written_out.rows(basis, w), _rows.rows(basis, w))
    close(_written_out.rows_by_mode(basis, w).T, _rows.rows(basis, w))


def test_long_results_come_in_blocks(monkeypatch):
    monkeypatch.setattr(_written_out, "WHOLE", 100)
    monkeypatch.setattr(_written_out, "VALUES", 60)
    basis, w = HSH(2), directions(0, POINTS)
    close(_written_out.rows(basis, w), _rows.rows(basis, w))


PAIRS = [
    IsotropicBasis(HSH(3)),
    IsotropicBasis(HSH(3), bilateral=False),
    IsotropicBasis(Zernike(4), bilateral=False),
    HalfVectorBasis(40),
    HalfVectorBasis(total_order(40, bilateral=False), warp=RootWarp(), difference_warp=RationalWarp(jnp.asarray(0.1))),
    HalfVectorBasis(((0, 0, 0),)),
]


@pytest.mark.parametrize("pairs", PAIRS, ids=lambda pairs: f"{type(pairs).__name__}-{pairs.count}")
def test_pairs_are_the_same_as_their_rows(pairs, at_once):
    wi, wo = directions(0, POINTS), directions(1, POINTS)
    c = coefficients(pairs.count)
    close(pairs.written_out_sums(c, wi, wo), _base.matmul(pairs(wi, wo), c))


def program_of(basis, channels, points):
    """Names of primitives."""
    program = jax.make_jaxpr(basis.evaluate)(coefficients(basis.count, channels), jnp.zeros((points, 3), DTYPE))
    return {equation.primitive.name for equation in equations(program.jaxpr)}


def test_which_are_short():
    assert _written_out.short(HSH(10).count, _written_out.CHANNELS)
    assert not _written_out.short(HSH(11).count, 1)
    assert not _written_out.short(HSH(8).count, _written_out.CHANNELS + 1)
    assert _written_out.short(HSH(1).count, _written_out.AT_ONCE // 4)
    assert not _written_out.short(HSH(8).count, 0)
    for order, written_out in ((10, True), (11, False)):
        assert ("dot_general" not in program_of(HSH(order), 3, 5)) == written_out
    w = jnp.zeros((1, 3), DTYPE)
    for pairs, longer in (
        (IsotropicBasis(HSH(10)), IsotropicBasis(HSH(11))),
        (HalfVectorBasis(200), HalfVectorBasis(201)),
    ):
        shape = jax.eval_shape(pairs.written_out_sums, coefficients(pairs.count, 3), w, w)
        assert shape.shape == (1, 3)
        assert longer.written_out_sums(coefficients(longer.count, 3), w, w) is None


def test_channels_share_a_kernel_beyond_some_coefficients():
    loops = [
        "scan" in program_of(HSH(7), channels, points)
        for channels, points in ((2, _written_out.FEW + 1), (3, _written_out.FEW), (3, _written_out.FEW + 1))
    ]
    assert loops == [False, False, True]


def test_a_kernel_inside_loops_and_batches():
    basis, w = HSH(2), directions(0, 24)
    c = coefficients(basis.count)
    expected = _series.sums(basis, c, w)
    close(jax.lax.map(lambda part: basis.evaluate(c, part), w.reshape(4, 6, 3)).reshape(24, 2), expected)
    close(jax.vmap(partial(basis.evaluate, c))(w), expected)
    close(jax.vmap(lambda one: basis.evaluate(one, w), 1, 1)(c), expected)


@pytest.mark.parametrize("value", [jnp.nan, jnp.inf])
def test_what_is_not_finite_is_not_hidden(value):
    basis, w = HSH(2), directions(0, 3)
    found = basis.evaluate(coefficients(basis.count), w.at[1].set(value))
    assert not np.isfinite(found[1]).any()
    assert np.isfinite(found[jnp.asarray([0, 2])]).all()


def test_a_sum_of_pairs_differentiates_as_its_blocks_do():
    pairs, wi, wo = IsotropicBasis(HSH(1)), directions(0, 5, min_z=0.1), directions(1, 5, min_z=0.1)
    c = coefficients(pairs.count)
    arrays, static = eqx.partition(pairs, eqx.is_array)
    looped = jax.grad(lambda w: jnp.sum(_pairs._block_sums(static, arrays, c, w, wo)))(wi)
    close(jax.grad(lambda w: jnp.sum(pairs.evaluate(c, w, wo)))(wi), looped)
