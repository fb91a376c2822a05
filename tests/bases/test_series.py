"""Sums as products of matrices, their derivatives, and design rows: against each other, block by block."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, SphericalHarmonics, Zernike, _merged, _rows, _series
from hshjax.bases._bands import WIDTH, bands
from tests.bases.cases import EVERY_BASIS
from tests.helpers import DTYPE, X64, assert_close, directions

POINTS = 33
ORDERS = [0, WIDTH, 9]


def coefficients(count, channels=2):
    return jnp.asarray(np.random.default_rng(0).normal(size=(count, channels)), DTYPE)


def close(found, expected):
    scale = 1 + float(jnp.abs(expected).max(initial=0))
    assert_close(found / scale, expected / scale)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", EVERY_BASIS)
def test_sums_are_rows_times_coefficients(name, order):
    basis, w = EVERY_BASIS[name](order), directions(0, POINTS)
    c = coefficients(basis.count)
    expected = _rows.rows(basis, w) @ c
    close(_series.sums(basis, c, w), expected)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", EVERY_BASIS)
def test_gradients_are_derivatives_of_rows(name, order):
    basis, w = EVERY_BASIS[name](order), directions(0, POINTS, min_z=0.01)
    c = coefficients(basis.count)
    along = [
        jax.jvp(lambda w: _rows.rows(basis, w) @ c, (w,), (jnp.zeros_like(w).at[:, k].set(1),))[1] for k in range(3)
    ]
    close(_series.gradients(basis, c, w), jnp.stack(along, -1))
    close(_series.differentiable_gradients(basis, c, w), jnp.stack(along, -1))


@pytest.mark.parametrize("channels", [0, 1, 7])
def test_any_number_of_channels(channels):
    basis, w = HSH(WIDTH), directions(0, POINTS)
    c = coefficients(basis.count, channels)
    close(_series.sums(basis, c, w), _rows.rows(basis, w) @ c)
    for gradients in (_series.gradients, _series.differentiable_gradients):
        assert gradients(basis, c, w).shape == (POINTS, channels, 3)
        assert gradients(basis, c, w[:0]).shape == (0, channels, 3)


def test_blocks_that_do_not_divide_the_points(monkeypatch):
    basis, w = Zernike(6), directions(0, POINTS)
    c = coefficients(basis.count)
    whole = _series.sums(basis, c, w), _series.gradients(basis, c, w), _rows.rows(basis, w)
    monkeypatch.setattr(_series, "POINTS", 8)
    monkeypatch.setattr(_rows, "POINTS", 8)
    close(_series.sums(basis, c, w), whole[0])
    close(_series.gradients(basis, c, w), whole[1])
    close(_rows.rows(basis, w), whole[2])


@pytest.mark.parametrize("few", [1, POINTS + 1], ids=["one by one", "side by side"])
@pytest.mark.parametrize("verb", [_series.sums, _series.gradients], ids=["sums", "gradients"])
def test_batches_of_either_and_of_both(monkeypatch, verb, few):
    monkeypatch.setattr(_merged, "FEW", few)
    basis, w = HSH(WIDTH), directions(0, 3 * POINTS, min_z=0.01).reshape(3, POINTS, 3)
    c = jnp.stack([coefficients(basis.count), 2 * coefficients(basis.count), coefficients(basis.count)[::-1]])
    each = [[verb(basis, of, at) for at in w] for of in c]
    close(jax.vmap(lambda at: verb(basis, c[0], at))(w), jnp.stack(each[0]))
    close(jax.vmap(lambda of: verb(basis, of, w[0]))(c), jnp.stack([row[0] for row in each]))
    close(jax.vmap(lambda of, at: verb(basis, of, at))(c, w), jnp.stack([each[k][k] for k in range(3)]))
    of_all = jax.vmap(lambda of: jax.vmap(lambda at: verb(basis, of, at))(w))(c)
    close(of_all, jnp.stack([jnp.stack(row) for row in each]))


def test_a_batch_of_points_is_taken_in_blocks():
    """As one call of all points: the whole batch of radial functions would be the largest array of the program."""
    basis, points = HSH(9), 50_000
    arguments = jnp.zeros((basis.count, 3), DTYPE), jnp.zeros((points, 3), DTYPE)
    compiled = jax.jit(jax.vmap(basis.evaluate, (None, 0))).lower(*arguments).compile()
    assert compiled.memory_analysis().temp_size_in_bytes < points * basis.count * arguments[0].dtype.itemsize / 20


@pytest.mark.parametrize("basis", [HSH(13), SphericalHarmonics(13), Zernike(13)], ids=str)
def test_radial_functions_of_a_band_are_those_of_its_orders(basis):
    """By polynomials of numpy, through the recurrence of every order."""
    tables, x = basis.tables(), np.linspace(-1, 1, 40)

    def radial(m):
        p = [np.full_like(x, tables.start[m])]
        for j in range(1, tables.counts[m]):
            p.append(
                (tables.slope[m, j] * x + tables.shift[m, j]) * p[-1] - (tables.back[m, j] * p[-2] if j > 1 else 0)
            )
        return np.stack(p)

    assert [m for band in bands(basis) for m in range(14)[band.orders]] == list(range(14))
    for band in bands(basis):
        first = radial(band.first)
        for k, values in enumerate(band.values):
            expected = radial(band.first + k)
            found = values[: len(expected)] @ first
            assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
            assert not values[len(expected) :].any()
        slopes = np.stack([np.polynomial.Chebyshev.fit(x, p, len(first)).deriv()(x) for p in first])
        assert np.abs(band.slopes[0] @ first - slopes).max() < 1e-9 * (1 + np.abs(slopes).max())  # the fit's own digits


@pytest.mark.skipif(not X64, reason="the measure is float64")
@pytest.mark.parametrize("order", [16, 32])
@pytest.mark.parametrize("name", EVERY_BASIS)
def test_bands_cost_no_digit_of_float32(name, order):
    """What connects orders is as large as 230 at order 32, but s^m is small where its functions are large."""
    basis, w = EVERY_BASIS[name](order), directions(0, 200)
    c = coefficients(basis.count)
    single_c, single_w = c.astype(jnp.float32), w.astype(jnp.float32)
    exact = _rows.rows(basis, single_w.astype(float)) @ single_c.astype(float)  # of the arguments as they are rounded

    def error(found):
        return float(jnp.abs(found.astype(float) - exact).max() / jnp.abs(exact).max())

    by_bands, direct = _series.sums(basis, single_c, single_w), _rows.rows(basis, single_w) @ single_c
    assert error(by_bands) < 2 * error(direct) + 2e-6
