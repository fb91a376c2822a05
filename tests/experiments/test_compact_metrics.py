"""The judge of compact models, against what is known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.recipes._compact_metrics import (
    LAMPS,
    Folded,
    cells,
    images,
    l2_error,
    largest_albedo,
    log_error,
    pictures,
    psnr,
    table,
    together,
)
from hshjax import (
    GGX,
    HalfVectorBasis,
    Lambert,
    LogLinearBRDF,
    LogWarp,
    OrthographicCamera,
    pair_rule,
    sphere,
)
from tests.helpers import X64, directions

pytestmark = pytest.mark.skipif(not X64, reason="studies run in float64")


def test_log_error_of_a_factor():
    wi, wo = np.asarray(directions(0, 50)), np.asarray(directions(1, 50))
    value = np.full((50, 2), 3.0)
    expected = [np.log((1 + 3 * w[:, 2]) / (1 + 2 * w[:, 2])).mean() for w in (wi, wo)]
    assert log_error(value, value - 1, wi, wo) == pytest.approx(1e3 * np.mean(expected))
    assert log_error(value, value, wi, wo) == 0


def test_l2_error_is_an_integral():
    """Of ρ cos cos over pairs below 80 degrees, against a rule over all pairs: cells and rim to 2 %."""

    def brdf(wi, wo):
        return jnp.exp(-4 * (wi[..., :1] - wo[..., :1]) ** 2 - wi[..., 1:2] * wo[..., 1:2]) * wi[..., 2:] * wo[..., 2:]

    def folded(wi, wo):
        mirror = jnp.asarray([1.0, -1, 1])
        return (brdf(wi, wo) + brdf(wi * mirror[None], wo * mirror[None])) / 2

    # Isotropic: the mean over rotations about the normal.
    def isotropic(wi, wo):
        turned = []
        for phi in 2 * np.pi * np.arange(16) / 16:
            turn = jnp.asarray([[np.cos(phi), -np.sin(phi), 0], [np.sin(phi), np.cos(phi), 0], [0, 0, 1]])
            turned.append(folded(wi @ turn.T, wo @ turn.T))
        return sum(turned[1:], start=turned[0]) / 16

    truth, weight = table(isotropic), cells().weight
    rule = pair_rule(24)
    cosines = np.asarray(rule.weight * (rule.wi[:, 2] * rule.wo[:, 2]) ** 2)
    value = np.asarray(isotropic(rule.wi, rule.wo))[:, 0]
    expected = np.sqrt(np.sum(cosines * (value - 0.1) ** 2) / np.sum(cosines * value**2))
    assert l2_error(truth, np.full_like(truth, 0.1), weight) == pytest.approx(expected, rel=0.02)
    assert l2_error(truth, truth, weight) == 0


def test_albedo_of_what_is_known():
    """Lambert: its albedo. A sharp lobe in a white furnace, at normal incidence: all but what shadows take."""
    np.testing.assert_allclose(largest_albedo(Lambert([0.5, 0.2])), [0.5, 0.2], rtol=2e-3)
    np.testing.assert_allclose(largest_albedo(GGX(1.0, 0.01), [0.0]), 1.0, atol=2e-3)


def test_models_together_are_what_they_are_alone():
    basis, rng = HalfVectorBasis(9, LogWarp(jnp.asarray(0.01))), np.random.default_rng(0)
    models = [
        LogLinearBRDF(basis, [jnp.asarray(rng.normal(size=n)) for n in (9, 3, 3)], high=jnp.full(3, 0.5 + k))
        for k in range(2)
    ]
    wi, wo = directions(0, 30), directions(1, 30)
    expected = np.concatenate([model(wi, wo) for model in models], axis=1)
    np.testing.assert_allclose(together(models)(wi, wo), expected, rtol=1e-12)


def test_a_lambertian_sphere_under_lamps():
    """Radiance by hand: ρ times irradiance, without what comes from below 80 degrees; the ball in a row of pixels."""
    picture = pictures([], 16)[0]
    shown = images(Lambert([0.5, 0.3, 0.1]), [picture])[0]
    camera = OrthographicCamera(jnp.asarray([0.0, 0, 1]), jnp.asarray([0.0, 1, 0]), resolution=(16, 16))
    normals = np.asarray(sphere(camera).normal).reshape(-1, 3)
    normals = normals[normals[:, 2] >= np.cos(np.radians(80))]
    expected = np.zeros(len(normals))
    for towards, power in LAMPS:
        cosine = normals @ np.asarray(towards) / np.linalg.norm(towards)
        expected += power * np.where(cosine > np.cos(np.radians(80)), cosine, 0)
    np.testing.assert_allclose(shown, np.outer(expected, [0.5, 0.3, 0.1]) / np.pi, rtol=1e-5, atol=1e-6)


def test_blocks_of_pairs_change_nothing(monkeypatch):
    picture, brdf = pictures([], 16), GGX([0.9, 0.5], 0.3)
    lamps = [picture[0]._replace(irradiance=picture[0].irradiance[:, :1])]
    whole = images(brdf, lamps)
    monkeypatch.setattr("experiments.recipes._compact_metrics.PAIRS", 100)
    np.testing.assert_allclose(images(brdf, lamps)[0], whole[0], rtol=1e-5)


def test_lights_on_the_same_pairs_are_lit_together():
    """Two lights that share their pairs, by identity, and the same two with pairs of their own."""
    lamps = pictures([], 16)[0]
    dim = lamps._replace(irradiance=0.5 * lamps.irradiance)
    apart = dim._replace(wi=dim.wi.copy())
    brdf = GGX(jnp.asarray([0.9, 0.5, 0.1]), 0.3)
    shared, alone = images(brdf, [lamps, dim]), images(brdf, [lamps, apart])
    for one, other in zip(shared, alone, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(shared[1], 0.5 * shared[0], rtol=1e-6)


def test_what_is_folded_is_reciprocal_and_bilateral():
    def crooked(wi, wo):
        return (2 + wi[:, 2:]) * jnp.exp(wi[:, :1] * wo[:, 1:2] - wi[:, 1:2] * wo[:, :1])

    wi, wo, mirror = directions(0, 9), directions(1, 9), jnp.asarray([[1.0, -1, 1]])
    found = Folded(crooked)(wi, wo)
    np.testing.assert_allclose(found, Folded(crooked)(wo, wi), rtol=1e-12)
    np.testing.assert_allclose(found, Folded(crooked)(wi * mirror, wo * mirror), rtol=1e-12)
    assert np.max(np.abs(found / crooked(wi, wo) - 1)) > 0.1


def test_pictures_of_the_same_are_the_same():
    lamps = pictures([], 16)
    assert len(lamps) == 1
    shown = images(Lambert([0.5, 0.3, 0.1]), lamps)
    assert psnr(shown, shown) == 80
    darker = [0.9 * image for image in shown]
    assert 20 < psnr(shown, darker) < 40
