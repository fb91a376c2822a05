"""The Laplacian of maps and Tikhonov's regularisation, against eigenvalues and plain linear algebra."""

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.recipes._linear_inverse import Tikhonov, gradient_energy
from hshjax.bases import SphericalHarmonics
from hshjax.lighting import EnvironmentMap


@pytest.mark.parametrize(("degree", "tolerance"), [(1, 0.01), (3, 0.03)])
def test_spherical_harmonics_are_its_eigenvectors(degree, tolerance):
    """K y = n(n+1) Ω y up to the square of the pixels' size, 64 x 32 of them."""
    empty = EnvironmentMap(jnp.zeros((32, 64, 1)), up="z")
    y = np.asarray(SphericalHarmonics(degree)(jnp.asarray(empty.direction)))[..., degree**2 :].reshape(32 * 64, -1)
    omega = np.repeat(empty.solid_angle, 64)[:, None]
    energy = y.T @ gradient_energy(32, 64) @ y
    mass = y.T @ (omega * y)
    np.testing.assert_allclose(energy, degree * (degree + 1) * mass, atol=tolerance * degree * (degree + 1))


def test_a_constant_has_no_energy():
    assert np.abs(gradient_energy(6, 8).sum(axis=1)).max() < 1e-12


def problem():
    rng = np.random.default_rng(0)
    matrix, root = rng.normal(size=(20, 8)), np.triu(rng.normal(size=(8, 8))) + 3 * np.eye(8)
    truth = rng.normal(size=8)
    return matrix, root, matrix @ truth + 0.1 * rng.normal(size=20)


def test_tikhonov_solves_the_normal_equations():
    matrix, root, data = problem()
    found = Tikhonov.of(matrix, root).solution(data, 0.3)
    expected = np.linalg.solve(matrix.T @ matrix + 0.3 * root.T @ root, matrix.T @ data)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_weights_found_from_the_data():
    """The residual at Morozov's weight is that of the noise; Golub's score is least at its own weight."""
    matrix, root, data = problem()
    solver = Tikhonov.of(matrix, root)
    weight = solver.discrepancy(data, 0.2)
    residual = np.mean((matrix @ solver.solution(data, weight) - data) ** 2)
    assert residual <= 0.2**2
    assert np.mean((matrix @ solver.solution(data, 2 * weight) - data) ** 2) > 0.2**2

    def score(weight):
        hat = matrix @ np.linalg.solve(matrix.T @ matrix + weight * root.T @ root, matrix.T)
        left = np.eye(20) - hat
        return np.sum((left @ data) ** 2) / np.trace(left) ** 2

    best = solver.cross_validated(data)
    assert score(best) <= min(score(weight) for weight in solver.weights()) * (1 + 1e-9)
