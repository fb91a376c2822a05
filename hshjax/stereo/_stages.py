"""The stages of a solution, tile by tile: a start, normals, normals handed on, reflectance."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, Int
from hshjax.stereo._band import band_trust, scaled_normals
from hshjax.stereo._chart import from_chart, to_chart
from hshjax.stereo._history import Running
from hshjax.stereo._observe import Observations
from hshjax.stereo._propagate import take_over
from hshjax.stereo._refine import Estimate, normal_equations, predicted, robust_refine, weigh
from hshjax.stereo._rendered import Rendered
from hshjax.stereo._restart import refine_from_both
from hshjax.stereo._shading import AbstractShading, AbstractShadingTables
from hshjax.stereo._trust import initial_trust, residual_scale


def start(observations: Observations, done: Running) -> Float[np.ndarray, "pixels 2"]:
    """Normals by Lambert's law on values of middle ranks, in the chart."""
    scaled = jnp.asarray(band_normals(observations, None, done))
    length = jnp.sqrt(jnp.sum(scaled * scaled, axis=1, keepdims=True))
    towards = jnp.asarray([[0, 0, 1]], scaled.dtype)
    return np.asarray(to_chart(jnp.where(length > 0, scaled / jnp.where(length > 0, length, 1), towards)))


def band_normals(
    observations: Observations, directions: Float[Array, "lights 3"] | None, done: Callable[[], None] = lambda: None
) -> Float[np.ndarray, "pixels 3"]:
    """`scaled_normals` of values of middle ranks, under lights of these directions; None: of those that are known."""
    scaled = np.empty((observations.photographs.pixels, 3), np.float32)
    for part, pixels in observations.tiles():
        towards = observations.towards(part) if directions is None else directions
        _keep(scaled, part, scaled_normals(pixels.values, band_trust(pixels.values, pixels.known), towards))
        done()
    return scaled


def refine_all(
    observations: Observations, tables: AbstractShadingTables, stray: Float[Array, ""],
    pq: Float[np.ndarray, "pixels 2"], rounds: int, steps: int, done: Running,
) -> Float[np.ndarray, "pixels 2"]:  # fmt: skip
    """Every normal from where it is and from the best of normals all over, outliers found in rounds."""
    found = np.empty_like(pq)
    for part, pixels in observations.tiles():
        values = pixels.without(stray)
        table, begin = tables.of(observations.towards(part)), observations.filled(pq[part])
        _keep(found, part, refine_from_both(table, values, pixels.known, begin, rounds, steps))
        done()
    return found


def hand_on(
    observations: Observations, tables: AbstractShadingTables, stray: Float[Array, ""],
    pq: Float[np.ndarray, "pixels 2"],
    near: Int[np.ndarray, "pixels 8"], far: Int[np.ndarray, "pixels 8"], smoothness: float, done: Running,
) -> Float[np.ndarray, "pixels 2"]:  # fmt: skip
    """Normals taken over from other pixels, all at once: a sweep.

    - `near`, `far`: their numbers, -1 where there is none.
    """
    found, weight = np.empty_like(pq), jnp.asarray(smoothness, jnp.float32)
    for part, pixels in observations.tiles():
        values = pixels.without(stray)
        plain = initial_trust(values, pixels.known)
        own, there = pq[part], near[part] >= 0
        others = [
            np.where(number[..., None] >= 0, observations.geometry.carried(pq, number, part), own[:, None])
            for number in (near[part], far[part])
        ]
        own, near_pq, far_pq, exists = (observations.filled(array) for array in (own, *others, there))
        table = tables.of(observations.towards(part))
        _keep(found, part, _hand_on(table, values, plain, own, near_pq, far_pq, exists, weight))
        done()
    return found


@eqx.filter_jit
def _hand_on(table, values, plain, pq, near, far, there, smoothness):
    estimate, _ = robust_refine(table, values, plain, pq, 2, 0)
    scale = residual_scale(values - predicted(table, estimate), plain > 0)
    return take_over(table, values, plain, scale, pq, near, far, there, smoothness)


def finish(
    observations: Observations,
    tables: AbstractShadingTables | Rendered,
    stray: Float[Array, ""],
    pq: Float[np.ndarray, "pixels 2"],
    done: Running,
) -> dict[str, Any]:
    """Normals, weights in all channels, deviations, outliers and shadows."""
    photographs, materials = observations.photographs, tables.columns
    count, lights, channels = photographs.values.shape
    normals, deviation = np.empty((count, 3), np.float32), np.empty(count, np.float32)
    weights = np.empty((count, materials, channels), np.float32)
    outliers, shadows = np.empty((count, lights), bool), np.empty((count, lights), bool)
    for part, pixels in observations.tiles():
        values = pixels.without(stray)
        plain = initial_trust(values, pixels.known)
        table = tables.of(observations.towards(part))
        estimate, trust = robust_refine(table, values, plain, observations.filled(pq[part]), 4, 0)
        _keep(
            normals,
            part,
            observations.geometry.world(np.asarray(from_chart(estimate.pq))[: part.stop - part.start], part),
        )
        _keep(deviation, part, predicted_deviation(table, values, trust, estimate))
        colour = observations.colour(part) - float(stray) * observations.stray(part)
        known = np.isfinite(colour)
        both = observations.filled(np.where(known, colour, 0)), observations.filled(known.astype(np.float32))
        _keep(weights, part, _weigh_channels(table, *both, trust, estimate.pq))
        _keep(outliers, part, (trust == 0) & (plain > 0))
        _keep(shadows, part, (plain == 0) & (pixels.known > 0))
        done()
    return {
        "normals": normals, "weights": weights, "deviation": deviation, "outliers": outliers, "shadows": shadows,
    }  # fmt: skip


@eqx.filter_jit
def _weigh_channels(table, colour, known, trust, pq) -> Float[Array, "n materials channels"]:
    shading = table.at(pq)

    def channel(given):
        values, known = given
        return weigh(shading, values, trust * known)[0]

    channels = jnp.moveaxis(colour, 2, 0), jnp.moveaxis(known, 2, 0)
    return jnp.moveaxis(jax.lax.map(channel, channels), 0, 2)


@eqx.filter_jit
def predicted_deviation(
    table: AbstractShading, values: Float[Array, "n lights"], trust: Float[Array, "n lights"], estimate: Estimate
) -> Float[Array, " n"]:
    """Standard deviation of normals [radians]: of the normal equations, noise by the residuals. Root of the mean of the
    two directions' variances; infinite where there are no more values than unknowns."""
    shading, slope = table.with_slope(estimate.pq)
    residual = values - jnp.sum(estimate.weights[..., None] * shading, axis=1)
    hessian, _ = normal_equations(shading, slope, estimate.weights, residual, trust)
    used = jnp.sum(trust > 0, axis=1)
    free = used - 2 - jnp.sum(estimate.weights > 0, axis=1)
    noise = jnp.sum(trust * residual**2, axis=1) / jnp.maximum(free, 1).astype(values.dtype)
    determinant = hessian[:, 0, 0] * hessian[:, 1, 1] - hessian[:, 0, 1] ** 2
    mean = noise * (hessian[:, 0, 0] + hessian[:, 1, 1]) / (2 * determinant)
    turn = 2 / (1 + jnp.sum(estimate.pq**2, axis=1))  # radians a unit of the chart
    determined = (free > 0) & (determinant > 0) & (mean >= 0)
    return jnp.where(determined, turn * jnp.sqrt(jnp.where(determined, mean, 0)), jnp.inf)


def _keep(target: np.ndarray, part: slice, tile: Array | np.ndarray) -> None:
    target[part] = np.asarray(tile)[: part.stop - part.start]
