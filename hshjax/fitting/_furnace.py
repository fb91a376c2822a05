"""Energy conservation of a log-linear model, as a constraint on its least squares. On the host, in float64."""

import jax.numpy as jnp
import numpy as np

from hshjax.fitting._least_distance import least_distance
from hshjax.geometry import direction

POLAR = tuple(np.radians(np.arange(0, 81, 5)).tolist())
"""Angles of the eye [radians]."""

NODES = (96, 24)
"""Of half vectors in θ and φ."""

LIMIT = 1.0
STEPS = 40


def furnace_rule(
    angle: float, nodes: tuple[int, int], *, turn: float = 2 * np.pi
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Light from everywhere, for an eye at some polar angle [radians]: wi `(n, 3)`, wo `(3,)`, weights z_i dω_i `(n,)`.

    Nodes are those of half vectors, `nodes` of them in θ and φ, denser towards the normal: they follow highlights. The
    weight is 0 where light would come from below, and wi the normal. `turn`: how far φ goes; π is enough for functions
    that do not change in a mirror, and weights are those of the whole circle either way.
    """
    t, weight = np.polynomial.legendre.leggauss(nodes[0])
    t, weight = (t + 1) / 2, weight / 2
    theta, phi = t**3 * np.pi / 2, turn * (np.arange(nodes[1]) + 0.5) / nodes[1]
    h = np.asarray(direction(jnp.asarray(theta)[:, None], jnp.asarray(phi)[None])).reshape(-1, 3)
    solid_angle = np.repeat(weight * 3 * t**2 * np.pi / 2 * np.sin(theta) * 2 * np.pi / nodes[1], nodes[1])
    wo = np.array([np.sin(angle), 0, np.cos(angle)])
    facing = h @ wo
    wi = 2 * facing[:, None] * h - wo
    lit = (facing > 0) & (wi[:, 2] > 0)
    weight = np.where(lit, solid_angle * 4 * facing * wi[:, 2], 0)  # dω_i = 4 cos θ_d dω_h
    return np.where(lit[:, None], wi, [0, 0, 1]), wo, weight


class Furnace:
    """Directional albedos ∫ ρ z_i dω_i at the angles `POLAR`: sums over half vectors, on nodes that follow highlights.

    `wi`, `wo` `(nodes, 3)` and `weight` `(nodes,)`, angle after angle; those of one begin at `start`.
    """

    def __init__(self):
        parts = []
        for angle in POLAR:
            wi, wo, weight = furnace_rule(angle, NODES, turn=np.pi)
            lit = weight > 0
            parts.append((wi[lit], np.broadcast_to(wo, wi[lit].shape), weight[lit]))
        self.wi, self.wo, self.weight = (np.concatenate(part) for part in zip(*parts, strict=True))
        self.start = np.cumsum([0, *(len(weight) for *_, weight in parts[:-1])])

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Of values at the nodes, weighted, `(angles, ...)`."""
        return np.add.reduceat(self.weight[:, None] * values, self.start, axis=0)

    def logarithm(
        self, exponent: np.ndarray, low: np.ndarray, functions: np.ndarray, mixing: np.ndarray, terms: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """ln of albedos `(angles, channels)` of ρ = exp(max(exponent, low)), and its derivatives in coefficients of
        terms (function, component), `(angles, channels, terms)`. It is convex: a sum of exponentials.
        """
        raised = np.maximum(exponent, low)
        largest = np.maximum.reduceat(raised, self.start, axis=0)
        counts = np.diff([*self.start, len(raised)])
        value = np.exp(raised - np.repeat(largest, counts, axis=0))
        total = self.sums(value)
        free = np.where(exponent > low, self.weight[:, None] * value, 0)
        parts = zip(np.split(free, self.start[1:]), np.split(functions, self.start[1:]), strict=True)
        inner = np.stack([weighted.T @ rows for weighted, rows in parts])
        slope = inner[..., terms[:, 0]] * mixing[terms[:, 1]].T
        return largest + np.log(total), slope / total[..., None]


def conserved(
    furnace: Furnace,
    functions: np.ndarray,
    matrix: np.ndarray,
    terms: np.ndarray,
    coefficients: np.ndarray,
    mixing: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The coefficients nearest to some, in the metric of their normal matrix, with no albedo of `Furnace` above 1; and
    the lower bounds of ln ρ that this takes.

    `functions` `(nodes, functions)` are those at its nodes. Logarithms of albedos are convex, so their tangents are
    inequalities that every answer satisfies. Those where the last step ended are added to the ones before, and the
    nearest point is taken under all, until the albedos hold; at most `STEPS` times. (The last tangents alone go in
    circles where a fit is far from conserving energy.) Upper bounds of ln ρ are left out of them, they only help; a
    lower one above ln(1/2π) is lowered to that, for by itself it reflects half of the light or more.
    """
    low = np.minimum(low, -np.log(2 * np.pi))
    columns = np.zeros((functions.shape[1], mixing.shape[0]))
    root, found = np.linalg.cholesky(matrix).T, coefficients
    rows, bounds = np.zeros((0, coefficients.size)), np.zeros(0)
    for _ in range(STEPS):
        columns[terms[:, 0], terms[:, 1]] = found
        exponent = functions @ (columns @ mixing)
        if furnace.sums(np.exp(np.clip(exponent, low, high))).max() <= LIMIT:
            break
        logarithm, slope = furnace.logarithm(exponent, low, functions, mixing, terms)
        logarithm, slope = logarithm.ravel(), slope.reshape(logarithm.size, -1)
        above = logarithm > 0
        # A hair below the limit: steps come from outside, for tangents are too low.
        bounds = np.r_[bounds, logarithm[above] - slope[above] @ found - np.log(LIMIT - 1e-4)]
        rows = np.concatenate([rows, -slope[above]])
        found = least_distance(root, coefficients, rows, bounds).point
    return found, low
