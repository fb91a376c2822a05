"""Levenberg-Marquardt for many more residuals than unknowns: the default solver of `fit`."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import cho_factor, cho_solve

from hshjax._typing import Array, Bool, Float, Int
from hshjax.fitting._bounds import pushed_out
from hshjax.fitting._optimistix import half_square

STOPS = 4
"""Times that a step is taken anew by what no bound has stopped; what is stopped later is cut off."""


class _State(eqx.Module):
    """What is known at the current y, and the trial point that it led to."""

    trial: Float[Array, " unknowns"]
    loss: Float[Array, ""]
    gram: Float[Array, "unknowns unknowns"]
    gradient: Float[Array, " unknowns"]
    predicted: Float[Array, ""]
    damping: Float[Array, ""]
    growth: Float[Array, ""]
    size: Float[Array, ""]
    count: Int[Array, ""]
    done: Bool[Array, ""]
    aux: Any


class LevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt that keeps JᵀJ and Jᵀr of its residuals, and nothing of their number.

    A step solves (JᵀJ + λ diag JᵀJ) δ = Jᵀr by Cholesky; λ follows the ratio of the reduction to the predicted one,
    down by at most 10 a step. Steps do not depend on the scale of the residuals or of a parameter; where they end does,
    through `atol`. With far more residuals than unknowns it takes a fraction of the time of
    `optimistix.LevenbergMarquardt`, above all under vmap. JᵀJ has the squared condition number of J; where it tells
    nothing more, damping keeps the steps small, and y ends where Jᵀr vanishes in any case. A step holds the Jacobian,
    residuals x unknowns.

    - `rtol`, `atol`: it has converged when a step is below atol + rtol |y| (largest element) and changes the loss by at
      most atol + rtol loss; or when the loss is flat to rounding and steps do not become smaller any more.
    - `damping`: the first λ.

    Given `options={"lower": ..., "upper": ...}`, of the structure of y, it keeps y between them. An unknown on a bound
    that the loss pushes against stays there; one that a step would take beyond is stopped at the bound, and the step is
    taken anew by the rest, so that an optimum on a bound is approached as fast as one inside.

    Source: Madsen, Nielsen, Tingleff, Methods for Non-Linear Least Squares Problems, 2nd ed., IMM, DTU, 2004, section
    3.2, with Marquardt's scaling by the diagonal, SIAM J. Appl. Math. 11, 1963. Bounds: as the projected method of
    Kanzow, Yamashita, Fukushima, J. Comput. Appl. Math. 172, 2004, but solved for the free unknowns.
    """

    rtol: float
    atol: float
    damping: float = 1e-3
    norm: Callable[[Any], Array] = eqx.field(static=True, default=optx.max_norm)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        flat, _ = ravel_pytree(y)
        number = jnp.zeros((), flat.dtype)
        return _State(
            trial=flat,
            loss=number + jnp.inf,
            gram=jnp.zeros((flat.size, flat.size), flat.dtype),
            gradient=jnp.zeros_like(flat),
            predicted=number + 1,
            damping=number + self.damping,
            growth=number + 2,
            size=number + jnp.inf,
            count=jnp.asarray(0),
            done=jnp.asarray(False),
            aux=jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), aux_struct),
        )

    def step(self, fn, y, args, options, state, tags):
        flat, unravel = ravel_pytree(y)
        residual, pushforward, aux = jax.linearize(lambda x: fn(unravel(x), args), state.trial, has_aux=True)
        rows = jax.vmap(pushforward)(jnp.eye(flat.size, dtype=flat.dtype))
        # Behind a barrier, or XLA fuses the flattening of `_normal_equations` into what computes the rows, and divides
        # integers at every element: three times the time of a step in a batch.
        residual, rows = jax.lax.optimization_barrier((residual, rows))
        loss = half_square(residual).astype(flat.dtype)
        gram, gradient = _normal_equations(residual, rows)

        first = state.count == 0
        better = first | (loss <= state.loss)
        # A step that was stopped at bounds may promise nothing; so does one from an optimum.
        promising = state.predicted > 0
        gain = jnp.where(promising, (state.loss - loss) / jnp.where(promising, state.predicted, 1), 0)
        size = self.norm(state.trial - flat)
        small = size <= self.atol + self.rtol * self.norm(flat)
        change = jnp.abs(state.loss - loss)
        level = change <= self.atol + self.rtol * state.loss
        # The loss is flat to rounding, and steps do not become smaller: they are rounding themselves.
        lost = (change <= 4 * jnp.finfo(flat.dtype).eps * state.loss) & (size > state.size / 2)
        # From a start without a finite loss no step leads anywhere.
        done = jnp.where(first, ~jnp.isfinite(loss), (small & level) | lost)

        def newer(new, old):
            return jax.tree.map(lambda new, old: jnp.where(better, new, old), new, old)

        point = newer(state.trial, flat)
        gram, gradient = newer(gram.astype(flat.dtype), state.gram), newer(gradient.astype(flat.dtype), state.gradient)
        shrink = jnp.clip(1 - (2 * gain - 1) ** 3, 0.1, 1)
        damping = jnp.where(first, state.damping, state.damping * jnp.where(better, shrink, state.growth))
        damping = jnp.maximum(damping, jnp.finfo(flat.dtype).eps)  # from 0 no growth would lead back
        trial, predicted = _damped_step(point, gram, gradient, damping, _room(options))
        after = _State(
            trial=trial,
            loss=newer(loss, state.loss),
            gram=gram,
            gradient=gradient,
            predicted=predicted,
            damping=damping,
            growth=jnp.where(better, 2, 2 * state.growth),
            size=jnp.where(first, jnp.inf, size),
            count=state.count + 1,
            done=done,
            aux=newer(aux, state.aux),
        )
        started_from = jax.tree.map(lambda new, old: jnp.where(first, new, old), aux, state.aux)
        return unravel(point), after, started_from

    def terminate(self, fn, y, args, options, state, tags):
        finite = (state.count == 0) | jnp.isfinite(state.loss)
        return state.done, optx.RESULTS.where(finite, optx.RESULTS.successful, optx.RESULTS.nonfinite)

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        return y, state.aux, {}


def _normal_equations(residual: Any, rows: Any) -> tuple[Array, Array]:
    """JᵀJ and Jᵀr of pytrees: residuals `(...)`, derivatives `(unknowns, ...)`."""
    grams, gradients = [], []
    for r, j in zip(jax.tree.leaves(residual), jax.tree.leaves(rows), strict=True):
        j = j.reshape(j.shape[0], -1)
        grams.append(jnp.matmul(j, j.T, precision="highest"))
        gradients.append(jnp.matmul(j, r.reshape(-1), precision="highest"))
    return jnp.stack(grams).sum(axis=0), jnp.stack(gradients).sum(axis=0)


def _room(options: dict[str, Any]) -> tuple[Array, Array] | None:
    """The bounds as flat arrays, None without any."""
    if "lower" not in options:
        return None
    lower, upper = (ravel_pytree(options[side])[0] for side in ("lower", "upper"))
    return lower, upper


def _damped_step(
    point: Array, gram: Array, gradient: Array, damping: Array, bounds: tuple[Array, Array] | None
) -> tuple[Array, Array]:
    """Where the damped step from `point` leads, and the reduction of ½|r|² that the linearisation promises for it."""
    diagonal = jnp.diagonal(gram)
    # An unknown without effect has a row of zeros: a little of the largest one on its diagonal keeps it where it is.
    floor = jnp.finfo(gram.dtype).eps * jnp.max(diagonal) + jnp.finfo(gram.dtype).tiny
    scale = damping * jnp.maximum(diagonal, floor)
    matrix = gram + jnp.diag(scale)
    if bounds is None:
        move = cho_solve(cho_factor(matrix), gradient)
        return point - move, jnp.sum(move * (scale * move + gradient)) / 2
    lower, upper = bounds
    least, most = point - upper, point - lower

    def again(state):
        """The step of what is free, what is stopped held at `held` (0 elsewhere); stops what would leave."""
        stopped, held, _, _, count = state
        free = ~stopped
        reduced = jnp.where(free[:, None] & free[None, :], matrix, jnp.diag(jnp.diagonal(matrix)))
        right = jnp.where(free, gradient - jnp.matmul(matrix, held, precision="highest"), 0)
        move = held + cho_solve(cho_factor(reduced), right)
        beyond = free & ((move < least) | (move > most))
        return stopped | beyond, jnp.where(beyond, jnp.clip(move, least, most), held), move, jnp.any(beyond), count + 1

    still = jnp.zeros_like(point)
    begin = (pushed_out(point, gradient, lower, upper), still, still, jnp.asarray(True), jnp.asarray(0))
    move = jax.lax.while_loop(lambda state: state[3] & (state[4] < STOPS), again, begin)[2]
    move = jnp.clip(move, least, most)
    # Exactly on the bound, where rounding would leave it beside.
    trial = jnp.where(move >= most, lower, jnp.where(move <= least, upper, point - move))
    return trial, jnp.sum(move * (gradient - jnp.matmul(gram, move, precision="highest") / 2))
