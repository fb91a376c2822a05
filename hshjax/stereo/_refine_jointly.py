"""Normals, BRDF and lights refined together by gradients through Eq. 1, from a result of photometric stereo on."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from hshjax._typing import Array, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.brdfs._base import in_dtype
from hshjax.fitting import fit
from hshjax.fitting._bounds import declaration
from hshjax.fitting._fit import Solver, chosen
from hshjax.photographs import Photographs
from hshjax.stereo._chart import to_chart, within
from hshjax.stereo._history import History, Progress
from hshjax.stereo._joint import (
    Coordinates,
    InBounds,
    Material,
    NearLights,
    NearMaterial,
    NearNormals,
    Photometric,
    Unknowns,
    nodes,
    of_lights,
    of_normals,
    of_numbers,
    of_prior,
    root_of,
    slopes_at,
    whitening,
)
from hshjax.stereo._learn import START, STIFFNESS, fits_best
from hshjax.stereo._observe import Observations
from hshjax.stereo._refine import weigh
from hshjax.stereo._rendered import Rendered
from hshjax.stereo._result import Stereo
from hshjax.stereo._stages import finish
from hshjax.stereo._strength import brighter
from hshjax.stereo._trust import CUT, biweight, initial_trust, residual_scale
from hshjax.stereo._turned import tangents

GRID = 13
"""Nodes along a side of the chart, where materials are held near those of the start."""

SETTLED, STILL = 1e-4, 0.05
"""A round ends where the loss changes by less than this share of it, and every unknown by less than this part of what
photographs leave open."""


def amplitudes(brdf: AbstractBRDF) -> Any:
    """Which numbers a BRDF is linear in: coefficients of series and factors of multiples, a tree of booleans."""

    def linear(path, leaf):
        name, (_, metadata) = getattr(path[-1], "name", ""), declaration(brdf, path)
        factor = name == "scale" and metadata.get("amplitude", False)  # warps of bases have scales, too
        return eqx.is_inexact_array(leaf) and (name == "coefficients" or factor)

    return jax.tree_util.tree_map_with_path(linear, brdf)


def refine_jointly(
    stereo: Stereo,
    photographs: Photographs,
    *,
    normals: bool = True,
    brdf: bool | Callable[[AbstractBRDF], Any] = True,
    lights: bool = False,
    start: AbstractBRDF | None = None,
    pixels: int = 2000,
    rounds: int = 3,
    steps: int = 25,
    stiffness: float = 1.0,
    turns: float = 0.01,
    gains: float = 0.03,
    solver: Solver | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Stereo:
    """A result of photometric stereo, its unknowns moved together to where photographs are explained better.

    Two stages. On some pixels, those that are explained best, everything chosen moves at once by `hshjax.fit`: ½ Σ
    trust (values - Eq. 1)² over the noise, and priors that hold each unknown near the start. Residuals are judged by
    Tukey's biweight, whose weights are found anew in each round, with scales that are those of the start: the robust
    loss falls from round to round, or the refinement ends. Then, with what pixels share held, each normal follows by
    the same loss, tile by tile.

    - `normals`, `brdf`, `lights`: what moves. `brdf=True`: what the model is linear in (`amplitudes`); or a function
      that picks parts, as `trainable` of `fit`: `lambda brdf: brdf.a.b.brdf.roughness`.
    - `start`: the BRDF to begin with, a channel for each material, in place of that of `stereo`: a richer one, say.
    - `pixels`: how many are looked at while shared unknowns move; the half of them that fits best counts.
    - `rounds`: of judging residuals, 1 at least. - `steps`: of the solver in each, at most.
    - `stiffness`: of the prior on normals, relative to what the photographs say of each. 0: none. It takes what
      normals gained from their neighbours into account, which photographs alone would undo.
    - `turns` [radians], `gains` [logarithms]: standard deviations of lights about the start, as if every value had told
      of them once, with the noise that is found: errors of a model do not average out as noise does.
    - `solver`: of `fit`; None: `optimistix.LBFGS`. - `seed`: of the choice of pixels. - `progress`: as elsewhere.

    Lights and camera to begin with are those of `stereo`, whatever the photographs say. Values that it masks
    (`outliers`, `shadows`) count for nothing; at the end masks, weights and deviations are found anew. `history` goes
    on with stages "joint" and "follow", with the losses at start and end. Works in jax's default float; what is
    returned is float32, as elsewhere.

    **Raises:** ValueError for photographs that do not belong to the result, for a BRDF of another number of channels
    than the materials, nothing to refine, and other arguments out of range.
    """
    _check(stereo, photographs, normals, brdf, lights)
    for name, value, least in (("pixels", pixels, 2), ("rounds", rounds, 1), ("steps", steps, 1)):
        if value < least:
            raise ValueError(f"{name} must be at least {least}, got {value}")
    for name, value, limit in (("stiffness", stiffness, -1e-30), ("turns", turns, 0), ("gains", gains, 0)):
        if not value > limit:
            raise ValueError(f"{name} must be {'at least' if name == 'stiffness' else 'above'} 0, got {value}")
    dtype = jnp.result_type(float)
    model = in_dtype(stereo.brdf if start is None else start, dtype)
    observations = Observations(replace(photographs, lights=stereo.lights, camera=stereo.camera))
    history = History(progress)
    if observations.geometry.positions is not None:
        raise ValueError("lights and camera must be far away for joint refinement: others change from pixel to pixel")
    everywhere = slice(None)
    found = Rendered(model, observations.geometry.towards(everywhere).astype(dtype), jnp.ones(photographs.count, dtype))
    if found.columns != stereo.weights.shape[1]:
        raise ValueError(f"the BRDF has {found.columns} channels, the result {stereo.weights.shape[1]} materials")
    material = Material.of(model, amplitudes(model) if brdf is True else chosen(model, brdf) if brdf else False)
    if not (normals or lights or material.start.size):
        raise ValueError("nothing is to be refined: the BRDF is linear in none of its numbers; pick parts with brdf=")
    solver = optx.LBFGS(rtol=SETTLED, atol=STILL) if solver is None else solver
    local = observations.geometry.local(stereo.normals, everywhere)
    pq = np.asarray(to_chart(jnp.asarray(local, jnp.float32)))
    settings = _Settings(solver, rounds, steps, stiffness, turns, gains)
    some = observations.some(pixels, np.random.default_rng(seed))
    with history.stage("joint", rounds) as done:
        masked = jnp.asarray(stereo.outliers[some] | stereo.shadows[some])
        problem = _Problem.of(observations.pixels(some), masked, stereo.stray, found, pq[some], best=True)
        state, figures = _together(problem, found, material, settings, normals, lights, done)
        done.figures |= figures
    with history.stage("follow", observations.steps) as done:
        if lights:
            observations = _under(observations, state)
        towards = observations.geometry.towards(everywhere)
        shared = Rendered(state.brdf, towards.astype(dtype), jnp.ones_like(state.gains))
        if normals:
            pq = _follow(observations, stereo, shared, pq, settings, problem.noise, done)
    brdf_found = in_dtype(state.brdf, jnp.float32)
    with history.stage("reflectance", observations.steps) as done:
        one = jnp.ones(photographs.count, jnp.float32)
        stray = jnp.asarray(stereo.stray, jnp.float32)
        end = finish(observations, Rendered(brdf_found, towards, one), stray, pq, done)
        done.figures["outliers"] = float(np.mean(end["outliers"]))
    return Stereo(
        brdf=brdf_found, lights=observations.lights, stray=stereo.stray, mask=stereo.mask,
        history=(*stereo.history, *history.stages), camera=stereo.camera, positions=None, **end,
    )  # fmt: skip


class _Settings(NamedTuple):
    solver: Solver
    rounds: int
    steps: int
    stiffness: float
    turns: float
    gains: float


class _Problem(NamedTuple):
    """Pixels that are looked at, relative to their brightness.

    - `values`, `plain` `(n, lights)`: and the trust in them before residuals are judged. - `scale` `(n, 1)`: of the
      judgement. - `pq`: normals to begin with, and the `residual` there. - `noise`: its weighted mean square.
    """

    values: Float[Array, "n lights"]
    plain: Float[Array, "n lights"]
    scale: Float[Array, "n 1"]
    pq: Float[Array, "n 2"]
    residual: Float[Array, "n lights"]
    noise: float

    @classmethod
    def of(cls, seen, masked, stray, shading, pq, *, best=False, noise=None) -> "_Problem":
        """Of pixels that are seen, and which of their values a result masks; `best`: of those that fit best alone."""
        dtype = shading.directions.dtype
        values = seen.without(jnp.asarray(stray, jnp.float32)).astype(dtype)
        plain = jnp.where(masked, 0, initial_trust(values, seen.known.astype(dtype)))
        pq = jnp.asarray(pq, dtype)
        found = _at(shading, pq)
        residual = _left(found, values, plain)
        for _ in range(START):  # the weights, too, are to be those of the robust loss
            residual = _left(found, values, plain * biweight(residual, residual_scale(residual, plain > 0)))
        if best:
            kept = np.flatnonzero(np.asarray(fits_best(plain, residual)))
            values, plain, pq, residual = (array[kept] for array in (values, plain, pq, residual))
        scale = residual_scale(residual, plain > 0)
        if noise is None:
            trust = plain * biweight(residual, scale)
            total = float(jnp.sum(trust))
            if total == 0:
                raise ValueError("the result masks every value of the pixels that were drawn: nothing is left to fit")
            noise = max(float(jnp.sum(trust * residual**2)) / total, 1e-8)  # float32 knows no less
        return cls(values, plain, scale, pq, residual, noise)

    def trust(self, residual: Float[Array, "n lights"]) -> Float[Array, "n lights"]:
        """In units of the noise's inverse variance."""
        return self.plain * biweight(residual, self.scale) / self.noise

    def robust(self, residual: Float[Array, "n lights"]) -> float:
        """½ Σ of Tukey's loss over the noise; its square at 0 is that of the weighted residuals."""
        x = jnp.minimum((residual / (CUT * self.scale)) ** 2, 1)
        loss = (CUT * self.scale) ** 2 / 3 * (1 - (1 - x) ** 3)
        return float(jnp.sum(self.plain * loss)) / (2 * self.noise)


class _State(NamedTuple):
    """Where a joint refinement is; `before`: turns and logarithms of gains that lights have made so far."""

    brdf: AbstractBRDF
    y: Array
    pq: Array
    directions: Array
    gains: Array
    before: Array

    @property
    def shading(self) -> Rendered:
        return Rendered(self.brdf, self.directions, jnp.exp(self.gains))

    @classmethod
    def of(cls, coordinates: Coordinates, unknowns: Unknowns, before: Array) -> "_State":
        """Where unknowns have led to."""
        low, high = coordinates.material.bounds
        y = jnp.clip(coordinates.numbers(unknowns), low, high)  # what `InBounds` has left outside
        shading = coordinates.shading(unknowns)
        length = jnp.linalg.norm(shading.directions, axis=1, keepdims=True)
        return cls(
            coordinates.material.at(y), y, within(coordinates.normals(unknowns)),
            shading.directions / length, jnp.log(shading.gains), before + coordinates.turns(unknowns),
        )  # fmt: skip


def _together(problem, found, material, settings, normals, lights, done) -> tuple[_State, dict[str, float]]:
    """All that moves, in rounds; the last state, and the whole loss before and after."""
    still = jnp.zeros((len(found.directions), 3), found.directions.dtype)
    state = _State(found.brdf, material.start, problem.pq, found.directions, still[:, 0], still)
    moves = tuple(
        name for name, there in (("normals", normals), ("brdf", material.start.size > 0), ("lights", lights)) if there
    )
    prior = _Prior.of(problem, found, material, settings)
    state, losses, steps = _rounds(problem, prior, state, material, settings, moves, done)
    figures = {"noise": problem.noise, "loss_start": losses[0], "loss_end": losses[-1], "steps": float(steps)}
    if lights:
        figures["turned"] = float(jnp.degrees(jnp.mean(jnp.linalg.norm(state.before[:, :2], axis=1))))
    return state, figures


class _Prior(NamedTuple):
    """What holds the unknowns: nodes of the chart, shading there and its strength; the root of what holds normals;
    strengths of lights."""

    pq: Array
    start: Array
    materials: Array
    root: Array
    lights: Array
    directions: Array

    @classmethod
    def of(cls, problem, found, material, settings) -> "_Prior":
        """About the start."""
        pq = jnp.asarray(nodes(GRID), found.directions.dtype)
        shading = _at(found, pq)
        trust = problem.trust(problem.residual)
        slopes = slopes_at(material, material.start, found, problem.pq, problem.values, trust)
        amount = jnp.sum(trust) * problem.noise
        materials = STIFFNESS * amount * jnp.mean(slopes.weights**2, axis=0) / (len(pq) * len(found.directions))
        deviations = jnp.asarray([settings.turns, settings.turns, settings.gains], trust.dtype)
        root = settings.stiffness**0.5 * root_of(of_normals(slopes, trust))
        return cls(pq, shading, materials, root, amount / trust.shape[1] / deviations**2, found.directions)


def _follow(observations, stereo, shared, pq, settings, noise, done) -> Float[np.ndarray, "pixels 2"]:
    """Every normal, with all that is shared held."""
    nothing = Material.of(shared.brdf, False)
    still = jnp.zeros((len(shared.directions), 3), shared.directions.dtype)
    found = np.empty_like(pq)
    masked = stereo.outliers | stereo.shadows
    for part, seen in observations.tiles():
        hidden, begin = observations.filled(masked[part]), observations.filled(pq[part])
        problem = _Problem.of(seen, hidden, stereo.stray, shared, begin, noise=noise)
        state = _State(shared.brdf, nothing.start, problem.pq, shared.directions, still[:, 0], still)
        prior = _Prior.of(problem, shared, nothing, settings)
        state, _, _ = _rounds(problem, prior, state, nothing, settings, ("normals",))
        found[part] = np.asarray(state.pq)[: part.stop - part.start]
        done()
    return found


def _rounds(problem, prior, state, material, settings, moves, done=lambda: None) -> tuple[_State, list[float], int]:
    """Rounds while the whole loss falls: the last state, losses before and after each round, and steps of all."""
    losses, steps, residual = [], 0, problem.residual
    for _ in range(settings.rounds):
        moved, left, found = _round(problem, prior, state, residual, material, settings, moves)
        losses.append(found.before)
        steps += int(found.steps)
        done()
        if not found.after < found.before:  # at the optimum, to rounding and to what bounds cut off
            break
        state, residual = moved, left
        losses.append(found.after)
    return state, losses, steps


class _Found(NamedTuple):
    """The whole loss before and after a round, and its steps."""

    before: float
    after: float
    steps: Any


def _round(problem, prior, state, residual, material, settings, moves) -> tuple[_State, Array, _Found]:
    """A round: coordinates about the state and a fit. The new state and its residual."""
    rendered = state.shading
    trust = problem.trust(residual)
    slopes = slopes_at(material, state.y, rendered, state.pq, problem.values, trust)
    metric = of_prior(material, state.y, rendered, prior.pq, prior.materials)
    mix, response = of_numbers(slopes, trust, prior.root if "normals" in moves else None, metric)
    across = jnp.asarray(tangents(np.asarray(state.directions, float)), trust.dtype)
    own = whitening(of_normals(slopes, (1 + settings.stiffness) * trust))
    # Not for nothing: it renders twice, and where nothing is trusted it is infinite.
    lit = "lights" in moves
    scale = of_lights(slopes, trust, rendered, state.pq, across, prior.lights) if lit else jnp.zeros_like(state.before)
    coordinates = Coordinates(
        material, state.y, mix, state.pq, own, response if "normals" in moves else jnp.zeros_like(response),
        state.directions, across, state.gains, scale,
    )  # fmt: skip
    terms = {
        "normals": NearNormals(problem.pq, prior.root, coordinates),
        "brdf": NearMaterial(prior.pq, prior.start, prior.materials, prior.directions, coordinates),
        "lights": NearLights(state.before, prior.lights, coordinates),
    }
    objective = {"photographs": Photometric(problem.values, trust, coordinates)} | {name: terms[name] for name in moves}
    if "brdf" in moves:
        objective["bounds"] = InBounds(coordinates)
    zero = Unknowns(jnp.zeros_like(state.pq), jnp.zeros_like(state.y), jnp.zeros_like(scale))
    fitted = fit(
        zero, objective, settings.solver, max_steps=settings.steps, throw=False,
        trainable=lambda unknowns: tuple(getattr(unknowns, name) for name in moves),
    )  # fmt: skip
    moved = _State.of(coordinates, fitted.model, state.before)
    left = _left(_at(moved.shading, moved.pq), problem.values, trust)
    found = _Found(
        _loss(problem, prior, terms, state, residual), _loss(problem, prior, terms, moved, left), fitted.steps
    )
    return moved, left, found


def _loss(problem, prior, terms, state, residual) -> float:
    """The whole robust loss of a state."""
    near = _near(terms["brdf"], state.brdf) if state.y.size else jnp.zeros(1)
    normals = jnp.einsum("nji,nj->ni", prior.root, state.pq - problem.pq)
    lights = jnp.sqrt(prior.lights)[None] * state.before
    return problem.robust(residual) + float(sum(jnp.sum(part**2) for part in (near, normals, lights))) / 2


@eqx.filter_jit
def _at(shading: Rendered, pq: Float[Array, "n 2"]) -> Float[Array, "n materials lights"]:
    return shading.at(pq)


@eqx.filter_jit
def _near(term: NearMaterial, brdf: AbstractBRDF) -> Float[Array, "nodes materials lights"]:
    return term.of(brdf)


@eqx.filter_jit
def _left(
    shading: Float[Array, "n materials lights"], values: Float[Array, "n lights"], trust: Float[Array, "n lights"]
) -> Float[Array, "n lights"]:
    """What the best weights leave."""
    weights, _ = weigh(shading, values, trust)
    return values - jnp.sum(weights[..., None] * shading, axis=1)


def _under(observations: Observations, state: _State) -> Observations:
    """Under the lights that were found, brighter and turned."""
    given, gains = observations.lights, np.asarray(state.gains - jnp.median(state.gains), float)
    world = observations.geometry.world(np.asarray(state.directions, float), slice(None))
    turned = eqx.tree_at(
        lambda lights: lights.direction,
        brighter(given, np.exp(gains)),
        replace_fn=lambda old: jnp.asarray(world, old.dtype),
    )
    return Observations(replace(observations.photographs, lights=turned))


def _check(stereo: Stereo, photographs: Photographs, *moves: Any) -> None:
    shape = photographs.mask.shape
    if stereo.mask.shape != shape or not np.array_equal(stereo.mask, photographs.mask):
        raise ValueError(f"the photographs have another mask, {shape} of {photographs.pixels} pixels, than the result")
    if stereo.outliers.shape != (photographs.pixels, photographs.count):
        raise ValueError(f"the result is of {stereo.outliers.shape[1]} photographs, got {photographs.count}")
    if not any(move is not False for move in moves):
        raise ValueError("nothing is to be refined: normals, brdf and lights are all held")
