"""How much values count: medians among some, shadows and highlights told apart."""

import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax.stereo import angular_errors, lambertian
from hshjax.stereo._highlit import below_highlights
from hshjax.stereo._learn import learning_weight
from hshjax.stereo._observe import Observations
from hshjax.stereo._trust import brightness, median, quantile, residual_scale
from tests.stereo.cases import ball, directions


def test_a_median_is_among_those_that_are_asked():
    rng = np.random.default_rng(0)
    values, among = rng.uniform(size=(50, 13)).astype(np.float32), rng.uniform(size=(50, 13)) < 0.6
    found = np.asarray(median(jnp.asarray(values), jnp.asarray(among)))[:, 0]
    expected = [np.sort(row[some])[(some.sum() - 1) // 2] for row, some in zip(values, among, strict=True)]
    np.testing.assert_allclose(found, expected, atol=2**-13)  # bisection: 2^-14 of the largest


def test_the_median_of_none_is_zero():
    values = jnp.ones((2, 4), jnp.float32)
    np.testing.assert_array_equal(median(values, jnp.zeros((2, 4), bool)), 0)
    np.testing.assert_allclose(residual_scale(values, jnp.zeros((2, 4), bool)), 0.01, rtol=1e-6)


def test_a_pixel_in_cast_shadow_under_most_lights_does_not_teach_that_they_are_light():
    """Eight values of ten are dark where the model has 1: they are outliers, whatever their number."""
    values = jnp.asarray([[1.0, 1.0, *[0.0] * 8], [1.0] * 10], jnp.float32)
    weight = np.asarray(learning_weight(values, jnp.ones_like(values), values - 1))
    assert np.all(weight[0, 2:] == 0)
    assert np.all(weight[0, :2] > 0)


def test_quantiles_look_at_what_is_known():
    values = np.array([[np.nan, 1, 2, 3, np.nan], [np.nan] * 5], np.float32)
    np.testing.assert_allclose(quantile(values, 0.5), [[2], [0]])
    np.testing.assert_allclose(brightness(values), [[2.8], [1]], rtol=1e-6)


def shining(share, peak=20.0, seed=0):
    """Lambert's law under 40 lights, a share of them making a highlight."""
    rng = np.random.default_rng(seed)
    towards = directions(40, tilt=1.5)
    normals = directions(30, tilt=0.5, seed=1)
    diffuse = np.maximum(normals @ towards.T, 0)
    nearest = np.argsort(-(normals @ towards.T), axis=1)[:, : round(share * 40)]
    bright = diffuse.copy()
    np.put_along_axis(bright, nearest, peak * rng.uniform(0.5, 1, nearest.shape), axis=1)
    return diffuse.astype(np.float32), bright.astype(np.float32), jnp.asarray(towards)


@pytest.mark.parametrize("share", [0.15, 0.25])
def test_brightness_is_that_of_the_body_and_not_of_the_highlight(share):
    diffuse, bright, towards = shining(share)
    level = brightness(bright)
    assert np.median(level / brightness(diffuse)) > 5
    found = below_highlights(bright, level, towards) / brightness(diffuse)
    assert np.all((found > 0.5) & (found < 3))


def test_nothing_changes_without_highlights():
    diffuse, _, towards = shining(0.1)
    np.testing.assert_array_equal(below_highlights(diffuse, brightness(diffuse), towards), brightness(diffuse))


def test_shadows_are_not_taken_for_the_body():
    """Under nine lights of ten the pixel lies in cast shadow, lit a little by its surroundings."""
    diffuse, _, towards = shining(0.1)
    lit = np.random.default_rng(2).uniform(size=diffuse.shape) < 0.15
    around = 0.03 * np.exp(0.6 * np.random.default_rng(3).normal(size=diffuse.shape))
    shadowed = np.where(lit, diffuse, around)
    level = brightness(shadowed.astype(np.float32))
    found = below_highlights(shadowed.astype(np.float32), level, towards)
    assert np.mean(found == level) > 0.9


def test_black_and_unknown_pixels_keep_their_level():
    values = np.stack([np.zeros(12), np.full(12, np.nan)]).astype(np.float32)
    found = below_highlights(values, brightness(values), jnp.asarray(directions()))
    np.testing.assert_array_equal(found, [[1], [1]])


def test_the_start_of_golden_paint(monkeypatch):
    """End to end: of pixels that shine under many lights, errors are halved."""
    photographs = ball(hshjax.Lambert(0.05) + hshjax.GGX(1.0, 0.3), size=24, lights=40, tilt=1.0)
    found, level = lambertian(photographs).normals, Observations(photographs).brightness
    monkeypatch.setattr("hshjax.stereo._observe.below_highlights", lambda values, level, directions: level)
    plain = lambertian(photographs).normals
    changed = (level < Observations(photographs).brightness)[:, 0]
    assert np.mean(changed) > 0.03
    before, after = (angular_errors(normals, photographs.truth)[changed].mean() for normals in (plain, found))
    assert after < 0.6 * before
    np.testing.assert_array_equal(found[~changed], plain[~changed])
