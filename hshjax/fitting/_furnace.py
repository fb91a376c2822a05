"""Energy conservation of a log-linear model, as a constraint on its least squares. On the host, in float64."""

import jax.numpy as jnp
import numpy as np

from hshjax.bases import HalfVectorBasis
from hshjax.fitting._least_distance import least_distance
from hshjax.geometry import direction

POLAR = (0.0, 20.0, 40.0, 55.0, 65.0, 72.0, 76.0, 80.0)
"""Angles of the eye [degrees]: denser where reflection rises."""

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
    """Directional albedos ∫ ρ z_i dω_i as sums over half vectors, on nodes that follow highlights.

    `functions` `(angles, nodes, functions)` and `weight` `(angles, nodes)`, 0 where light comes from below.
    """

    def __init__(self, basis: HalfVectorBasis):
        functions, weights = [], []
        for angle in np.radians(POLAR).tolist():
            wi, wo, weight = furnace_rule(angle, NODES, turn=np.pi)
            functions.append(np.asarray(basis(jnp.asarray(wi), jnp.broadcast_to(jnp.asarray(wo), wi.shape))))
            weights.append(weight)
        self.functions, self.weight = np.stack(functions), np.stack(weights)

    def albedo(self, columns: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """`(angles, channels)`, of coefficients `(functions, channels)` and bounds of ln ρ."""
        return np.einsum("an,anc->ac", self.weight, np.exp(np.clip(self.functions @ columns, low, high)))

    def logarithm(
        self, columns: np.ndarray, low: np.ndarray, mixing: np.ndarray, terms: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """ln of albedos without the upper bounds, `(angles, channels)`, and its derivatives in coefficients of terms
        (function, component), `(angles, channels, terms)`. It is convex: a sum of exponentials.
        """
        exponent = np.maximum(self.functions @ columns, low)
        largest = exponent.max(axis=1, keepdims=True)
        value = self.weight[..., None] * np.exp(exponent - largest)
        total = value.sum(axis=1)
        inner = np.einsum("anc,anf->acf", np.where(exponent > low, value, 0), self.functions, optimize=True)
        slope = inner[..., terms[:, 0]] * mixing[terms[:, 1]].T / total[..., None]
        return largest[:, 0] + np.log(total), slope


def conserved(
    furnace: Furnace,
    matrix: np.ndarray,
    terms: np.ndarray,
    coefficients: np.ndarray,
    mixing: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray:
    """The coefficients nearest to some, in the metric of their normal matrix, with no albedo of `Furnace` above 1.

    Logarithms of albedos are convex, so their tangents are inequalities that every answer satisfies. Those where the
    last step ended are added to the ones before, and the nearest point is taken under all, until the albedos hold; at
    most `STEPS` times. (The last tangents alone go in circles where a fit is far from conserving energy.)
    """
    columns = np.zeros((furnace.functions.shape[-1], mixing.shape[0]))
    root, found = np.linalg.cholesky(matrix).T, coefficients
    rows, bounds = np.zeros((0, coefficients.size)), np.zeros(0)
    for _ in range(STEPS):
        columns[terms[:, 0], terms[:, 1]] = found
        if furnace.albedo(columns @ mixing, low, high).max() <= LIMIT:
            break
        logarithm, slope = furnace.logarithm(columns @ mixing, low, mixing, terms)
        logarithm, slope = logarithm.ravel(), slope.reshape(logarithm.size, -1)
        above = logarithm > 0
        # A hair below the limit: steps come from outside, for tangents are too low.
        bounds = np.r_[bounds, logarithm[above] - slope[above] @ found - np.log(LIMIT - 1e-4)]
        rows = np.concatenate([rows, -slope[above]])
        found = least_distance(root, coefficients, rows, bounds).point
    return found
