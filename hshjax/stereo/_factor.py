"""Directions of lights from photographs alone: Lambert's law makes values of middle ranks a matrix of rank three.

The factors are known up to a matrix; lights of unit length leave a rotation or reflection of it (Hayakawa, Photometric
Stereo under a Light Source with Arbitrary Motion, J. Opt. Soc. Am. A 11(11), 1994), and the contour none.
"""

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Float
from hshjax.stereo._band import band_trust
from hshjax.stereo._learn import Pixels
from hshjax.stereo._trust import biweight, residual_scale

ROUNDS = 12

PLAIN = 3
"""Rounds before outliers are looked for."""


TOLD = 2e-3
"""Least singular value, relative to the largest, of the equations for lengths; 0.04 to 0.1 for lights within 45 degrees
of the view."""

LEAST = 0.2
"""Eigenvalue, relative to the largest, that takes the place of those that no matrix has. Factors begin with second
moments of normals that are equal, and those of an object that is seen whole are 1 : 1 : 2."""


def factored(pixels: Pixels) -> tuple[Float[np.ndarray, "lights 3"], bool]:
    """Unit directions of lights of equal intensity, up to an orthogonal matrix; and whether there is no such matrix
    that fits best, so that one was taken that is near to it.

    **Raises:** ValueError where no matrix makes lights of one length, as where they lie in a plane or on a cone about
    one axis.
    """
    values, plain = np.asarray(pixels.values, float), np.asarray(band_trust(pixels.values, pixels.known), float)
    _, scale, right = np.linalg.svd(np.where(np.asarray(pixels.known) > 0, values, 0), full_matrices=False)
    lights, trust = right[:3].T * scale[:3] / np.sqrt(len(values)), plain
    for turn in range(ROUNDS):
        albedo_normals = _factor(values, trust, lights)
        lights = _factor(values.T, trust.T, albedo_normals)
        if turn >= PLAIN:
            residual = jnp.asarray(values - albedo_normals @ lights.T)
            trust = plain * np.asarray(biweight(residual, residual_scale(residual, jnp.asarray(plain > 0))))
    matrix, forced = unit_lengths(lights)
    straight = lights @ matrix
    return straight / np.linalg.norm(straight, axis=1, keepdims=True), forced


def _factor(values, trust, other) -> Float[np.ndarray, "n 3"]:
    """Rows x of least Σ trust (values - x·other)²; rows of which little is known stay near 0."""
    gram = (trust @ (other[:, :, None] * other[:, None]).reshape(-1, 9)).reshape(-1, 3, 3)
    ridge = 1e-6 * np.mean(np.trace(gram, axis1=1, axis2=2)) * np.eye(3)
    return np.linalg.solve(gram + ridge, ((trust * values) @ other)[..., None])[..., 0]


def unit_lengths(vectors: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "3 3"], bool]:
    """The symmetric positive matrix A that brings |A v| nearest to 1, by least absolute deviations of its square.

    Intensities that are wrong (metals, whose maxima are highlights) may make a square best that is no square. Then the
    eigenvalues below `LEAST` are raised to it, and the second value is True.

    **Raises:** ValueError for vectors that do not determine it, or point to no matrix at all.
    """
    first, second = np.triu_indices(3)
    columns = vectors[:, first] * vectors[:, second] * np.where(first == second, 1, 2)
    told = np.linalg.svd(columns, compute_uv=False)
    if len(told) < 6 or told[-1] < TOLD * told[0]:
        raise ValueError("the directions of the lights are not determined: they must not lie on a cone or plane")
    weight = np.ones(len(vectors))
    found = np.zeros(6)
    for _ in range(50):
        found = np.linalg.lstsq(weight[:, None] * columns, weight, rcond=None)[0]
        weight = 1 / np.sqrt(np.maximum(np.abs(columns @ found - 1), 1e-3))
    square = np.zeros((3, 3))
    square[first, second] = square[second, first] = found
    values, axes = np.linalg.eigh(square)
    if values[-1] <= 0:
        raise ValueError("no surface of Lambert's law explains the photographs with lights of these intensities")
    forced = bool(values[0] <= 1e-4 * values[-1])
    if forced:
        values = np.maximum(values, LEAST * values[-1])
    return (axes * np.sqrt(values)) @ axes.T, forced
