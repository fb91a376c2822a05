"""Short series, which are written out, against the products of matrices that all others are."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis, Zernike, _base, _pairs, _rows, _series, _written_out
from tests.bases.cases import EVERY_BASIS
from tests.helpers import DTYPE, assert_close, directions

POINTS = 33


def coefficients(count, channels=2):
    return jnp.asarray(np.random.default_rng(0).normal(size=(count, channels)), DTYPE)


def close(found, expected):
    scale = 1 + float(jnp.abs(expected).max())
    assert_close(found / scale, expected / scale)


@pytest.mark.parametrize("order", [0, 3])
@pytest.mark.parametrize("name", EVERY_BASIS)
def test_the_same_as_products_of_matrices(name, order):
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


@pytest.mark.parametrize("bilateral", [True, False])
@pytest.mark.parametrize("single", [HSH(3), Zernike(4)], ids=str)
def test_pairs_are_the_same_as_their_rows(single, bilateral):
    pairs, wi, wo = IsotropicBasis(single, bilateral), directions(0, POINTS), directions(1, POINTS)
    c = coefficients(pairs.count)
    close(pairs.written_out_sums(c, wi, wo), _base.matmul(pairs(wi, wo), c))


def test_which_are_short():
    assert _written_out.short(HSH(5).count, 3)
    assert not _written_out.short(HSH(6).count, 3)
    assert not _written_out.short(HSH(8).count, 0)
    for points, written_out in ((_written_out.FEW, True), (_written_out.FEW + 1, False)):
        program = str(jax.make_jaxpr(HSH(6).evaluate)(coefficients(49, 3), jnp.zeros((points, 3), DTYPE)))
        assert ("dot_general" not in program) == written_out
    pairs, w = IsotropicBasis(HSH(8)), jnp.zeros((1, 3), DTYPE)
    shape = jax.eval_shape(pairs.written_out_sums, coefficients(pairs.count, 3), w, w)
    assert shape.shape == (1, 3)
    assert pairs.written_out_sums(coefficients(pairs.count, 4), w, w) is None


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
