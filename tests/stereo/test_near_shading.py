"""Shading under lights of each pixel's own, against the reflectance equation and the tables of lights far away."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax.stereo._chart import from_chart
from hshjax.stereo._learn import squares
from hshjax.stereo._near_shading import ANGLES, angle_shares, near_tables
from hshjax.stereo._result import angular_errors
from hshjax.stereo._shading import shading_table
from tests.helpers import DTYPE

BRDFS = (hshjax.Lambert(0.5) + hshjax.GGX(0.3, 0.4), hshjax.Lambert(1.0))


def some(pixels=150, lights=4):
    """Points of the chart, and lights of each down to 70 degrees from the view."""
    rng = np.random.default_rng(1)
    radius, angle = 0.8 * np.sqrt(rng.uniform(size=pixels)), rng.uniform(0, 2 * np.pi, pixels)
    pq = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    theta, phi = rng.uniform(0, np.radians(70), (pixels, lights)), rng.uniform(0, 2 * np.pi, (pixels, lights))
    towards = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    return jnp.asarray(pq, DTYPE), jnp.asarray(towards, DTYPE)


@pytest.fixture(scope="module")
def tables():
    return near_tables(BRDFS, angle_shares(some()[1]))


def test_a_table_is_the_reflectance_equation(tables):
    pq, towards = some()
    found = tables.of(towards).at(pq)
    assert found.shape == (150, 2, 4)
    assert found.dtype == DTYPE
    normals, view, one = from_chart(pq), jnp.asarray([0, 0, 1.0], DTYPE), jnp.ones((), DTYPE)
    for k in range(4):
        for column, brdf in enumerate(BRDFS):
            exact = jax.vmap(
                lambda light, normal, brdf=brdf: hshjax.reflect(brdf, hshjax.DirectionalLight(light, one), normal, view)
            )(towards[:, k], normals)[:, 0]
            lit = np.sum(normals * towards[:, k], axis=1) > 0.15  # a kink at the terminator
            assert np.max(np.abs(found[:, column, k] - exact)[lit]) < 3e-3


def test_slopes_are_those_of_the_table(tables):
    pq, towards = some(20)
    table = tables.of(towards)
    value, slope = table.with_slope(pq)
    np.testing.assert_allclose(value, table.at(pq), rtol=1e-6, atol=1e-7)
    for axis in range(2):
        direction = jnp.zeros_like(pq).at[:, axis].set(1)
        _, expected = jax.jvp(table.at, (pq,), (direction,))
        np.testing.assert_allclose(slope[:, axis], expected, atol=1e-4)


def test_mixtures_are_tables_of_mixtures(tables):
    pq, towards = some(30)
    coefficients = jnp.asarray([[0.5, 2.0], [-1.0, 0.3], [0.0, 1.0]], DTYPE)
    expected = jnp.einsum("kc,ncl->nkl", coefficients, tables.of(towards).at(pq))
    for found in (tables.mixed(coefficients).of(towards), tables.of(towards).mixed(coefficients)):
        np.testing.assert_allclose(found.at(pq), expected, rtol=1e-4, atol=1e-5)


def test_lights_that_all_share_are_lights_far_away():
    """Values, and what the prior of materials is made of."""
    pq, towards = some(150, 5)
    far = shading_table(BRDFS, towards[0])
    same = jnp.broadcast_to(towards[:1], towards.shape)
    tables = near_tables(BRDFS, angle_shares(same))
    np.testing.assert_allclose(tables.of(same).at(pq), far.at(pq), atol=6e-3)
    np.testing.assert_allclose(squares(tables), squares(far), rtol=5e-3)


def test_shares_are_of_one(tables):
    share = np.asarray(tables.share)
    assert share.shape == (ANGLES,)
    np.testing.assert_allclose(share.sum(), 1, rtol=1e-5)
    assert np.all(share[30:] == 0)  # no light is beyond 70 degrees


def test_lights_along_the_view_and_none_at_all(tables):
    """Azimuths that are not defined; the zero vector fills up tiles."""
    pq, _ = some(3)
    towards = jnp.asarray([[[0, 0, 1.0]], [[0, 0, -1.0]], [[0, 0, 0]]], DTYPE)
    found, slope = tables.of(towards).with_slope(pq)
    assert np.all(np.isfinite(found))
    assert np.all(np.isfinite(slope))
    np.testing.assert_allclose(found[1], 0, atol=1e-6)


def test_a_second_start_is_that_of_lights_far_away():
    """Node by node, or all nodes together: the same one is the best, but for those that are as good."""
    pq, towards = some(40, 5)
    far, same = shading_table(BRDFS, towards[0]), jnp.broadcast_to(towards[:1], towards.shape)
    near = near_tables(BRDFS, angle_shares(same)).of(same)
    values = jnp.sum(jnp.asarray([0.2, 0.7], DTYPE)[None, :, None] * far.at(pq), axis=1)
    one, two = (table.best_node(values, jnp.ones_like(values)) for table in (far, near))
    assert np.mean(np.all(np.isclose(one, two, atol=1e-6), axis=1)) > 0.9
    assert np.median(angular_errors(from_chart(two), from_chart(pq))) < 6  # half of what nodes are apart
