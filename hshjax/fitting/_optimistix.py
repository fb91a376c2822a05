"""optimistix's solvers for `fit`: with the loss of every step kept, and an outcome that says what to do."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx

from hshjax._typing import Array
from hshjax.fitting._outcome import Outcome

ADJOINT = optx.ImplicitAdjoint(linear_solver=lx.AutoLinearSolver(well_posed=False))
"""A parameter without effect makes the Hessian singular: its derivative is 0, by the pseudoinverse."""


def solve_optimistix(
    solver: optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser,
    residuals: Callable[[Any, Any], Any],
    start: Any,
    args: Any,
    max_steps: int,
    visit: Callable[[Array, Array], None],
    options: dict[str, Any],
) -> tuple[Any, Array, Outcome, Array]:
    """Minimise ½|residuals(y, args)|² over the pytree y; `options` are the solver's. No derivative: see `implicit`.

    **Returns:** y, steps, outcome, and the loss that each of `max_steps` steps started from, 0 beyond.
    """

    def with_loss(y, args):
        found = residuals(y, args)
        return found, half_square(found)

    kind = _RecordedMinimiser if isinstance(solver, optx.AbstractMinimiser) else _RecordedLeastSquares
    recorded = kind(solver.rtol, solver.atol, solver.norm, solver, max_steps, visit)
    found = optx.least_squares(
        with_loss, recorded, start, args, options, has_aux=True, max_steps=max_steps, throw=False
    )
    outcome = Outcome.stalled
    for theirs, ours in (
        (optx.RESULTS.successful, Outcome.converged),
        (optx.RESULTS.nonlinear_max_steps_reached, Outcome.step_limit),
        (optx.RESULTS.nonfinite, Outcome.nonfinite),
    ):
        outcome = Outcome.where(found.result == theirs, ours, outcome)
    return found.value, found.stats["num_steps"], outcome, found.stats["curve"]


def implicit(residuals: Callable[[Any, Any], Any], optimum: Any, args: Any) -> Any:
    """`optimum`, the minimum of ½|residuals(y, args)|² over y, as a function of `args`."""
    return optx.least_squares(residuals, _Settled(), optimum, args, throw=False, adjoint=ADJOINT).value


def constant(tree: Any) -> Any:
    """The same numbers without derivatives."""
    return jax.tree.map(lambda leaf: jax.lax.stop_gradient(leaf) if eqx.is_inexact_array(leaf) else leaf, tree)


def half_square(residual: Any) -> Array:
    """½ Σ r² over a pytree of arrays."""
    return jnp.stack([jnp.sum(r * r) for r in jax.tree.leaves(residual)]).sum() / 2


class _Recorded(eqx.Module):
    """`solver`, whose state also holds the loss that each of at most `length` steps started from.

    The problem's auxiliary output must be its loss.
    """

    rtol: float
    atol: float
    norm: Callable[[Any], Array]
    solver: Any
    length: int = eqx.field(static=True)
    visit: Callable[[Array, Array], None] = eqx.field(static=True)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        inner = self.solver.init(fn, y, args, options, f_struct, aux_struct, tags)
        return inner, jnp.zeros(self.length, aux_struct.dtype), jnp.asarray(0)

    def step(self, fn, y, args, options, state, tags):
        inner, curve, count = state
        y, inner, loss = self.solver.step(fn, y, args, options, inner, tags)
        self.visit(count, loss)
        return y, (inner, curve.at[count].set(loss), count + 1), loss

    def terminate(self, fn, y, args, options, state, tags):
        return self.solver.terminate(fn, y, args, options, state[0], tags)

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        y, aux, stats = self.solver.postprocess(fn, y, aux, args, options, state[0], tags, result)
        return y, aux, stats | {"curve": state[1]}


class _RecordedLeastSquares(_Recorded, optx.AbstractLeastSquaresSolver):
    pass


class _RecordedMinimiser(_Recorded, optx.AbstractMinimiser):
    pass


class _Settled(optx.AbstractLeastSquaresSolver):
    """Ends where it starts."""

    rtol: float = 0.0
    atol: float = 0.0
    norm: Callable[[Any], Array] = eqx.field(static=True, default=optx.max_norm)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        return None

    def step(self, fn, y, args, options, state, tags):
        return y, None, None

    def terminate(self, fn, y, args, options, state, tags):
        return jnp.asarray(True), optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        return y, None, {}
