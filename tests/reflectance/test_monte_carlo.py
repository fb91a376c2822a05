"""The Monte-Carlo estimate against the sum over emitters and the closed form, in units of its own error."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.brdfs import GGX, Lambert
from hshjax.geometry import meridian_frame
from hshjax.lighting import DirectionalLight, EnvironmentMap, HarmonicLight
from hshjax.reflectance import monte_carlo, reflect
from hshjax.reflectance._proposals import CosineProposal, LobeProposal, MapProposal
from tests.helpers import DTYPE, X64, assert_close, directions, slow_unless

KEY = jax.random.key(0)
STEPS = 400


def random(seed, *shape):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), DTYPE)


def unit(x):
    return x / jnp.linalg.norm(x, axis=-1, keepdims=True)


def points(n):
    normals = unit(random(0, n, 3))
    return normals, unit(normals + 0.4 * random(1, n, 3))


def harmonic():
    """Light of order 3 that is positive nearly everywhere."""
    return HarmonicLight(random(3, 16, 2).at[0].set(5))


def lamp():
    """A dim map with one bright pixel, which chance would miss; and the same light on a finer grid, for the sum."""
    radiance = jnp.asarray(np.random.default_rng(0).uniform(size=(24, 48, 2)), DTYPE).at[7, 9].set(1000)
    light = EnvironmentMap(radiance, up="y")
    fine = EnvironmentMap(jnp.zeros((144, 288, 1)), up="y")
    return light, EnvironmentMap(light(jnp.asarray(fine.direction, DTYPE)), up="y")


def assert_agrees(estimate, expected):
    """At least 98 of 100 values within 3 standard errors (normal: 99.7), and the mean score no outlier itself.

    Points share nothing but the light, so that the mean of their scores has an error of about 1 / √n.
    """
    score = np.asarray((estimate.radiance - expected) / jnp.sqrt(estimate.variance))
    score = score[np.asarray(expected) != 0]
    assert np.mean(np.abs(score) < 3) >= 0.98
    assert abs(score.mean()) < 4 / np.sqrt(score.size)
    assert 0.8 < score.std() < 1.25


def test_lambert_under_harmonic_light_in_closed_form():
    normals, view = points(150)
    brdf = Lambert(jnp.asarray([0.5, 0.8], DTYPE))
    estimate = monte_carlo(brdf, harmonic(), normals, view, key=KEY, samples=4 * STEPS)
    assert_agrees(estimate, reflect(brdf, harmonic(), normals, view))


@pytest.mark.parametrize("roughness", [slow_unless(False, 0.6), slow_unless(True, 0.15)])
def test_a_highlight_against_the_sum(roughness):
    normals, view = points(100)
    brdf = GGX(jnp.ones(1, DTYPE), jnp.asarray(roughness, DTYPE))
    estimate = monte_carlo(brdf, harmonic(), normals, view, key=KEY, samples=4 * STEPS)
    assert_agrees(estimate, reflect(brdf, HarmonicLight(harmonic().coefficients, degree=120), normals, view))


def test_a_lamp_is_found():
    normals, view = points(100)
    light, fine = lamp()
    estimate = monte_carlo(Lambert(jnp.ones(1, DTYPE)), light, normals, view, key=KEY, samples=5 * STEPS)
    expected = reflect(Lambert(jnp.ones(1, DTYPE)), fine, normals, view)
    assert_agrees(estimate, expected)
    # Of 400 directions by the cosine, two would meet the lamp: an error of 70 %.
    lit = np.asarray(expected) > np.quantile(np.asarray(expected), 0.5)
    assert np.all(np.sqrt(np.asarray(estimate.variance))[lit] < 0.2 * np.asarray(expected)[lit])


@pytest.mark.parametrize("name", ["cosine", "lobe", "map"])
def test_a_density_is_that_of_what_is_drawn(name):
    """Means of smooth functions over draws are their integrals times the density, by a rule that it does not know."""
    proposal = {
        "cosine": CosineProposal(),
        "lobe": LobeProposal(jnp.asarray(0.4, DTYPE)),
        "map": MapProposal(lamp()[0]),
    }[name]
    n = 20000
    wo = jnp.broadcast_to(unit(jnp.asarray([0.3, -0.2, 1.0], DTYPE)), (n, 3))
    turn = jnp.broadcast_to(meridian_frame(unit(jnp.asarray([[0.2, 0.9, 0.3]], DTYPE))), (n, 3, 3))
    drawn = np.asarray(proposal.draw(KEY, wo, turn), float)
    assert_close(np.linalg.norm(drawn, axis=-1), np.ones(n), tolerance=1e-10 if X64 else 1e-5)
    up = np.maximum(drawn[:, 2], 0)  # what is drawn below the horizon counts nowhere
    z, phi = np.meshgrid((np.arange(400) + 0.5) / 400, 2 * np.pi * (np.arange(800) + 0.5) / 800, indexing="ij")
    rim = np.sqrt(1 - z * z)
    grid = np.stack([rim * np.cos(phi), rim * np.sin(phi), z], -1).reshape(1, -1, 3)
    density = np.asarray(proposal.density(jnp.asarray(grid, DTYPE), wo[:1], turn[:1]), float).reshape(z.shape)
    omega = 2 * np.pi / z.size
    for function in (lambda x, z: z, lambda x, z: z * (1 + x) ** 2):
        values = function(drawn[:, 0], up)
        expected = np.sum(density * function(grid[0, :, 0].reshape(z.shape), z)) * omega
        assert abs(values.mean() - expected) < 4 * values.std() / np.sqrt(n) + 1e-3 * expected


def test_seeds_shapes_and_variance():
    normals, view = points(6)
    arguments = Lambert(jnp.ones(1, DTYPE)), harmonic(), normals.reshape(2, 3, 3), view.reshape(2, 3, 3)
    few, same = (monte_carlo(*arguments, key=KEY, samples=40) for _ in range(2))
    many = monte_carlo(*arguments, key=KEY, samples=4000)
    assert few.radiance.shape == few.variance.shape == (2, 3, 2)
    assert_close(few.radiance, same.radiance)
    ratio = float(jnp.mean(few.variance) / jnp.mean(many.variance))
    assert 50 < ratio < 200  # 100 but for the scatter of the variance itself
    assert monte_carlo(*arguments[:2], jnp.zeros((0, 3), DTYPE), view[0], key=KEY, samples=4).radiance.shape == (0, 2)
    dark = monte_carlo(*arguments[:2], jnp.zeros((1, 3), DTYPE), view[0], key=KEY, samples=4)
    assert_close(dark.radiance, np.zeros((1, 2)))


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="compares derivatives closely")
def test_derivatives_are_those_of_the_mean():
    """By the BRDF and the normals, against the sum over emitters, as far as the scatter of 20 seeds allows."""
    normals, view = points(4)
    light, fixed = harmonic(), HarmonicLight(harmonic().coefficients, degree=60)

    def loss(radiance, roughness, normals):
        return jnp.sum(radiance(GGX(jnp.ones(1), roughness), unit(normals)))

    def estimated(key, roughness, normals):
        def radiance(brdf, n):
            return monte_carlo(brdf, light, n, view, key=key, samples=1000).radiance

        return jax.grad(loss, argnums=(1, 2))(radiance, roughness, normals)

    at = jnp.asarray(0.5), normals
    truth = jax.grad(loss, argnums=(1, 2))(lambda brdf, n: reflect(brdf, fixed, n, view), *at)
    found = jax.lax.map(lambda key: estimated(key, *at), jax.random.split(KEY, 20))
    for one, expected in zip(found, truth, strict=True):
        error = np.std(np.asarray(one), axis=0) / np.sqrt(19)
        assert np.all(np.abs(np.mean(np.asarray(one), axis=0) - np.asarray(expected)) < 5 * error)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lighting": DirectionalLight(jnp.ones(3), 1.0)}, "no directions can be drawn for a DirectionalLight"),
        ({"lobes": (0.2, 0.0)}, "roughness above 0 and up to 1, got 0.0"),
        ({"samples": 1}, "takes 2 samples or more, got 1"),
        ({"view": jnp.ones((5, 3))}, "view must have shape"),
    ],
    ids=["light", "lobes", "samples", "view"],
)
def test_refusals(change, message, unchecked):
    arguments = {"lighting": harmonic(), "normals": directions(0, 4), "view": jnp.ones(3, DTYPE), "samples": 8}
    with pytest.raises(ValueError, match=message):
        monte_carlo(Lambert(jnp.ones(1, DTYPE)), **(arguments | change), key=KEY)
