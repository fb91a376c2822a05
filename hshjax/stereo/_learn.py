"""What all pixels share, the BRDF above all: Gauss-Newton steps with everything that belongs to a pixel projected out.

Taking turns (normals, then BRDF) barely moves, for the normals absorb the error of the BRDF. Their response is a part
of these steps: variable projection by a Schur complement, a block a pixel.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.bases._base import matmul
from hshjax.stereo._refine import Estimate, predicted, refine, robust_refine
from hshjax.stereo._shading import ShadingTable
from hshjax.stereo._trust import initial_trust, robust_trust

SHADOWS = 0.3
"""Trust of dark values where shared unknowns are learned."""

BEST = 0.5
"""Share of the pixels that is learned from: those that fit best, for the others are shadowed or lit by others."""

START = 4
"""Rounds of outliers before the first step."""

STIFFNESS = 3.0
"""Of the prior that keeps materials near their first guess, relative to what the pixels say and their noise: as if each
had seen that guess three times. Between the BRDF and the normals of a smooth object little is determined, and without
a prior solutions drift for ever."""


class Shared(NamedTuple):
    """What pixels have in common.

    - `coefficients` `(materials, columns)`: of the BRDF.
    - `stray`: light that reaches every pixel by scattering in the lens and the room, as a share of the mean of the
      photograph.
    - `noise`: weighted mean square of what is not explained, relative to brightness, of the pixels learned from.
    """

    coefficients: Float[Array, "materials columns"]
    stray: Float[Array, ""]
    noise: float


class Pixels(NamedTuple):
    """Some pixels, relative to their brightness.

    - `values` `(n, lights)`; `known` `(n, lights)`: 1, or 0 where the value is unknown (and anything finite).
    - `stray` `(n, lights)`: the mean of the photograph over the pixel's brightness.
    """

    values: Float[Array, "n lights"]
    known: Float[Array, "n lights"]
    stray: Float[Array, "n lights"]

    def without(self, share: Float[Array, ""]) -> Float[Array, "n lights"]:
        """Values less stray light."""
        return self.values - share * self.stray


def learn(
    columns: ShadingTable, guess: Float[Array, "materials columns"], pixels: Pixels, pq: Float[Array, "n 2"],
    *, rounds: int, stray: bool = True, done: Callable[[], None] = lambda: None,
) -> Shared:  # fmt: skip
    """The shared unknowns from some pixels: rounds of a step of theirs and a refinement of every normal.

    - `columns`: the table of what materials are made of. - `guess`: materials to begin with. - `pq`: normals likewise.
    - `done`: called after every round.
    """
    shared = Shared(guess, jnp.zeros((), pixels.values.dtype), 0.0)
    rows = _rows(columns)
    metric = rows @ rows.T / rows.shape[1]
    plain = initial_trust(pixels.values, pixels.known)
    estimate, _ = robust_refine(columns.mixed(guess), pixels.values, plain, pq, START, 8)
    for _ in range(rounds):
        table = columns.mixed(shared.coefficients)
        values = pixels.without(shared.stray)
        residual = values - predicted(table, estimate)
        plain = initial_trust(values, pixels.known)
        misfit = jnp.mean(jnp.minimum(plain * jnp.abs(residual), 0.3), axis=1)
        best = (misfit <= jnp.quantile(misfit, BEST)).astype(values.dtype)[:, None]
        weight = best * robust_trust(residual, initial_trust(values, pixels.known, SHADOWS))
        equations = shared_equations(columns, shared.coefficients, values, weight, estimate, pixels.stray)
        noise = float(jnp.sum(weight * residual**2) / jnp.sum(weight))
        shared = _step(shared, guess, equations, noise * metric, weight, estimate, stray)._replace(noise=noise)
        table, values = columns.mixed(shared.coefficients), pixels.without(shared.stray)
        residual = values - predicted(table, estimate)
        trust = robust_trust(residual, initial_trust(values, pixels.known))
        estimate = refine(table, values, trust, estimate.pq)
        done()
    return shared


def _step(shared, guess, equations, metric, weight, estimate, stray) -> Shared:
    """The step that the normal equations ask for, in float64: tens of unknowns."""
    matrix, right = (np.asarray(part, np.float64) for part in equations)
    materials, columns = shared.coefficients.shape
    size = materials * columns
    amount = np.sum(np.asarray(weight)) * np.mean(np.asarray(estimate.weights, np.float64) ** 2, axis=0)
    prior = np.zeros_like(matrix)
    prior[:size, :size] = STIFFNESS * np.kron(np.diag(amount), metric)
    moved = np.asarray(shared.coefficients - guess, np.float64).ravel()
    right[:size] -= prior[:size, :size] @ moved
    damping = 3e-4 * np.mean(np.diag(matrix)[:size]) * np.r_[np.ones(size), 0]
    damping[size] = 1e-3 * matrix[size, size] + np.finfo(float).tiny
    keep = size + 1 if stray else size
    step = np.zeros(size + 1)
    step[:keep] = np.linalg.solve((matrix + prior + np.diag(damping))[:keep, :keep], right[:keep])
    dtype = shared.coefficients.dtype
    share = max(float(shared.stray) + step[size], 0.0)  # light does not stray away
    coefficients = shared.coefficients + jnp.asarray(step[:size].reshape(materials, columns), dtype)
    return Shared(coefficients, jnp.asarray(share, dtype), shared.noise)


@eqx.filter_jit
def shared_equations(
    columns: ShadingTable,
    coefficients: Float[Array, "materials columns"],
    values: Float[Array, "n lights"],
    trust: Float[Array, "n lights"],
    estimate: Estimate,
    stray: Float[Array, "n lights"],
) -> tuple[Float[Array, "unknowns unknowns"], Float[Array, " unknowns"]]:
    """Normal equations of changes of the coefficients, material by material, and of the share of stray light.

    Weights that are not 0 and normals are projected out, pixel by pixel.
    """
    n, lights = values.shape
    table, slope = columns.with_slope(estimate.pq)
    shading = jnp.einsum("kc,ncl->nkl", coefficients, table)
    turned = jnp.einsum("nk,kc,ndcl->ndl", estimate.weights, coefficients, slope)
    residual = values - jnp.sum(estimate.weights[..., None] * shading, axis=1)
    own = jnp.concatenate([shading, turned], axis=1)
    free = jnp.concatenate([estimate.weights > 0, jnp.ones((n, 2), bool)], axis=1)
    shared = (estimate.weights[:, :, None, None] * table[:, None]).reshape(n, -1, lights)
    shared = jnp.concatenate([shared, stray[:, None]], axis=1)

    weighted = trust[:, None] * own
    gram = matmul(weighted, jnp.swapaxes(own, 1, 2))
    unit = jnp.eye(own.shape[1], dtype=values.dtype)[None]
    gram = jnp.where(free[:, :, None] & free[:, None, :], gram, unit)
    # Directions that a pixel hardly tells of are not taken for its answer.
    gram = gram + (1e-4 * jnp.diagonal(gram, axis1=1, axis2=2)[..., None] + 1e-6) * unit
    coupling = jnp.concatenate([matmul(weighted, jnp.swapaxes(shared, 1, 2)), matmul(weighted, residual[..., None])], 2)
    coupling = jnp.where(free[..., None], coupling, 0)
    response = jnp.linalg.solve(gram, coupling)
    matrix = jnp.einsum("ngl,nhl->gh", trust[:, None] * shared, shared)
    right = jnp.einsum("ngl,nl->g", shared, trust * residual)
    matrix = matrix - jnp.einsum("nag,nah->gh", coupling[..., :-1], response[..., :-1])
    return matrix, right - jnp.einsum("nag,na->g", coupling[..., :-1], response[..., -1])


def coefficients_of(
    columns: ShadingTable, materials: ShadingTable, ridge: float = 1e-5
) -> Float[Array, "materials columns"]:
    """The combinations of columns that are nearest to given materials, over all nodes and lights of their tables."""
    rows, wanted = _rows(columns), _rows(materials)
    gram = rows @ rows.T
    gram += ridge * np.trace(gram) / len(gram) * np.eye(len(gram))
    return jnp.asarray(np.linalg.solve(gram, rows @ wanted.T).T, columns.values.dtype)


def _rows(table: ShadingTable) -> np.ndarray:
    """A row for each column, over nodes and lights, in float64."""
    return np.asarray(jnp.moveaxis(table.values, 1, 0), np.float64).reshape(table.values.shape[1], -1)
