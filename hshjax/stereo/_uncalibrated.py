"""Normals, reflectance and lights, of which nothing is known, far away."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax.photographs import Photographs
from hshjax.stereo._axes import camera_axes
from hshjax.stereo._calibrated import solve_calibrated
from hshjax.stereo._chart import to_chart
from hshjax.stereo._columns import Column, default_columns
from hshjax.stereo._contour import contour, turn
from hshjax.stereo._factor import factored
from hshjax.stereo._history import History, Progress
from hshjax.stereo._observe import Observations
from hshjax.stereo._result import Stereo
from hshjax.stereo._semi_calibrated import SOME, intensities, under
from hshjax.stereo._stages import band_normals
from hshjax.stereo._strength import strengths
from hshjax.stereo._turned import turned_lights

FEWEST = 8
"""Photographs: six of them settle the matrix of the factors, and single outliers need more."""


def solve_uncalibrated(
    photographs: Photographs,
    *,
    materials: int = 2,
    columns: Sequence[Column] | None = None,
    pixels: int = 2000,
    turns: int = 6,
    equal: bool = False,
    stray: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> Stereo:
    """Normals, reflectance, directions and intensities of lights far away, from photographs alone.

    `photographs.lights` are not looked at. Intensities begin as what lights make of the pixels that face them;
    directions as the factor of photographs that have Lambert's rank, of unit length,
    turned so that normals look out of the mask at its contour: which tells hollow from raised, and left from right.
    Directions and intensities then move while materials are learned from some pixels, and all is solved as with known
    lights (`solve_calibrated`, whose `options` are these) under those that were found.

    - `pixels`, `turns`: how many pixels lights are learned from, and for how many rounds.
    - `equal`: whether intensities begin as equal, not as what lights make of the pixels that face them: better where
      they are near to equal, or lights few and on one side.
    - `lights` of the result: see `solve_semi_calibrated` for the scale of their irradiance.
    - `history`: `forced` is 1 where no surface at all makes lights of the intensities at the start, as on bare metals:
      then directions are not to be relied on, and errors of 20 degrees are usual.

    Lambert's law knows lights up to eight numbers only, and intensities and highlights tell of these but little: take
    what is found for right within some degrees. The object must be seen whole, or most of its contour: where the mask
    ends, its surface must turn away from the camera.

    **Raises:** ValueError for fewer than `FEWEST` photographs, a mask without a contour inside of the photographs,
    lights that do not determine the factors, a camera nearby, and as `solve_calibrated`.
    """
    if photographs.count < FEWEST:
        raise ValueError(f"unknown lights need at least {FEWEST} photographs, got {photographs.count}")
    for name, value, least in (("pixels", pixels, 1), ("turns", turns, 0)):
        if value < least:
            raise ValueError(f"{name} must be at least {least}, got {value}")
    if photographs.camera is not None and photographs.camera.needs_positions:
        raise ValueError("unknown lights are found for a camera far away: give photographs without camera, or lights")
    camera, photographs = photographs.camera, replace(photographs, camera=None)
    contour(photographs.mask)  # raises, before anything takes long
    columns = default_columns() if columns is None else columns
    history = History(progress)
    with history.stage("factors") as done:
        some = np.sort(np.random.default_rng([seed, 1]).permutation(photographs.pixels)[:SOME])
        upwards = np.broadcast_to([0.0, 0.0, 1.0], (photographs.count, 3))
        begun = intensities(
            np.asarray(photographs.values[some], np.float32)
        )  # raises for black photographs, if equal too
        photographs = under(photographs, upwards, np.ones_like(begun) if equal else begun)
        observations = Observations(photographs, directed=False)
        directions, forced = factored(observations.pixels(some))
        done.figures["forced"] = float(forced)
        scaled = band_normals(observations, jnp.asarray(directions, jnp.float32)).astype(float)
        length = np.linalg.norm(scaled, axis=1, keepdims=True)
        normals = np.where(length > 0, scaled, [[0, 0, 1]]) / np.where(length > 0, length, 1)
        rotation = turn(normals, photographs.mask)
        directions, normals = directions @ rotation.T, normals @ rotation.T
        done()
    with history.stage("lights", turns) as done:
        chosen = observations.some(pixels, np.random.default_rng([seed, 2]))
        found = turned_lights(
            columns, materials, observations.pixels(chosen), to_chart(jnp.asarray(normals[chosen], jnp.float32)),
            directions, rounds=turns, stray=stray, done=done,
        )  # fmt: skip
        moved = np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(found.directions - directions, axis=1) / 2, 0, 1)))
        done.figures |= {"moved": float(np.mean(moved)), "noise": found.noise}
    irradiance = strengths(observations.lights) * np.exp(found.gains)[:, None]
    photographs = under(photographs, found.directions, irradiance)
    solved = solve_calibrated(
        photographs, materials=materials, columns=columns, stray=stray, seed=seed, progress=progress, **options
    )
    # Found in the axes of the camera, told in the world.
    axes = camera_axes(camera).astype(np.float32)
    lights = eqx.tree_at(lambda lights: lights.direction, solved.lights, replace_fn=lambda towards: towards @ axes)
    stages = (*history.stages, *solved.history)
    return replace(solved, normals=solved.normals @ axes, lights=lights, camera=camera, history=stages)
