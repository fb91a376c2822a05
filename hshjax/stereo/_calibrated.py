"""Normals and reflectance under known lights."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from hshjax.photographs import Photographs
from hshjax.stereo._columns import Column, column_brdfs, combined, default_columns, first_guess, positive_columns
from hshjax.stereo._history import History, Progress
from hshjax.stereo._intensity import band_gains, single_gains
from hshjax.stereo._learn import Shared, coefficients_of, learn
from hshjax.stereo._observe import Observations
from hshjax.stereo._propagate import FAR, neighbours
from hshjax.stereo._result import Stereo
from hshjax.stereo._shading import AbstractShadingTables
from hshjax.stereo._stages import finish, hand_on, refine_all, start
from hshjax.stereo._weights import LIMIT


def solve_calibrated(
    photographs: Photographs,
    *,
    materials: int = 2,
    columns: Sequence[Column] | None = None,
    pixels: int = 3000,
    rounds: int = 10,
    sweeps: int = 8,
    smoothness: float = 7.0,
    stray: bool = True,
    gains: float = 0.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> Stereo:
    """Normals, weights of materials and their BRDF, from photographs under known lights.

    Lambert's law on values of middle ranks gives a start. On some pixels the BRDF of a few materials is learned, each a
    combination of `columns`, while normals and weights answer (variable projection). Then every pixel is solved, and
    normals are handed on between neighbours where they explain the photographs.

    Lights (`PointLight`) or a camera (`PerspectiveCamera`) nearby need to know where pixels are. That begins as a
    plane and is found anew from normals three times by Lambert's law, once when materials were learned, which then are
    learned again, and at the end (`positions`). Normals tell no mean depth: it is that of the plane through what the
    camera sees in the middle of the image, its `target`, or `centre` of an `OrthographicCamera`, at right angles to the
    view; of each piece of the surface, should it have several.

    - `materials`: how many BRDFs the surface is mixed of, 1 to 5.
    - `columns`: isotropic reciprocal bases and single-channel BRDFs; None: `default_columns`. More of them follow a
      material better and need more of the surface to be determined.
    - `pixels`, `rounds`: how many pixels materials are learned from, and how long.
    - `sweeps`: of handing on, 0 for none. - `smoothness`: how much agreement with neighbours counts in it, in units of
      the noise that is found: the worse photographs are explained, the more.
    - `stray`: whether light that strays (a share of the mean of each photograph) is found and taken off.
    - `gains`: how wrong the irradiance of lights may be, a standard deviation of logarithms: 0 for right as it is, 0.03
      where single photographs may be too bright or too dark besides; see `learn`. `lights` of the result hold what was
      found.
    - `seed`: of the choice of pixels. - `progress`: called with a stage, what is done and what there is to do.

    **Raises:** ValueError for photographs that do not determine normals (`Observations`), and for other arguments out
    of range.
    """
    if not 1 <= materials <= LIMIT:
        raise ValueError(f"materials must be 1 to {LIMIT}, got {materials}")
    least_values = ("pixels", pixels, 1), ("rounds", rounds, 0), ("sweeps", sweeps, 0), ("gains", gains, 0)
    for name, value, least in least_values:
        if value < least:
            raise ValueError(f"{name} must be at least {least}, got {value}")
    columns = default_columns() if columns is None else columns
    observations, history = Observations(photographs), History(progress)
    steps, starts = observations.steps, observations.geometry.starts
    chosen = observations.some(pixels, np.random.default_rng(seed))
    with history.stage("start", steps * (1 + starts)) as done:
        if gains > 0:
            towards = observations.geometry.towards(chosen)
            found = band_gains(observations.pixels(chosen), towards)
            single = single_gains(found, np.asarray(towards).reshape(-1, photographs.count, 3).mean(axis=0))
            observations = observations.brighter(np.exp(single))
            done.figures["single"] = float(np.sum(single != 0))
        pq = start(observations, done)
        for _ in range(starts):
            observations = observations.moved(pq)
            pq = start(observations, done)

    def learned(
        observations: Observations, pq: np.ndarray
    ) -> tuple[Observations, AbstractShadingTables, Shared, np.ndarray]:
        with history.stage("learn", rounds) as done:
            geometry, some = observations.geometry, observations.pixels(chosen)
            tables = geometry.tables(column_brdfs(columns))
            guess = coefficients_of(tables, geometry.tables(first_guess(materials)))
            shared = learn(
                tables.of(geometry.towards(chosen)), guess, some, jnp.asarray(pq[chosen]),
                positive=positive_columns(columns), rounds=rounds, stray=stray, gains=gains, done=done,
            )  # fmt: skip
            done.figures |= {"stray": float(shared.stray), "noise": shared.noise}
        if gains > 0:
            observations = observations.brighter(np.exp(np.asarray(shared.gains)))
        mixed = tables.mixed(shared.coefficients)
        with history.stage("normals", steps) as done:
            return observations, mixed, shared, refine_all(observations, mixed, shared.stray, pq, 4, 8, done)

    given = observations
    observations, mixed, shared, pq = learned(given, pq)
    for _ in range(given.geometry.again):  # from the lights that were given: priors are about them
        observations, mixed, shared, pq = learned(given.moved(pq), pq)
    with history.stage("neighbours", steps * sweeps) as done:
        near, amount = neighbours(photographs.mask), smoothness * shared.noise**0.5
        for sweep in range(sweeps):
            far = neighbours(photographs.mask, FAR[sweep % len(FAR)])
            pq = hand_on(observations, mixed, shared.stray, pq, near, far, amount, done)
    with history.stage("reflectance", steps) as done:
        observations = observations.moved(pq)
        found = finish(observations, mixed, shared.stray, pq, done)
        done.figures["outliers"] = float(np.mean(found["outliers"]))
    return Stereo(
        brdf=combined(columns, shared.coefficients), lights=observations.lights, stray=float(shared.stray),
        mask=photographs.mask, history=tuple(history.stages), camera=photographs.camera,
        positions=observations.geometry.positions, **found,
    )  # fmt: skip
