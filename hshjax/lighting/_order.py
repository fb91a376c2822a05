"""How many orders of a distant light a material can tell apart."""

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, PairFunction
from hshjax.bases import SphericalHarmonics
from hshjax.bases._base import matmul
from hshjax.lighting._environment import EnvironmentMap
from hshjax.quadrature import hemisphere_rule, polar_nodes

HIGHEST = 48
"""Orders that are looked at."""

VIEWS = 8
"""Gauss nodes in the cosine of the view."""


def visible_order(brdf: PairFunction, environment: EnvironmentMap, tolerance: float) -> int:
    """The smallest order at which a series instead of the map changes radiance by less than `tolerance`.

    Relative, and in the root mean square over all ways to turn the surface, all views (weighted by solid angle and
    cosine) and channels. Turns mix the harmonics of a degree evenly among themselves, so that

        mean R² = Σ_n |c_n|² |g_n|² / (2n + 1),   g_n: the harmonics of degree n of ρ z on the hemisphere

    with no mixed terms: what an order leaves out is the rest of the sum. Power that the map has above the orders that
    are looked at counts like the last of these, so that the order is rather too high than too low.

    Source: the convolution theorem on rotations, as in Ramamoorthi & Hanrahan, A Signal-Processing Framework for
    Reflection, ACM TOG 23(4), 2004.

    **Raises:** ValueError for a map of too few pixels for the order that it takes.
    """
    height, width, _ = environment.radiance.shape
    highest = min(HIGHEST, (min(height, width) - 1) // 2)
    degrees = np.arange(highest + 1)
    power, beyond = _power(environment, highest)
    seen = _response(brdf, highest) / (2 * degrees + 1)
    terms = power * seen
    left_out = np.append(np.cumsum(terms[:0:-1])[::-1], 0) + beyond * seen[-1]
    enough = left_out <= tolerance**2 * (terms.sum() + beyond * seen[-1])
    if not enough.any():
        error = float(np.sqrt(left_out[-1] / (terms.sum() + beyond * seen[-1])))
        raise ValueError(
            f"order {highest}, the highest that is tried for a map of {height} x {width} pixels, leaves an error of up "
            f"to {error:.2g}: ask for a larger tolerance than {tolerance:g}, or name an order"
        )
    return int(np.argmax(enough))


def _power(environment: EnvironmentMap, highest: int) -> tuple[np.ndarray, float]:
    """|c_n|² of each degree, summed over channels, and what the map has beyond."""
    basis, radiance = SphericalHarmonics(highest), environment.radiance
    direction = jnp.asarray(environment.direction, radiance.dtype)
    weight = jnp.asarray(environment.solid_angle, radiance.dtype)

    def add(total, row):
        w, value, omega = row
        return total + omega * matmul(basis(w).T, value), None

    zero = jnp.zeros((basis.count, radiance.shape[2]), radiance.dtype)
    coefficients, _ = jax.lax.scan(add, zero, (direction, radiance, weight))
    by_degree = np.add.reduceat(np.sum(np.asarray(coefficients, float) ** 2, axis=1), np.arange(highest + 1) ** 2)
    whole = np.sum(np.asarray(radiance, float) ** 2 * np.asarray(weight, float)[:, None, None])
    return by_degree, max(0.0, float(whole - by_degree.sum()))


def _response(brdf: PairFunction, highest: int) -> np.ndarray:
    """|g_n|² of each degree, the mean over views and channels."""
    rule = hemisphere_rule(2 * highest + 32)
    z, weight = polar_nodes(2 * VIEWS - 1)
    wo = jnp.asarray(np.stack([np.sqrt(1 - z**2), 0 * z, z], -1), rule.w.dtype)
    rows = SphericalHarmonics(highest)(rule.w) * (rule.weight * rule.w[:, 2])[:, None]

    def of_view(wo: Float[Array, " 3"]) -> Array:
        value = brdf(rule.w, jnp.broadcast_to(wo, rule.w.shape))
        return jnp.mean(matmul(rows.T, value) ** 2, axis=1)

    squares = np.asarray(jax.lax.map(of_view, wo), float)
    mean = (weight * z) @ squares / (weight * z).sum()
    return np.add.reduceat(mean, np.arange(highest + 1) ** 2)
