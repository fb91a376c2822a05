"""jaxopt's solvers for `fit`: what they have beyond optimistix is boxes, projections and proximal steps."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from hshjax._typing import Array
from hshjax.fitting._outcome import Outcome

OF_RESIDUALS = ("LevenbergMarquardt", "GaussNewton")
OF_BOXES = ("LBFGSB", "ProjectedGradient", "ProximalGradient")


class Jaxopt(eqx.Module):
    """A jaxopt solver by its class and the arguments of it: `Jaxopt(jaxopt.LBFGSB, tol=1e-8)`.

    - Solvers of a smooth function (`LBFGS`, `BFGS`, `NonlinearCG`, `GradientDescent`) and of residuals
      (`LevenbergMarquardt`, `GaussNewton`): bounded parameters are transformed, as for optimistix.
    - `LBFGSB`, `ProjectedGradient`, `ProximalGradient` move the parameters themselves, and keep the boxes that their
      fields declare. `ProximalGradient` also takes `Sparsity`.

    A solver has converged when its own measure of error is at most its `tol` (1e-3 unless given). `max_steps` of `fit`
    limits its steps.

    **Raises:** ValueError for `maxiter`.

    jaxopt 0.8.5 is the last release of a library that is no longer developed; hshjax pins it.
    """

    make: Callable[..., Any] = eqx.field(static=True)
    options: tuple[tuple[str, Any], ...] = eqx.field(static=True)

    def __init__(self, make: Callable[..., Any], **options: Any):
        if "maxiter" in options:
            raise ValueError("the limit of steps is an argument of `fit`: max_steps, not maxiter")
        self.make = make
        self.options = tuple(sorted(options.items()))

    @property
    def keeps_boxes(self) -> bool:
        """Whether the solver moves the parameters themselves, within their boxes."""
        return self.make.__name__ in OF_BOXES

    @property
    def takes_sparsity(self) -> bool:
        """Whether the solver has a proximal step for an L1 norm."""
        return self.make.__name__ == "ProximalGradient"

    def solve(
        self,
        residuals: Callable[[Any, Any], Any],
        start: Any,
        args: Any,
        box: tuple[Any, Any],
        sparsity: Array,
        max_steps: int,
        visit: Callable[[Array, Array], None],
    ) -> tuple[Any, Array, Outcome, Array]:
        """Minimise ½|residuals(y, args)|² + sparsity Σ|y| over the pytree y in its box.

        **Returns:** y, steps, outcome, and the loss that each of `max_steps` steps started from, 0 beyond.
        """
        from jaxopt import implicit_diff

        first, unravel = ravel_pytree(start)
        arrays, rest = eqx.partition(args, eqx.is_array)  # custom_root takes arrays only
        lower, upper = (ravel_pytree(side)[0] for side in box)

        def flat_residuals(y, *args):
            return ravel_pytree(residuals(unravel(y), eqx.combine(args[-1], rest)))[0]

        def loss(y, *args):
            return jnp.sum(flat_residuals(y, *args) ** 2) / 2

        function = flat_residuals if self.make.__name__ in OF_RESIDUALS else loss
        extra, hyper = (), ()
        if self.make.__name__ == "LBFGSB":
            hyper = ((lower, upper),)
        elif self.make.__name__ == "ProjectedGradient":
            extra, hyper = (_clip,), ((lower, upper),)
        elif self.takes_sparsity:
            extra, hyper = (_shrink_and_clip,), ((sparsity.astype(first.dtype), lower, upper),)
        solver = self.make(function, *extra, maxiter=max_steps, **dict(self.options))

        def total(y, *arguments):
            # From the arguments, not the closure: custom_root differentiates by nothing else.
            return loss(y, *arguments) + (arguments[0][0] * jnp.sum(jnp.abs(y)) if self.takes_sparsity else 0)

        def run(y, *arguments):
            def step(carry):
                y, state, curve, k = carry
                value = total(y, *arguments)
                visit(k, value)
                y, state = solver.update(y, state, *arguments)
                return y, state, curve.at[k].set(value), k + 1

            def go_on(carry):
                _, state, _, k = carry
                return (k < max_steps) & (state.error > solver.tol)

            curve = jnp.zeros(max_steps, y.dtype)
            # Once by hand: states settle in their dtypes with the first update.
            carry = step((y, solver.init_state(y, *arguments), curve, jnp.asarray(0)))
            y, state, curve, k = jax.lax.while_loop(go_on, step, carry)
            return y, (state.error <= solver.tol, curve, k)

        rule = implicit_diff.custom_root(solver.optimality_fun, has_aux=True, solve=solver.implicit_diff_solve)
        with jax.numpy_dtype_promotion("standard"):  # LevenbergMarquardt mixes dtypes
            y, (converged, curve, steps) = rule(run)(first, *hyper, arrays)
        return unravel(y), steps, Outcome.where(converged, Outcome.converged, Outcome.step_limit), curve


def _clip(y, box):
    return jnp.clip(y, *box)


def _shrink_and_clip(y, hyper, scaling=1.0):
    """Proximal step of weight |y| within a box: in one dimension, the projection of the step without the box."""
    weight, lower, upper = hyper
    shrunk = jnp.sign(y) * jnp.maximum(jnp.abs(y) - weight * scaling, 0)
    return jnp.clip(shrunk, lower, upper)
