"""Where a renderer should look for light: a lobe about the mirror direction and a cosine, fitted to a BRDF."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from hshjax.brdfs import AbstractBRDF

NODES = np.linspace(1 / 16, 1, 16)
"""cos θ_i at which shares are fitted."""

POINTS = 768
"""Directions wo for each node and each density that they are drawn from."""

BROAD = (0.003, 0.02, 0.1, 0.4)
"""Roughness of the lobes that those are drawn from, beside the cosine: between them every lobe is met."""

ALPHAS = np.geomspace(0.003, 1, 26)
SHARES = np.linspace(0, 0.9, 31)
"""Candidates. A tenth of the samples at least follow the cosine: no direction is forgotten."""


class Proposal(NamedTuple):
    """The density share(cos θ_i) lobe(wo) + (1 - share) cos θ_o / π [sr^-1] of wo, given wi.

    `lobe` is that of GGX's visible normals of roughness `alpha`, reflected, and folded up at the horizon: directions
    below have their z turned round, so that it integrates to 1 over the hemisphere. `share` `(nodes,)` holds at the
    cosines `node`, linear between them and constant beyond.

    - `smallest` [sr^-1]: the least value of the BRDF at the directions it was fitted on, of all channels.
    - `negative`: of what is reflected from there, without its sign, the share that negative values reflect.
    """

    alpha: float
    node: np.ndarray
    share: np.ndarray
    smallest: float
    negative: float


def fitted_proposal(brdf: AbstractBRDF) -> Proposal:
    """The roughness and the shares of least variance of f cos θ_o / density, f the mean over channels where positive.

    Variances are relative to the albedo squared, weighted by cos θ_i over the nodes, in the plane φ_i = 0. They are
    estimated from fixed directions by the balance heuristic over the densities that those were drawn from (Veach and
    Guibas, SIGGRAPH 1995); a quadratic form of f over a density linear in the share, they are convex in it.
    """
    wi = np.stack([np.sqrt(1 - NODES**2), np.zeros_like(NODES), NODES], -1)[:, None]
    wo = np.concatenate([_reflected_normals(wi, alpha) for alpha in BROAD] + [_cosine(len(NODES))], axis=1)
    cosine = wo[..., 2] / np.pi
    drawn_from = np.mean([_lobe(wi, wo, alpha) for alpha in BROAD] + [cosine], axis=0)
    values = np.asarray(brdf(_device(wi), _device(wo)), np.float64)
    reflected = values * (wo[..., 2] / drawn_from)[..., None]
    energy = np.abs(reflected).sum()
    negative = float(np.maximum(-reflected, 0).sum() / energy) if energy > 0 else 0.0
    f = np.maximum(values, 0).mean(-1) * wo[..., 2]
    albedo = np.mean(f / drawn_from, axis=1)
    lit = albedo > 0
    if not lit.any():
        return Proposal(1.0, NODES, np.zeros_like(NODES), float(values.min()), negative)

    best, found = np.inf, (1.0, np.zeros_like(NODES))
    for alpha in ALPHAS:
        lobe = _lobe(wi, wo, alpha)
        # (shares, nodes)
        square = np.stack([np.mean(f**2 / (drawn_from * (s * lobe + (1 - s) * cosine)), axis=1) for s in SHARES])
        chosen = np.argmin(square, axis=0)
        relative = square[chosen, np.arange(len(NODES))][lit] / albedo[lit] ** 2
        variance = np.average(relative, weights=NODES[lit])
        if variance < best:
            best, found = variance, (float(alpha), np.where(lit, SHARES[chosen], 0))
    return Proposal(*found[:1], NODES, found[1], float(values.min()), negative)


def _device(w: np.ndarray) -> Any:
    return jnp.asarray(w, float)


def _lobe(wi: np.ndarray, wo: np.ndarray, alpha: float) -> np.ndarray:
    """Density of the folded lobe [sr^-1]."""
    below = wo * (1, 1, -1)
    return _unfolded(wi, wo, alpha) + _unfolded(wi, below, alpha)


def _unfolded(wi: np.ndarray, wo: np.ndarray, alpha: float) -> np.ndarray:
    """D(h) G1(wi) / (4 cos θ_i), 0 where h lies below the horizon.

    Source: Heitz, Sampling the GGX Distribution of Visible Normals, JCGT 7(4), 2018, Eq. 3 and 17.
    """
    h = wi + wo
    square = np.sum(h * h, axis=-1)
    h = h / np.sqrt(np.where(square > 0, square, 1))[..., None]
    rim = h[..., 0] ** 2 + h[..., 1] ** 2
    d = 1 / (np.pi * alpha**2 * (rim / alpha**2 + h[..., 2] ** 2) ** 2)
    cos = wi[..., 2]
    g1 = 2 * cos / (cos + np.sqrt(cos**2 + alpha**2 * (1 - cos**2)))
    return np.where((square > 0) & (h[..., 2] > 0), d * g1 / (4 * cos), 0)


def _reflected_normals(wi: np.ndarray, alpha: float) -> np.ndarray:
    """Directions of the folded lobe, `(nodes, POINTS, 3)`, evenly spread. Source: Heitz, appendix A."""
    u, v = _square()
    x, z = alpha * wi[..., 0], wi[..., 2]
    length = np.hypot(x, z)
    x, z = x / length, z / length  # incidence in the plane y = 0, stretched
    radius, phi = np.sqrt(u), 2 * np.pi * v
    t1, t2 = radius * np.cos(phi), radius * np.sin(phi)
    s = (1 + z) / 2
    t2 = (1 - s) * np.sqrt(1 - t1**2) + s * t2
    up = np.sqrt(np.maximum(1 - t1**2 - t2**2, 0))
    # Frame about the stretched incidence: (0, 1, 0) and (-z, 0, x).
    normal = np.stack([alpha * (up * x - t2 * z), alpha * np.broadcast_to(t1, up.shape), up * z + t2 * x], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    wo = 2 * np.sum(wi * normal, axis=-1, keepdims=True) * normal - wi
    wo[..., 2] = np.maximum(np.abs(wo[..., 2]), 1e-6)
    return wo / np.linalg.norm(wo, axis=-1, keepdims=True)


def _cosine(nodes: int) -> np.ndarray:
    u, v = _square()
    radius, phi = np.sqrt(u), 2 * np.pi * v
    w = np.stack([radius * np.cos(phi), radius * np.sin(phi), np.sqrt(1 - u)], -1)
    return np.broadcast_to(w, (nodes, *w.shape))


def _square() -> tuple[np.ndarray, np.ndarray]:
    """Evenly spread points of the unit square: Fibonacci's lattice."""
    k = np.arange(POINTS)
    return (k + 0.5) / POINTS, (k + 0.5) * (np.sqrt(5) - 1) / 2 % 1
