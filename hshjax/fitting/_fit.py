"""The gradient-based fit: any differentiable model, any sum of residual terms, any solver."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.core import Tracer

from hshjax._typing import Array
from hshjax.fitting._bounds import Box, declared, nan_outside, on_bound, outside, pushed_out, to_free
from hshjax.fitting._jaxopt import Jaxopt
from hshjax.fitting._levenberg_marquardt import LevenbergMarquardt
from hshjax.fitting._loss import Loss
from hshjax.fitting._one_by_one import one_by_one
from hshjax.fitting._optimistix import constant, implicit, solve_optimistix
from hshjax.fitting._outcome import Outcome
from hshjax.fitting._result import IterativeFit, Model
from hshjax.fitting._terms import AbstractTerm, l1_weight

Solver = optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser | Jaxopt


def fit(
    model: Model,
    objective: Mapping[str, AbstractTerm],
    solver: Solver | None = None,
    *,
    trainable: Any = None,
    max_steps: int = 256,
    throw: bool = True,
    on_step: Callable[[Array, Array], None] | None = None,
) -> IterativeFit[Model]:
    """The model that minimises ½ Σ |term(model)|², from the given one on.

    **Arguments:**

    - `model`: any Module or pytree of them: a BRDF, lights, normals, a scene. Its values are the start.
    - `objective`: terms by name, weighted by `*`: `{"data": SampleMisfit(samples), "swap": 10.0 * Reciprocity(rule)}`.
      The same mapping belongs in a `SampleMisfit` and in the `initial_guesses` for it.
    - `solver`: a least-squares solver or minimiser of optimistix (`OptaxMinimiser` wraps optax), or `Jaxopt`. By
      default `LevenbergMarquardt` with relative tolerances of 1e-8 in float64, 1e-4 in float32. More unknowns than some
      thousands (normals of an image, say) ask for a solver without a Jacobian: `optimistix.LBFGS`, `Jaxopt`.
    - `trainable`: what is fitted: None for every floating array, a function that picks parts,
      `lambda scene: (scene.brdf.slope, scene.lights)`, or a pytree of booleans. The rest is held.
    - `max_steps`: limit of steps, at least 1.
    - `throw`: raise where the fit did not converge; otherwise `result` says how it ended.
    - `on_step`: called from the running fit as `on_step(step, loss)`, for a display. Not under vmap. A part of the
      compiled program: use one function again and again, for another one compiles anew.

    Fields declared by `bounded` stay in their box: by the solver, if it keeps boxes (the default one does, and some of
    `Jaxopt`), else by a smooth transformation. On a bound that has no slope: a start nearer to it than 1e-5 of the box
    (1e-5 itself, where the other end is infinite) is then moved inside by that much.

    Runs under jit and vmap, on a CPU one fit after another, but for `Jaxopt`. Pass `throw=False` there and look at
    `result`, or one fit that does not converge ends them all. The fitted model is differentiable in what is held (data,
    weights, parts that are not trainable) by the implicit function theorem at the optimum, not in the start.

    **Raises:** ValueError for an objective that is no mapping of terms, a term that is not of floating arrays or that
    the solver cannot take, nothing trainable, a parameter outside its bounds. RuntimeError for a fit that did not
    converge, unless `throw` is False.
    """
    free, held = eqx.partition(model, chosen(model, trainable))
    boxes = tuple(declared(free))
    if max_steps < 1:
        raise ValueError(f"max_steps must be at least 1, got {max_steps}")
    leaves = jax.tree.leaves(free)
    _check_finite(leaves, boxes)
    check_bounds(leaves, boxes)
    solver = default_solver(free) if solver is None else solver
    found = _run(free, held, checked(objective, solver), solver, boxes, max_steps, on_step)
    return check_end(found) if throw else found


def default_tolerance(free: Any) -> float:
    """Of the default solvers, for the dtype of what is trainable."""
    return 1e-8 if all(leaf.dtype == jnp.float64 for leaf in jax.tree.leaves(free)) else 1e-4


def default_solver(free: Any) -> LevenbergMarquardt:
    """For the dtype of what is trainable; nearly without absolute tolerance, which would depend on units."""
    return LevenbergMarquardt(rtol=default_tolerance(free), atol=default_tolerance(free) ** 2)


def chosen(model: Any, trainable: Any) -> Any:
    """The model's tree with True at every floating array that is to be fitted; ValueError where that is none."""
    floating = jax.tree.map(eqx.is_inexact_array, model)
    mask = floating if trainable is None else _masked(floating, trainable)
    if not any(jax.tree.leaves(mask)):
        raise ValueError("nothing is trainable: the model has no floating array, or `trainable` chose none")
    return mask


def _masked(floating: Any, trainable: Any) -> Any:
    """Of the floating arrays those that `trainable` picks, a function or a tree of booleans."""
    if callable(trainable) and not isinstance(trainable, eqx.Module):  # a mask of a BRDF can be called, too
        nothing = jax.tree.map(lambda _: False, floating)
        trainable = eqx.tree_at(trainable, nothing, replace_fn=lambda part: jax.tree.map(lambda _: True, part))

    def below(wanted, part):
        return jax.tree.map(lambda leaf: leaf and bool(wanted), part)

    return jax.tree.map(below, trainable, floating)


def keeps_boxes(solver: Solver) -> bool:
    """Whether a solver moves bounded parameters themselves, and keeps them in their boxes."""
    return isinstance(solver, LevenbergMarquardt) or (isinstance(solver, Jaxopt) and solver.keeps_boxes)


@eqx.filter_jit
def _run(
    free: Any,
    held: Any,
    terms: dict[str, AbstractTerm],
    solver: Solver,
    boxes: tuple[Box, ...],
    max_steps: int,
    on_step: Callable[[Array, Array], None] | None,
) -> IterativeFit:
    leaves, structure = jax.tree.flatten(free)
    loss = Loss(terms, held, structure)
    unbounded = tuple(Box(box.name, -math.inf, math.inf) for box in boxes)
    chart = unbounded if keeps_boxes(solver) else boxes
    leaves = [nan_outside(leaf, box) for leaf, box in zip(leaves, boxes, strict=True)]
    start = [to_free(leaf, box) for leaf, box in zip(leaves, chart, strict=True)]
    _, start_losses = loss.parts(start, chart)
    low = [jnp.full_like(leaf, box.low) for leaf, box in zip(leaves, boxes, strict=True)]
    high = [jnp.full_like(leaf, box.high) for leaf, box in zip(leaves, boxes, strict=True)]

    def residuals(chart, y, loss):
        return loss.residuals(y, chart)

    def visit(step, loss):
        if on_step is not None:
            jax.debug.callback(on_step, step, loss)

    def by_optimistix(parts):
        solver, start, loss, options = parts
        return solve_optimistix(solver, partial(residuals, chart), start, loss, max_steps, visit, options)

    if isinstance(solver, Jaxopt):
        l1 = sum(loss.sparse.values(), start=jnp.zeros((), start[0].dtype))
        y, steps, outcome, curve = solver.solve(
            partial(residuals, chart), start, loss, (low, high), l1, max_steps, visit
        )
        x = loss.parameters(y, chart)
    else:
        options = {"lower": low, "upper": high} if chart != boxes else {}
        y, steps, outcome, curve = one_by_one(by_optimistix, (solver, start, loss, options))
        found = loss.parameters(y, chart)
        # On a bound the gradient by a parameter need not vanish, but that by its free number does: there the implicit
        # function theorem holds. The values stay as they were found, to the last digit.
        if chart != boxes:
            y = [to_free(leaf, box, inside=0.0) for leaf, box in zip(found, boxes, strict=True)]
        y = implicit(partial(residuals, boxes), constant(y), loss)
        x = [constant(a) + (b - constant(b)) for a, b in zip(found, loss.parameters(y, boxes), strict=True)]

    if keeps_boxes(solver):
        gradient, end = jax.grad(loss.parts, has_aux=True)(x, unbounded)
        gradient = [
            jnp.where(pushed_out(a, g, least, most), 0, g)
            for a, g, least, most in zip(x, gradient, low, high, strict=True)
        ]
    else:
        gradient, end = jax.grad(loss.parts, has_aux=True)(y, chart)
    curve = jnp.where(jnp.arange(max_steps + 1) < steps, jnp.append(curve, 0), jnp.stack(list(end.values())).sum())
    outcome = Outcome.where(_finite(end, x), outcome, Outcome.nonfinite)
    outcome = Outcome.where(_finite(start_losses, start), outcome, Outcome.nonfinite_start)
    return IterativeFit(
        model=loss.model(x),
        result=outcome,
        steps=steps,
        losses=end,
        start_losses=start_losses,
        curve=curve,
        gradient_norm=jnp.max(jnp.stack([jnp.max(jnp.abs(part), initial=0) for part in gradient])),
        on_bound={box.name: on_bound(leaf, box) for leaf, box in zip(x, boxes, strict=True) if box.bounded},
    )


def _finite(losses: dict[str, Array], y: list[Array]) -> Array:
    """Whether all are: a model may well have a finite loss where a parameter is NaN, as a lobe that masks its tail."""
    return jnp.isfinite(sum(losses.values())) & jnp.stack([jnp.all(jnp.isfinite(u)) for u in y]).all()


def checked(objective: Mapping[str, AbstractTerm], solver: Solver) -> dict[str, AbstractTerm]:
    """The objective as a dictionary; ValueError for one that is no mapping of terms that the solver can take."""
    if not isinstance(objective, Mapping) or not objective:
        raise ValueError(f'objective must map names to terms, {{"data": SampleMisfit(samples)}}, got {objective!r}')
    for name, term in objective.items():
        if not isinstance(term, AbstractTerm):
            raise ValueError(f"the term {name!r} must be a term such as SampleMisfit, got {type(term).__name__}")
        if l1_weight(term) is not None and not (isinstance(solver, Jaxopt) and solver.takes_sparsity):
            raise ValueError(
                f"the term {name!r} is an L1 norm, which has no gradient at 0: fit it with "
                f"Jaxopt(jaxopt.ProximalGradient), not with {type(solver).__name__}"
            )
    if all(l1_weight(term) is not None for term in objective.values()):
        raise ValueError("the objective needs a term beside Sparsity")
    return dict(objective)


def _check_finite(leaves: list[Array], boxes: Sequence[Box]) -> None:
    """ValueError for a start that is not finite, where values can be seen."""
    for leaf, box in zip(leaves, boxes, strict=True):
        if not isinstance(leaf, Tracer) and not np.all(np.isfinite(leaf)):
            raise ValueError(f"the start of {box.name or 'the model'} is not finite: {np.asarray(leaf)}")


def check_bounds(leaves: list[Array], boxes: Sequence[Box]) -> None:
    """ValueError for a start outside its box, where values can be seen; NaN is in none and passes."""
    for leaf, box in zip(leaves, boxes, strict=True):
        if not isinstance(leaf, Tracer) and np.any(outside(value := np.asarray(leaf), box)):
            raise ValueError(f"the start of {box.name} lies outside its bounds [{box.low:g}, {box.high:g}]: {value}")


def check_end(found: IterativeFit) -> IterativeFit:
    """RuntimeError for a fit that did not converge; inside jit at run time."""
    failed = found.result != Outcome.converged
    if isinstance(failed, Tracer):
        return found.result.error_if(found, failed)
    if failed:
        losses = ", ".join(f"{name} {float(loss):.3g}" for name, loss in found.losses.items())
        start = ", ".join(f"{name} {float(loss):.3g}" for name, loss in found.start_losses.items())
        raise RuntimeError(
            f"fit: {found.message}. Steps: {int(found.steps)}; losses at the start: {start}; at the end: {losses}. "
            "With throw=False the fit is returned as it is."
        )
    return found
