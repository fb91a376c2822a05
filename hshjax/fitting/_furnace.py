"""Energy conservation of a log-linear model, as a constraint on its least squares. On the host, in float64."""

import jax.numpy as jnp
import numpy as np

from hshjax.bases import HalfVectorBasis
from hshjax.geometry import direction

POLAR = (0.0, 20.0, 40.0, 55.0, 65.0, 72.0, 76.0, 80.0)
"""Angles of the eye [degrees]: denser where reflection rises."""

NODES = (96, 24)
"""Of half vectors in θ and φ."""

LIMIT = 1.0
STEPS = 20


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

    def slope(
        self, columns: np.ndarray, low: np.ndarray, high: np.ndarray, mixing: np.ndarray, terms: np.ndarray
    ) -> np.ndarray:
        """Derivatives of the albedos in coefficients of terms (function, component), `(angles, channels, terms)`."""
        logarithm = self.functions @ columns
        free = (logarithm > low) & (logarithm < high)
        value = np.where(free, self.weight[..., None] * np.exp(np.clip(logarithm, low, high)), 0)
        inner = np.einsum("anc,anf->acf", value, self.functions, optimize=True)
        return inner[..., terms[:, 0]] * mixing[terms[:, 1]].T


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

    Albedos are linearised where the last step ended, and the quadratic problem solved in its dual, until they hold; at
    most `STEPS` times. Where bounds cut the logarithm off a coefficient has no say, so look at the albedo that is left.
    """
    from scipy.optimize import nnls

    columns = np.zeros((furnace.functions.shape[-1], mixing.shape[0]))
    start, found = coefficients, coefficients
    for _ in range(STEPS):
        columns[terms[:, 0], terms[:, 1]] = found
        albedo = furnace.albedo(columns @ mixing, low, high)
        if albedo.max() <= LIMIT:
            break
        slope = furnace.slope(columns @ mixing, low, high, mixing, terms).reshape(albedo.size, -1)
        # A hair below the limit: iterates come from outside, for albedos are convex in the coefficients.
        room = LIMIT - 1e-4 - albedo.ravel() + slope @ (found - start)
        towards = np.linalg.solve(matrix, slope.T)
        dual = slope @ towards
        root = np.linalg.cholesky(dual + 1e-10 * np.trace(dual) * np.eye(len(dual)))
        found = start - towards @ nnls(root.T, -np.linalg.solve(root, room))[0]
    return found
