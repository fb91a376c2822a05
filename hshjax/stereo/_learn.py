"""What all pixels share, the BRDF above all: Gauss-Newton steps with everything that belongs to a pixel projected out.

Taking turns (normals, then BRDF) barely moves, for the normals absorb the error of the BRDF. Their response is a part
of these steps: variable projection by a Schur complement, a block a pixel.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float
from hshjax.bases._base import matmul
from hshjax.stereo._refine import Estimate, predicted, refine, robust_refine
from hshjax.stereo._shading import AbstractShadingTable, AbstractShadingTables
from hshjax.stereo._system import System
from hshjax.stereo._trust import SHADOWS, biweight, initial_trust, residual_scale, robust_trust

BEST = 0.5
"""Share of the pixels that is learned from: those that fit best, for the others are shadowed or lit by others."""

START = 4
"""Rounds of outliers before the first step."""

STIFFNESS = 3.0
"""Of the prior that keeps materials near their first guess, relative to what the pixels say and their noise: as if each
had seen that guess three times. Between the BRDF and the normals of a smooth object little is determined, and without
a prior solutions drift for ever."""

LARGEST_GAIN = 0.2
"""Of a step, in logarithms."""


class Shared(NamedTuple):
    """What pixels have in common.

    - `coefficients` `(materials, columns)`: of the BRDF.
    - `stray`: light that reaches every pixel by scattering in the lens and the room, as a share of the mean of the
      photograph.
    - `noise`: weighted mean square of what is not explained, relative to brightness, of the pixels learned from.
    - `gains` `(lights,)`: logarithms of how much brighter lights are than they were given as; their median is 0.
    """

    coefficients: Float[Array, "materials columns"]
    stray: Float[Array, ""]
    noise: float
    gains: Float[Array, " lights"]


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

    def under(self, gains: Float[Array, " lights"]) -> "Pixels":
        """As they would be if lights were as they were given: everything divided by the exponential of gains."""
        factor = jnp.exp(-gains)[None]
        return Pixels(self.values * factor, self.known, self.stray * factor)


def learn(
    columns: AbstractShadingTable,
    guess: Float[Array, "materials columns"],
    pixels: Pixels,
    pq: Float[Array, "n 2"],
    *,
    positive: Bool[np.ndarray, " columns"],
    rounds: int,
    stray: bool = True,
    gains: float = 0.0,
    done: Callable[[], None] = lambda: None,
) -> Shared:
    """The shared unknowns from some pixels: rounds of a step of theirs and a refinement of every normal.

    - `columns`: the table of what materials are made of. - `guess`: materials to begin with. - `pq`: normals likewise.
    - `positive`: which columns have no negative coefficient.
    - `gains`: standard deviation of their logarithms, as if every value had told of its light's once, with the noise
      that is found; 0: there are none. What falls or rises with the direction of light, normals and materials can
      undo, and only this keeps it.
    - `done`: called after every round.
    """
    dtype = pixels.values.dtype
    shared = Shared(guess, jnp.zeros((), dtype), 0.0, jnp.zeros(pixels.values.shape[1], dtype))
    metric = squares(columns)
    plain = initial_trust(pixels.values, pixels.known)
    estimate, _ = robust_refine(columns.mixed(guess), pixels.values, plain, pq, START, 8)
    for _ in range(rounds):
        table, given = columns.mixed(shared.coefficients), pixels.under(shared.gains)
        values, shades = given.without(shared.stray), predicted(table, estimate)
        weight = learning_weight(values, given.known, values - shades)
        noise = float(jnp.sum(weight * (values - shades) ** 2) / jnp.sum(weight))
        slopes = shades[:, None] if gains > 0 else None
        equations = shared_equations(columns, shared.coefficients, values, weight, estimate, given.stray, slopes)
        system = System(*equations, guess.size, values.shape[1])
        keep_materials(system, shared, guess, noise * metric, weight, estimate, positive)
        if gains > 0:
            keep_gains(system, shared, noise / gains**2, weight)
        shared = moved(shared, system, system.solve(stray))._replace(noise=noise)
        table, values = columns.mixed(shared.coefficients), pixels.under(shared.gains).without(shared.stray)
        trust = robust_trust(values - predicted(table, estimate), initial_trust(values, pixels.known))
        estimate = refine(table, values, trust, estimate.pq)
        done()
    return shared


def learning_weight(
    values: Float[Array, "n lights"], known: Float[Array, "n lights"], residual: Float[Array, "n lights"]
) -> Float[Array, "n lights"]:
    """How much values count where shared unknowns are learned: those of the `BEST` pixels, without outliers."""
    plain = initial_trust(values, known)
    best = fits_best(plain, residual).astype(values.dtype)[:, None]
    scale = residual_scale(residual, plain > 0)
    return best * initial_trust(values, known, SHADOWS) * biweight(residual, scale)


def fits_best(plain: Float[Array, "n lights"], residual: Float[Array, "n lights"]) -> Bool[Array, " n"]:
    """Which pixels are the `BEST` share, by residuals of values that are trusted, none of which counts for much."""
    misfit = jnp.mean(jnp.minimum(plain * jnp.abs(residual), 0.3), axis=1)
    return misfit <= jnp.quantile(misfit, BEST)


def keep_materials(
    system: System, shared: Shared, guess: Array, metric: np.ndarray, weight: Array, estimate: Estimate,
    positive: Bool[np.ndarray, " columns"],
) -> None:  # fmt: skip
    """The prior on coefficients, `STIFFNESS`, and bounds: coefficients of `positive` columns, and the share of stray
    light, stay at 0 or above. `metric`: squares of values as coefficients have it, times the noise."""
    now = np.asarray(shared.coefficients, np.float64)
    system.least[system.materials] = np.where(positive, -now, -np.inf).ravel()
    system.least[system.stray] = -float(shared.stray)
    amount = np.sum(np.asarray(weight)) * np.mean(np.asarray(estimate.weights, np.float64) ** 2, axis=0)
    strength = STIFFNESS * np.kron(np.diag(amount), metric)
    system.pull(system.materials, strength, np.asarray(shared.coefficients - guess, np.float64).ravel())


def keep_gains(system: System, shared: Shared, strength: float, weight: Array) -> None:
    """The prior on gains, which are the first of the unknowns of lights. `strength`: noise over their variance."""
    amount = strength * float(jnp.sum(weight)) / system.lights
    system.pull(system.of_lights(0, 1), amount * np.eye(system.lights), np.asarray(shared.gains, np.float64))


def moved(shared: Shared, system: System, step: np.ndarray) -> Shared:
    """What is shared after a step; gains, if they take part, are centred and move by `LARGEST_GAIN` at most."""
    dtype = shared.coefficients.dtype
    coefficients = shared.coefficients + jnp.asarray(step[system.materials].reshape(shared.coefficients.shape), dtype)
    stray = shared.stray + jnp.asarray(step[system.stray], dtype)
    shared = shared._replace(coefficients=coefficients, stray=jnp.maximum(stray, 0))  # but for rounding it is
    if system.kinds == 0:
        return shared
    gains = np.asarray(shared.gains) + np.clip(step[system.of_lights(0, 1)], -LARGEST_GAIN, LARGEST_GAIN)
    return shared._replace(gains=jnp.asarray(gains - np.median(gains), dtype))


@eqx.filter_jit
def shared_equations(
    columns: AbstractShadingTable,
    coefficients: Float[Array, "materials columns"],
    values: Float[Array, "n lights"],
    trust: Float[Array, "n lights"],
    estimate: Estimate,
    stray: Float[Array, "n lights"],
    slopes: Float[Array, "n kinds lights"] | None = None,
) -> tuple[Float[Array, "unknowns unknowns"], Float[Array, " unknowns"]]:
    """Normal equations of changes of the coefficients, material by material, and of the share of stray light.

    Weights that are not 0 and normals are projected out, pixel by pixel.

    - `slopes`: what unknowns that each light has of its own do to its values. They come last, kind by kind.
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
    coupling = [matmul(weighted, jnp.swapaxes(shared, 1, 2)), matmul(weighted, residual[..., None])]
    matrix = jnp.einsum("ngl,nhl->gh", trust[:, None] * shared, shared)
    right = jnp.einsum("ngl,nl->g", shared, trust * residual)
    if slopes is not None:
        coupling.insert(1, (weighted[:, :, None] * slopes[:, None]).reshape(n, own.shape[1], -1))
        mixed, own_block, own_right = light_blocks(shared, slopes, trust, residual)
        matrix = jnp.block([[matrix, mixed], [mixed.T, own_block]])
        right = jnp.concatenate([right, own_right])
    coupling = jnp.where(free[..., None], jnp.concatenate(coupling, axis=2), 0)
    response = jnp.linalg.solve(gram, coupling)
    matrix = matrix - jnp.einsum("nag,nah->gh", coupling[..., :-1], response[..., :-1])
    return matrix, right - jnp.einsum("nag,na->g", coupling[..., :-1], response[..., -1])


def light_blocks(shared, slopes, trust, residual) -> tuple[Array, Array, Array]:
    """What the unknowns of single lights add: with the others, among themselves (a light's alone), and on the right."""
    kinds, lights = slopes.shape[1:]
    mixed = jnp.einsum("ngl,nkl->gkl", trust[:, None] * shared, slopes).reshape(shared.shape[1], -1)
    same = jnp.einsum("nkl,nml->kml", trust[:, None] * slopes, slopes)
    block = jnp.swapaxes(same[:, :, None] * jnp.eye(lights, dtype=slopes.dtype)[None, None], 1, 2)
    right = jnp.einsum("nkl,nl->kl", slopes, trust * residual)
    return mixed, block.reshape(kinds * lights, kinds * lights), right.ravel()


def coefficients_of(
    columns: AbstractShadingTables, materials: AbstractShadingTables, ridge: float = 1e-5
) -> Float[Array, "materials columns"]:
    """The combinations of columns that are nearest to given materials, over all nodes and lights of their tables."""
    rows, wanted = _rows(columns), _rows(materials)
    gram = rows @ rows.T
    gram += ridge * np.trace(gram) / len(gram) * np.eye(len(gram))
    return jnp.asarray(np.linalg.solve(gram, rows @ wanted.T).T, columns.dtype)


def squares(columns: AbstractShadingTables) -> Float[np.ndarray, "columns columns"]:
    """Mean products of columns over all nodes and lights of their table."""
    rows = _rows(columns)
    return rows @ rows.T / rows.shape[1]


def _rows(table: AbstractShadingTables) -> np.ndarray:
    """A row for each column, over nodes and lights, in float64."""
    return np.asarray(table.rows(), np.float64)
