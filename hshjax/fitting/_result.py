"""What a fit returns."""

from typing import Generic, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float, Int
from hshjax.fitting._certificate import Certificate
from hshjax.fitting._outcome import Outcome
from hshjax.metrics import ReciprocityError

Model = TypeVar("Model")


class Fit(eqx.Module, Generic[Model]):
    """A fitted model and what can be said about the fit.

    - `model`: the fitted BRDF.
    - `norm`: name of the norm (see `NORMS`) in which the two figures that follow are meant.
    - `residual`: root of Σ w |ρ - ρ̂|² in that norm, per channel. - `relative`: the same over the root of Σ w |ρ|².
    - `condition`: estimate of the condition number of the weighted design matrix; 1 where inner products were enough.
    - `method`: "inner products" or "QR"; of `to_series`, which rule. - `samples`: how many have a weight.
      `unknowns`: how many were solved for.
    - `reciprocity_before`: violation in the data, over the pairs of samples that are each other's swap (`pairs` may be
      0). `reciprocity_after`: that of the model, over the directions of the data. None where they were not asked for.
    - `covariance`: `(modes, modes)`, to be multiplied by `noise`, the estimated variance per channel of a sample of
      weight 1 (of the series that is fitted: of z_i z_o ρ in norm D): the posterior of the coefficients for Gaussian
      noise. None where it was not asked for. Constraints do not enter it.
    - `certificate`: what was found of the physical validity of the fit. None where no constraint was asked for.
    - `result`: how the fit ended, an `Outcome`.
    - `quadrature_error`: how far the coefficients moved, relative to their norm, when the rule was refined last; or how
      far they are from those of another rule, if that is more. None where samples were given: `project` knows nothing
      between them.
    """

    model: Model
    residual: Float[Array, " channels"]
    relative: Float[Array, " channels"]
    condition: Float[Array, ""]
    norm: str = eqx.field(static=True)
    method: str = eqx.field(static=True)
    samples: int = eqx.field(static=True)
    unknowns: int = eqx.field(static=True)
    reciprocity_before: ReciprocityError | None = None
    reciprocity_after: ReciprocityError | None = None
    covariance: Float[Array, "modes modes"] | None = None
    noise: Float[Array, " channels"] | None = None
    certificate: Certificate | None = None
    result: Outcome = eqx.field(default_factory=lambda: Outcome.converged)
    quadrature_error: float | None = None


class IterativeFit(eqx.Module, Generic[Model]):
    """A model fitted by `fit`, and how it went. Losses are ½|r|² of a term, times its weight.

    - `model`: the fitted model. - `result`: how the fit ended, `message` in words. - `steps`: how many were taken.
    - `losses`, `start_losses`: by the name of the term, at the end and at the start.
    - `curve`: `(max_steps + 1,)`, the whole loss at the start and after every step; beyond the last one it stays.
    - `gradient_norm`: largest derivative of the smooth part of the loss by a parameter that its bound does not hold (by
      the free number of a bounded parameter, where the solver moves those): 0 at an optimum, but with `Sparsity`.
    - `on_bound`: by the name of a bounded field, where it has ended on a bound.
    """

    model: Model
    result: Outcome
    steps: Int[Array, ""]
    losses: dict[str, Float[Array, ""]]
    start_losses: dict[str, Float[Array, ""]]
    curve: Float[Array, " points"]
    gradient_norm: Float[Array, ""]
    on_bound: dict[str, Bool[Array, "..."]]

    @property
    def loss(self) -> Float[Array, ""]:
        """The whole loss at the end."""
        return sum(self.losses.values(), start=jnp.zeros((), self.curve.dtype))

    @property
    def message(self) -> str:
        """How the fit ended, and what to do; names the parameters that ended on a bound. Not under jit."""
        bound = [name for name, where in self.on_bound.items() if np.any(where)]
        return str(Outcome[self.result]) + (f"; on a bound: {', '.join(bound)}" if bound else "")


class MultiStart(eqx.Module, Generic[Model]):
    """The best of many fits, by `multi_start`, and how every start went.

    - `best`: the fit from where the best start was after screening; its `start_losses` and `curve` begin there.
    - `chosen`: which start that was.
    - `losses`, `results`, `steps`: `(starts,)`, of the chosen one at its end, of every other one after screening.
    - `start_losses`: `(starts,)`, the whole loss of every start as it was given.
    """

    best: IterativeFit[Model]
    chosen: Int[Array, ""]
    losses: Float[Array, " starts"]
    results: Outcome
    steps: Int[Array, " starts"]
    start_losses: Float[Array, " starts"]

    def agreeing(self, relative: float = 1e-3) -> Int[Array, ""]:
        """How many starts, the chosen one included, have a loss within `relative` of the best one's."""
        return jnp.sum(self.losses <= (1 + relative) * self.best.loss)
