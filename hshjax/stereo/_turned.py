"""Lights that turn while materials are learned: two more unknowns a light in the Schur step, and what holds them.

Lambert's law is blind to a linear map of lights that normals undo (eight numbers), and of the photographs only
highlights and intensities tell of it; what they tell is little, so steps are held by priors of three kinds.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.lighting import DirectionalLight
from hshjax.reflectance import reflect
from hshjax.stereo._chart import from_chart
from hshjax.stereo._columns import Column, column_brdfs, combined, first_guess, positive_columns
from hshjax.stereo._learn import (
    START,
    Pixels,
    Shared,
    coefficients_of,
    keep_materials,
    learning_weight,
    moved,
    shared_equations,
    squares,
)  # fmt: skip
from hshjax.stereo._refine import predicted, refine, robust_refine
from hshjax.stereo._shading import shading_table
from hshjax.stereo._system import System
from hshjax.stereo._trust import initial_trust, robust_trust

SIZE = 65
"""Of shading tables, which every round makes anew."""

LONGEST_TURN = 0.08
"""Of a step [radians]."""

SINGLE = 1e2
"""Of the prior on what turns and gains are beside a linear map of all lights: as if that many values, with the noise
that is found, had told of each light's. The rank of the photographs tells it well from the start."""

TOGETHER = 1e3
"""Of the prior on turning all lights together, which the contour has settled: in the same unit."""

BRIGHTNESS = 4e-4
"""Of the prior on gains: squared error of values relative to brightness that a gain of 1 (a factor of e) is as bad as.
In this unit, not in that of the noise, for intensities at the start are not worse where photographs fit worse."""


class Turned(NamedTuple):
    """Lights as they are found: unit `directions` `(lights, 3)`, logarithms of `gains` `(lights,)`, and `noise`."""

    directions: Float[np.ndarray, "lights 3"]
    gains: Float[np.ndarray, " lights"]
    noise: float


def turned_lights(
    columns: Sequence[Column], materials: int, pixels: Pixels, pq: Float[Array, "n 2"],
    directions: Float[np.ndarray, "lights 3"], *, rounds: int, stray: bool, done: Callable[[], None],
) -> Turned:  # fmt: skip
    """Directions and gains of lights from some pixels, with materials, stray light and normals.

    - `pq`, `directions`: to begin with.
    """
    start, dtype = directions, pixels.values.dtype
    brdfs = column_brdfs(columns)
    table = shading_table(brdfs, jnp.asarray(directions, dtype), SIZE)
    guess = coefficients_of(table, shading_table(first_guess(materials), jnp.asarray(directions, dtype), SIZE))
    metric = squares(table)
    shared = Shared(guess, jnp.zeros((), dtype), 0.0, jnp.zeros(len(directions), dtype))
    plain = initial_trust(pixels.values, pixels.known)
    estimate, _ = robust_refine(table.mixed(guess), pixels.values, plain, pq, START, 8)
    for _ in range(rounds):
        given = pixels.under(shared.gains)
        values, shades = given.without(shared.stray), predicted(table.mixed(shared.coefficients), estimate)
        weight = learning_weight(values, given.known, values - shades)
        noise = float(jnp.sum(weight * (values - shades) ** 2) / jnp.sum(weight))
        across = tangents(directions)
        turns = turn_slopes(
            combined(columns, shared.coefficients), estimate.weights, from_chart(estimate.pq),
            jnp.asarray(directions, dtype), jnp.asarray(across, dtype),
        )  # fmt: skip
        slopes = jnp.concatenate([shades[:, None], turns], axis=1)
        equations = shared_equations(table, shared.coefficients, values, weight, estimate, given.stray, slopes)
        system = System(*equations, guess.size, len(directions))
        keep_materials(system, shared, guess, noise * metric, weight, estimate, positive_columns(columns))
        frames = np.concatenate([directions[:, None], across], axis=1)
        keep_lights(system, start, directions, np.asarray(shared.gains, float), frames, noise, float(jnp.sum(weight)))
        step = system.solve(stray)
        shared = moved(shared, system, step)._replace(noise=noise)
        turn = np.einsum("kj,jka->ja", step[system.of_lights(1, 3)].reshape(2, -1), across)
        largest = np.max(np.linalg.norm(turn, axis=1))
        directions = directions + turn * min(1.0, LONGEST_TURN / max(largest, LONGEST_TURN))
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        table = shading_table(brdfs, jnp.asarray(directions, dtype), SIZE)
        values, mixed = pixels.under(shared.gains).without(shared.stray), table.mixed(shared.coefficients)
        trust = robust_trust(values - predicted(mixed, estimate), initial_trust(values, pixels.known))
        estimate = refine(mixed, values, trust, estimate.pq)
        done()
    return Turned(directions, np.asarray(shared.gains, float), shared.noise)


def keep_lights(system, start, directions, gains, frames, noise, weight) -> None:
    """The priors on lights, of kinds gain, turn, turn. `frames` `(lights, 3, 3)`: the direction and its tangents, rows.

    A light is the vector gain times direction; how it differs from the start's is taken apart into a linear map of the
    start's, of which a rotation is a part, and the rest.
    """
    lights = len(start)
    amount = weight / lights
    basis, _ = np.linalg.qr(start)
    rest = np.eye(lights) - basis @ basis.T
    rotations, _ = np.linalg.qr(np.stack([np.cross(axis, start).ravel() for axis in np.eye(3)], axis=1))
    rotations = np.einsum("jka,jar->kjr", frames, rotations.reshape(lights, 3, 3)).reshape(3 * lights, 3)
    single = np.einsum("jka,jl,lma->kjml", frames, rest, frames).reshape(3 * lights, 3 * lights)
    strength = noise * amount * (SINGLE * single + TOGETHER * rotations @ rotations.T)
    moved_by = np.einsum("jka,ja->kj", frames, np.exp(gains)[:, None] * directions - start).ravel()
    system.pull(system.of_lights(0, 3), strength, moved_by)
    system.pull(system.of_lights(0, 1), BRIGHTNESS * amount * np.eye(lights), gains)


def tangents(directions: Float[np.ndarray, "lights 3"]) -> Float[np.ndarray, "lights 2 3"]:
    """Two unit vectors across each direction, and across each other."""
    helper = np.where(np.abs(directions[:, 2:]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]])
    first = np.cross(helper, directions)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], axis=1)


@eqx.filter_jit
def turn_slopes(
    brdf: AbstractBRDF, weights: Float[Array, "n materials"], normals: Float[Array, "n 3"],
    directions: Float[Array, "lights 3"], across: Float[Array, "lights 2 3"],
) -> Float[Array, "n 2 lights"]:  # fmt: skip
    """Derivatives of radiance in directions of lights, along two tangents each."""
    view, one = jnp.asarray([0, 0, 1], directions.dtype), jnp.ones((), directions.dtype)

    def under(light):
        direction, both = light

        def radiance(towards):
            return jnp.sum(weights * reflect(brdf, DirectionalLight(towards, one), normals, view), axis=1)

        return jax.vmap(lambda tangent: jax.jvp(radiance, (direction,), (tangent,))[1])(both)

    return jnp.transpose(jax.lax.map(under, (directions, across)), (2, 1, 0))
