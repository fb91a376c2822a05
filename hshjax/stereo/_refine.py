"""The normal of every pixel: Levenberg-Marquardt in two parameters, the weights of materials projected out."""

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.bases._base import matmul
from hshjax.stereo._chart import within
from hshjax.stereo._shading import AbstractShading
from hshjax.stereo._trust import robust_trust
from hshjax.stereo._weights import non_negative_weights, solve

LONGEST_STEP = 0.15
"""In the chart: 17 degrees at its centre. A table knows little of what is farther away."""


class Estimate(eqx.Module):
    """What is believed of some pixels.

    - `pq` `(n, 2)`: the normals, in the chart. - `weights` `(n, materials)`. - `cost` `(n,)`: weighted squares.
    """

    pq: Float[Array, "n 2"]
    weights: Float[Array, "n materials"]
    cost: Float[Array, " n"]


def weigh(
    shading: Float[Array, "n materials lights"], values: Float[Array, "n lights"], trust: Float[Array, "n lights"]
) -> tuple[Float[Array, "n materials"], Float[Array, " n"]]:
    """Non-negative weights of materials for given shading, and the weighted squares that they leave."""
    weighted = trust[:, None] * shading
    gram, moment = matmul(weighted, jnp.swapaxes(shading, 1, 2)), matmul(weighted, values[..., None])[..., 0]
    weights, explained = non_negative_weights(gram, moment)
    return weights, jnp.sum(trust * values * values, axis=1) - explained


@eqx.filter_jit
def predicted(table: AbstractShading, estimate: Estimate) -> Float[Array, "n lights"]:
    """Σ_k w_k shading_k."""
    return jnp.sum(estimate.weights[..., None] * table.at(estimate.pq), axis=1)


@eqx.filter_jit
def refine(
    table: AbstractShading, values: Float[Array, "n lights"], trust: Float[Array, "n lights"], pq: Float[Array, "n 2"],
    steps: int = 8,
) -> Estimate:  # fmt: skip
    """The nearest local minimum of Σ_j trust (values - Σ_k w_k shading_k(normal))² over normals and w >= 0.

    Kaufman's approximation of variable projection: what the weights that are not 0 can undo is taken out of a step.
    """

    def step(_, state):
        damping, now = state
        shading, slope = table.with_slope(now.pq)
        residual = values - jnp.sum(now.weights[..., None] * shading, axis=1)
        hessian, gradient = normal_equations(shading, slope, now.weights, residual, trust)
        scale = (hessian[:, 0, 0] + hessian[:, 1, 1]) / 2 + jnp.finfo(values.dtype).tiny
        damped = hessian + (damping * scale)[:, None, None] * jnp.eye(2, dtype=values.dtype)[None]
        move = jnp.stack(solve([[damped[:, i, j] for j in range(2)] for i in range(2)], list(gradient.T)), axis=1)
        length = jnp.sqrt(jnp.sum(move * move, axis=1, keepdims=True))
        move = move * jnp.where(length > LONGEST_STEP, LONGEST_STEP / length, 1)
        pq = within(now.pq + move)
        weights, cost = weigh(table.at(pq), values, trust)
        better = cost < now.cost  # false where a step is not a number
        moved = Estimate(pq, weights, cost)
        now = jax.tree.map(lambda new, old: jnp.where(_over(better, new), new, old), moved, now)
        return jnp.clip(jnp.where(better, damping * 0.3, damping * 4), 1e-4, 1e4), now

    weights, cost = weigh(table.at(pq), values, trust)
    damping = jnp.full_like(cost, 0.05)
    return jax.lax.fori_loop(0, steps, step, (damping, Estimate(pq, weights, cost)))[1]


@eqx.filter_jit
def robust_refine(
    table: AbstractShading, values: Float[Array, "n lights"], plain: Float[Array, "n lights"], pq: Float[Array, "n 2"],
    rounds: int, steps: int,
) -> tuple[Estimate, Float[Array, "n lights"]]:  # fmt: skip
    """`refine` in rounds, and the trust in values after the last of them; the first trusts all that `plain` does."""

    def round_(state, _):
        pq, trust, _ = state
        estimate = refine(table, values, trust, pq, steps)
        return (estimate.pq, robust_trust(values - predicted(table, estimate), plain), estimate), None

    first = refine(table, values, plain, pq, steps)
    state = first.pq, robust_trust(values - predicted(table, first), plain), first
    (_, trust, estimate), _ = jax.lax.scan(round_, state, length=rounds - 1)
    return estimate, trust


def normal_equations(
    shading: Float[Array, "n materials lights"],
    slope: Float[Array, "n 2 materials lights"],
    weights: Float[Array, "n materials"],
    residual: Float[Array, "n lights"],
    trust: Float[Array, "n lights"],
) -> tuple[Float[Array, "n 2 2"], Float[Array, "n 2"]]:
    """Of a step of the normals, weights that are not 0 projected out."""
    jacobian = jnp.sum(weights[:, None, :, None] * slope, axis=2)
    weighted = trust[:, None] * jacobian
    hessian = matmul(weighted, jnp.swapaxes(jacobian, 1, 2))
    gradient = matmul(weighted, residual[..., None])[..., 0]
    coupling = jnp.where((weights > 0)[:, None], matmul(weighted, jnp.swapaxes(shading, 1, 2)), 0)
    undone = [_undone(shading, weights, trust, coupling[:, i]) for i in range(2)]
    taken = [jnp.stack([jnp.sum(coupling[:, i] * undone[j], axis=1) for j in range(2)], axis=1) for i in range(2)]
    return hessian - jnp.stack(taken, axis=1), gradient


def _undone(shading, weights, trust, coupling) -> Float[Array, "n materials"]:
    """What the free weights would do against a change of the shading; 0 for weights at 0."""
    free = weights > 0
    gram = matmul(trust[:, None] * shading, jnp.swapaxes(shading, 1, 2))
    both = free[:, :, None] & free[:, None, :]
    k = weights.shape[1]
    # A ridge far below the data's noise, for materials that look alike at a pixel.
    ridge = 1e-6 * jnp.trace(gram, axis1=1, axis2=2)[:, None, None] + jnp.finfo(gram.dtype).tiny
    unit = jnp.eye(k, dtype=gram.dtype)[None]
    gram = jnp.where(both, gram, unit) + ridge * unit
    found = solve([[gram[:, i, j] for j in range(k)] for i in range(k)], list(coupling.T))
    return jnp.where(free, jnp.stack(found, axis=1), 0)


def _over(chosen: Array, like: Array) -> Array:
    return chosen.reshape(-1, *(1,) * (like.ndim - 1))
