"""Fits from many starts: a few steps from all of them, then the best to its end."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax.fitting._bounds import declared, path_name
from hshjax.fitting._fit import Solver, check_bounds, check_end, checked, chosen, default_solver, fit
from hshjax.fitting._outcome import Outcome
from hshjax.fitting._result import Model, MultiStart
from hshjax.fitting._terms import AbstractTerm


def multi_start(
    starts: Model,
    objective: Mapping[str, AbstractTerm],
    solver: Solver | None = None,
    *,
    trainable: Any = None,
    screening_steps: int = 8,
    max_steps: int = 256,
    throw: bool = True,
) -> MultiStart[Model]:
    """`fit` from every start for `screening_steps`, and from where the best of them then is to convergence.

    **Arguments:**

    - `starts`: a model with a leading axis of starts on every floating array: from `initial_guesses`, or stacked by
      `jax.tree.map(lambda *leaves: jnp.stack(leaves), *models)`.
    - `objective`, `trainable`: as for `fit`.
    - `solver`: as for `fit`; by default `LevenbergMarquardt`, with the tolerances of the default of `fit`.
    - `screening_steps`: steps from every start, at least 1.
    - `max_steps`: limit of steps of the best one after that, at least 1.
    - `throw`: raise where the best one did not converge.

    A start that is or becomes infinite or NaN, in its loss or a parameter, is never chosen unless all are such.

    Runs under jit, and under vmap over a batch of materials: pass `throw=False` there, and look at `best.result`.

    **Raises:** ValueError as `fit` does, and for starts without a leading axis or of different numbers. RuntimeError
    for a best fit that did not converge, unless `throw` is False.
    """
    mask = chosen(starts, trainable)
    _check_starts(starts)
    free = eqx.filter(starts, mask)
    check_bounds(jax.tree.leaves(free), declared(free))
    if min(screening_steps, max_steps) < 1:
        raise ValueError(f"screening_steps and max_steps must be at least 1, got {screening_steps} and {max_steps}")
    solver = default_solver(free) if solver is None else solver
    found = _run(starts, checked(objective, solver), solver, mask, screening_steps, max_steps)
    return eqx.tree_at(lambda found: found.best, found, check_end(found.best)) if throw else found


@eqx.filter_jit
def _run(
    starts: Model,
    objective: dict[str, AbstractTerm],
    solver: Solver,
    trainable: Any,
    screening_steps: int,
    max_steps: int,
) -> MultiStart[Model]:
    def screen(start):
        return fit(start, objective, solver, trainable=trainable, max_steps=screening_steps, throw=False)

    arrays, rest = eqx.partition(starts, eqx.is_inexact_array)
    screened = eqx.filter_vmap(lambda part: screen(eqx.combine(part, rest)))(arrays)
    losses = jax.vmap(lambda found: found.loss)(screened)
    lost = (screened.result == Outcome.nonfinite_start) | (screened.result == Outcome.nonfinite)
    leader = jnp.argmin(jnp.where(lost, jnp.inf, losses))
    ahead = jax.tree.map(lambda leaf: leaf[leader] if eqx.is_inexact_array(leaf) else leaf, screened.model)
    best = fit(ahead, objective, solver, trainable=trainable, max_steps=max_steps, throw=False)
    here = jnp.arange(losses.size) == leader
    return MultiStart(
        best=best,
        chosen=leader,
        losses=jnp.where(here, best.loss, losses),
        results=jax.vmap(lambda here, screened: Outcome.where(here, best.result, screened))(here, screened.result),
        start_losses=sum(screened.start_losses.values(), start=jnp.zeros_like(losses)),
        steps=screened.steps + jnp.where(here, best.steps, 0),
    )


def _check_starts(starts: Any) -> None:
    """ValueError unless all floating arrays have a first axis of one length."""
    sizes = {}
    for path, leaf in jax.tree_util.tree_leaves_with_path(eqx.filter(starts, eqx.is_inexact_array)):
        name = path_name(path)
        if leaf.ndim == 0:
            raise ValueError(f"starts need a leading axis on every floating array, but {name} is a scalar")
        sizes[name] = leaf.shape[0]
    if len(set(sizes.values())) > 1:
        raise ValueError(f"starts disagree in their number, the length of the leading axis: {sizes}")
    if 0 in sizes.values():
        raise ValueError("there is no start: the leading axis has length 0")
