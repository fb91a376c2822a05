"""Least squares in normals and lights at once, against the dense system, statistics and known turns."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.recipes import joint_recovery
from experiments.recipes._bundle import (
    descend,
    equations,
    free_slopes,
    looked_up,
    normals_of,
    radiance,
    sines,
    slopes_of_heights,
    step,
    uncertainty,
)
from hshjax import GGX, IsotropicBasis, Samples, height_field, isotropic_pair_rule, project
from hshjax.bases import HSH
from tests.helpers import X64, mostly_slow

pytestmark = pytest.mark.skipif(not X64, reason="solves on the host, in float64 only")

SIZE, SPACING = 7, 2 / 6
SIGMA = 0.01
LIGHTS = np.array([[0.3, 0.2, 0.1, 0.0, 0.2], [-0.4, 0.1, 0.3, 0.2, 0.1], [0.1, -0.5, 0.0, 0.1, 0.4]])


@pytest.fixture(scope="module")
def brdf():
    lobe = GGX(jnp.asarray([0.5, 0.4, 0.3]), jnp.asarray(0.5))
    return project(IsotropicBasis(HSH(3)), Samples.from_function(lobe, isotropic_pair_rule(12))).model


def heights(rng):
    return 0.2 * sines(SIZE, 2) @ rng.uniform(0.3, 1, 4)


def shown(brdf, slopes, lights=LIGHTS):
    images = np.stack([radiance(brdf, jnp.asarray(slopes), jnp.asarray(light)) for light in lights])
    return images, np.full((*images.shape[:2], 1), SIGMA)


SHAPES = {"normals": free_slopes(SIZE**2), "heights": slopes_of_heights(SIZE, SPACING), "sines": None}
SHAPES["sines"] = SHAPES["heights"] @ sines(SIZE, 3)


def test_slopes_are_those_of_the_height_field():
    z = np.zeros((SIZE, SIZE))
    z[1:-1, 1:-1] = np.random.default_rng(0).normal(size=(SIZE - 2, SIZE - 2))
    slopes = (SHAPES["heights"] @ z[1:-1, 1:-1].ravel()).reshape(2, -1).T
    expected = height_field(jnp.asarray(z), spacing=SPACING).normal.reshape(-1, 3)
    np.testing.assert_allclose(normals_of(jnp.asarray(slopes)), expected, atol=1e-14)


@pytest.mark.parametrize("name", mostly_slow(SHAPES, ["heights"]))
def test_steps_solve_the_whole_system(brdf, name):
    """Elimination against the dense Jacobian of everything, damped in proportion to its diagonal."""
    rng, matrix, damping = np.random.default_rng(0), SHAPES[name], 0.1
    dense = np.asarray(matrix if name == "sines" else matrix.toarray())
    x = 0.2 * rng.normal(size=dense.shape[1])
    images, sigma = shown(brdf, (dense @ heights_as(name, rng)).reshape(2, -1).T)
    slopes = (dense @ x).reshape(2, -1).T

    def residual(unknowns):
        slopes = (jnp.asarray(dense) @ unknowns[: x.size]).reshape(2, -1).T
        lights = unknowns[x.size :].reshape(LIGHTS.shape)
        return ((jnp.stack([radiance(brdf, slopes, light) for light in lights]) - images) / sigma).ravel()

    at = jnp.concatenate([jnp.asarray(x), jnp.asarray(LIGHTS).ravel()])
    jacobian, r = np.asarray(jax.jacfwd(residual)(at)), np.asarray(residual(at))
    normal = jacobian.T @ jacobian
    added = damping * np.diag(normal)
    added[: x.size] += 1e-9 * np.diag(normal)[: x.size].mean()  # holds what no light reaches
    expected = np.linalg.solve(normal + np.diag(added), -jacobian.T @ r)

    found = equations(brdf, images, sigma, slopes, LIGHTS)
    np.testing.assert_allclose(found.loss, r @ r / 2, rtol=1e-12)
    move, turn = step(found, matrix, damping)
    np.testing.assert_allclose(np.concatenate([move, turn.ravel()]), expected, atol=1e-7 * np.abs(expected).max())


def heights_as(name, rng):
    inner = heights(rng)
    if name == "heights":
        return inner
    return SHAPES["heights"] @ inner if name == "normals" else 0.2 * rng.uniform(0.3, 1, 9)


def test_descent_finds_heights_and_lights(brdf):
    rng, matrix = np.random.default_rng(0), SHAPES["heights"]
    truth = heights(rng)
    images, sigma = shown(brdf, (matrix @ truth).reshape(2, -1).T)
    x, lights, found = descend(brdf, images, sigma, matrix, 0.7 * truth, LIGHTS + 0.02, steps=40)
    assert found.loss < 1e-6
    np.testing.assert_allclose(x, truth, atol=1e-4)
    np.testing.assert_allclose(lights, LIGHTS, atol=1e-4)


def test_uncertainty_is_the_spread_of_solutions(brdf):
    """Standard deviations against those of 60 noisy draws; they are known to 1/√120 of themselves, 9 %."""
    rng, matrix = np.random.default_rng(0), SHAPES["heights"]
    truth = heights(rng)
    slopes = (matrix @ truth).reshape(2, -1).T
    clean, sigma = shown(brdf, slopes)
    predicted, _ = uncertainty(equations(brdf, clean, sigma, slopes, LIGHTS), matrix, slopes, np.arange(SIZE**2), 0)
    true, squares = np.asarray(normals_of(jnp.asarray(slopes))), []
    for _ in range(60):
        images = clean + SIGMA * rng.standard_normal(clean.shape)
        x, *_ = descend(brdf, images, sigma, matrix, truth, LIGHTS, steps=10)
        found = np.asarray(normals_of(jnp.asarray((matrix @ x).reshape(2, -1).T)))
        squares.append(np.sum((found - true) ** 2, axis=1))
    spread, corner = np.sqrt(np.mean(squares, axis=0)), predicted < 1e-9  # the slopes of corners are known
    assert corner.sum() == 4
    assert spread[corner].max() < 1e-9
    assert abs(np.median(spread[~corner] / predicted[~corner]) - 1) < 0.15


def test_pixels_are_looked_up(brdf):
    """The best entry of a grid, from anywhere: within half a step of the grid, where images tell."""
    truth = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 2))
    images, sigma = shown(brdf, truth)
    found = looked_up(brdf, images, sigma, np.full_like(truth, 1.0), LIGHTS, steepest=1.0)
    assert np.abs(found - truth).max() < 0.03  # steps of 0.025
    np.testing.assert_array_equal(looked_up(brdf, images, sigma, truth, LIGHTS, steepest=1.0), truth)


def test_reach_is_a_standard_deviation(brdf):
    """Least |r|² / σ² + |s - s₀|² / reach², by brute force, of one dim image that says little of slopes."""
    start = np.random.default_rng(0).uniform(-0.4, 0.4, (6, 2))
    images, sigma = shown(brdf, start + 0.3, LIGHTS[:1])
    sigma, reach = 3 * sigma, 0.1
    found = looked_up(brdf, images, sigma, start, LIGHTS[:1], steepest=1.0, reach=reach)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 81)] * 2), axis=-1).reshape(-1, 2)
    entries = np.asarray(radiance(brdf, jnp.asarray(grid), jnp.asarray(LIGHTS[0])))
    own, moved = np.asarray(radiance(brdf, jnp.asarray(start), jnp.asarray(LIGHTS[0]))), []
    for pixel, image in enumerate(images[0]):
        cost = np.sum((entries - image) ** 2, axis=1) / sigma[0, pixel] ** 2
        cost += np.sum((grid - start[pixel]) ** 2, axis=1) / reach**2
        stays = np.sum((own[pixel] - image) ** 2) / sigma[0, pixel, 0] ** 2 <= cost.min()
        moved.append(not stays)
        np.testing.assert_allclose(found[pixel], start[pixel] if stays else grid[np.argmin(cost)], atol=1e-12)
    assert any(moved)


@pytest.mark.parametrize("mirror", [1, -1])
@pytest.mark.parametrize("degrees", [0, 40, 130, 270])
def test_a_surface_is_set_upright(degrees, mirror):
    """A turn and a mirror image of slopes and lights are undone by what a surface is: without curl, and bulging."""
    size = 15
    matrix = slopes_of_heights(size, 2 / (size - 1))
    slopes = (matrix @ (sines(size, 3) @ [0.5, 0.1, -0.05, 0.08, 0, 0.02, 0, 0.03, 0.05])).reshape(2, -1).T
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[cos, sin], [-sin, cos]]) * [1, mirror]
    turned = np.column_stack([LIGHTS[:, :2] @ turn, LIGHTS[:, 2:]])
    found, lights = joint_recovery.upright(slopes @ turn, turned, size)
    np.testing.assert_allclose(found, slopes, atol=1e-6)
    np.testing.assert_allclose(lights, LIGHTS, atol=1e-6)
