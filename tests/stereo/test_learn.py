"""What pixels share: the Schur complement is the whole Gauss-Newton system, and steps go down."""

import jax
import jax.numpy as jnp
import numpy as np

import hshjax
from hshjax.stereo._columns import column_brdfs, first_guess
from hshjax.stereo._learn import Pixels, coefficients_of, learn, shared_equations
from hshjax.stereo._refine import Estimate, predicted, refine
from hshjax.stereo._shading import AbstractShadingTable, shading_table
from hshjax.stereo._system import System
from tests.stereo.cases import directions

ANY = np.zeros(12, bool)
"""Coefficients of either sign, of the columns of `photographed`."""

COLUMNS = (hshjax.IsotropicBasis(hshjax.HSH(1)), hshjax.GGX(1.0, 0.3))


def test_the_schur_complement_eliminates_what_belongs_to_pixels():
    """Against the solution of the whole system, in float64 by numpy."""
    rng = np.random.default_rng(0)
    table = shading_table(column_brdfs(COLUMNS), jnp.asarray(directions(8)), 33)
    columns = table.values.shape[1]
    coefficients = jnp.asarray(rng.uniform(0.2, 1, (2, columns)), jnp.float32)
    pq = jnp.asarray(rng.uniform(-0.4, 0.4, (3, 2)), jnp.float32)
    weights = jnp.asarray([[0.5, 0.3], [0.8, 0.0], [0.2, 0.6]], jnp.float32)  # one material is absent from a pixel
    trust = jnp.asarray(rng.uniform(0.3, 1, (3, 8)), jnp.float32)
    stray = jnp.asarray(rng.uniform(0.5, 1, (3, 8)), jnp.float32)
    values = jnp.asarray(rng.uniform(0.1, 0.4, (3, 8)), jnp.float32)
    matrix, right = shared_equations(
        table, coefficients, values, trust, Estimate(pq, weights, jnp.zeros(3, jnp.float32)), stray
    )

    def model(coefficients, share, weights, pq):
        mixed = table.mixed(coefficients)
        return jnp.sum(weights[..., None] * mixed.at(pq), axis=1) + share * stray

    point = coefficients, jnp.zeros((), jnp.float32), weights, pq
    blocks = jax.jacobian(model, argnums=(0, 1, 2, 3))(*point)
    shared = np.concatenate([np.reshape(blocks[0], (24, -1)), np.reshape(blocks[1], (24, 1))], axis=1)
    own = np.concatenate([np.reshape(blocks[2], (24, -1)), np.reshape(blocks[3], (24, -1))], axis=1)
    own = own[:, np.r_[np.asarray(weights).ravel() > 0, np.ones(6, bool)]].astype(float)
    root = np.sqrt(np.asarray(trust, float)).reshape(-1, 1)
    shared, own = root * shared, root * own
    residual = root[:, 0] * np.ravel(values - model(*point))
    inner = own.T @ own
    # The ridge of the library, a ten-thousandth of the diagonal, bounds the agreement.
    inner += np.diag(1e-4 * np.diag(inner) + 1e-6)
    reduced = shared.T @ shared - shared.T @ own @ np.linalg.solve(inner, own.T @ shared)
    expected = shared.T @ residual - shared.T @ own @ np.linalg.solve(inner, own.T @ residual)
    scale = np.max(np.abs(reduced))
    np.testing.assert_allclose(matrix, reduced, atol=2e-3 * scale)
    np.testing.assert_allclose(right, expected, atol=2e-3 * np.max(np.abs(shared.T @ residual)))


def test_equations_that_rounding_made_indefinite_are_solved():
    """As those of the next matrix that rounding could not have made: far from a bound, by numpy."""
    rng = np.random.default_rng(2)
    axes = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    values = np.array([100.0, 20, 3, 1, 0.5, -0.06])  # the damping of coefficients is 3e-4 of the mean: 0.006
    right = axes @ np.array([10.0, -4, 1, 0.2, 0.1, 1e-3])
    system = System(jnp.asarray(axes * values @ axes.T), jnp.asarray(right), 5, 1)
    damped, right = system.matrix + np.diag(system._damping), system.right
    assert np.linalg.eigvalsh(damped)[0] < -0.04
    found = system.solve(True)
    eigenvalues, vectors = np.linalg.eigh(damped)
    expected = vectors @ (vectors.T @ right / np.maximum(eigenvalues, 1e-5 * eigenvalues[-1]))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
    # Bounds hold there, too.
    system.least[:] = -0.01
    assert np.all(system.solve(True) >= -0.01 - 1e-8)


def photographed(stray=0.0, count=400, lights=24):
    """Pixels of a glossy surface, normals up to 60 degrees, whose material is a mixture of two."""
    rng = np.random.default_rng(1)
    vectors = jnp.asarray(directions(lights, tilt=0.9))
    truth = hshjax.Lambert(1.0) + hshjax.GGX(0.25, 0.2)
    columns = (hshjax.IsotropicBasis(hshjax.HSH(2)), hshjax.GGX(1.0, 0.1), hshjax.GGX(1.0, 0.2))
    radius, angle = 0.55 * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    pq = jnp.asarray(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1), jnp.float32)
    albedo = jnp.asarray(rng.uniform(0.1, 1, (count, 1)), jnp.float32)
    values = albedo * shading_table((truth,), vectors, 65).at(pq)[:, 0]
    mean = jnp.mean(values, axis=0)
    values = values + stray * mean[None]
    level = jnp.quantile(values, 0.9, axis=1, keepdims=True)
    pixels = Pixels(values / level, jnp.ones_like(values), jnp.mean(values, axis=0)[None] / level)
    table = shading_table(column_brdfs(columns), vectors, 65)
    return table, pixels, pq, vectors


def misfit(table: AbstractShadingTable, pixels: Pixels, pq, coefficients):
    estimate = refine(table.mixed(coefficients), pixels.values, jnp.ones_like(pixels.values), pq, 10)
    return float(jnp.mean(jnp.abs(pixels.values - predicted(table.mixed(coefficients), estimate))))


def test_a_material_is_learned():
    table, pixels, pq, vectors = photographed()
    guess = coefficients_of(table, shading_table(first_guess(1), vectors, 65))
    shared = learn(table, guess, pixels, pq, positive=ANY, rounds=6, stray=False)
    assert misfit(table, pixels, pq, shared.coefficients) < 0.5 * misfit(table, pixels, pq, guess)
    assert float(shared.stray) == 0


def test_stray_light_is_found():
    table, pixels, pq, vectors = photographed(stray=0.05)
    guess = coefficients_of(table, shading_table(first_guess(2), vectors, 65))
    shared = learn(table, guess, pixels, pq, positive=ANY, rounds=8)
    assert abs(float(shared.stray) - 0.05 / 1.05) < 0.02  # a share of the mean that holds it too


def test_no_stray_light_is_found_where_there_is_none():
    table, pixels, pq, vectors = photographed()
    guess = coefficients_of(table, shading_table(first_guess(2), vectors, 65))
    assert float(learn(table, guess, pixels, pq, positive=ANY, rounds=8).stray) < 0.02


def test_every_round_is_told():
    table, pixels, pq, vectors = photographed(count=50, lights=8)
    guess = coefficients_of(table, shading_table(first_guess(1), vectors, 65))
    told = []
    learn(table, guess, pixels, pq, positive=ANY, rounds=2, done=lambda: told.append(1))
    assert len(told) == 2


def test_guesses_that_columns_can_hold_are_held():
    vectors = jnp.asarray(directions(6))
    table = shading_table(column_brdfs(COLUMNS), vectors, 33)
    wanted = shading_table((hshjax.GGX(1.0, 0.3), hshjax.Lambert(0.5)), vectors, 33)
    found = table.mixed(coefficients_of(table, wanted))
    np.testing.assert_allclose(found.values, wanted.values, atol=2e-3 * float(jnp.max(wanted.values)))
