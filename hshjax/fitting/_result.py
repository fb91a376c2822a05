"""What a fit returns."""

from typing import Generic, TypeVar

import equinox as eqx

from hshjax._typing import Array, Float
from hshjax.fitting._certificate import Certificate
from hshjax.fitting._outcome import Outcome
from hshjax.metrics import ReciprocityError

Model = TypeVar("Model", bound=eqx.Module)


class Fit(eqx.Module, Generic[Model]):
    """A fitted model and what can be said about the fit.

    - `model`: the fitted BRDF.
    - `norm`: name of the norm (see `NORMS`) in which the two figures that follow are meant.
    - `residual`: root of Σ w |ρ - ρ̂|² in that norm, per channel. - `relative`: the same over the root of Σ w |ρ|².
    - `condition`: estimate of the condition number of the weighted design matrix; 1 where inner products were enough.
    - `method`: "inner products" or "QR". - `samples`: how many have a weight. - `unknowns`: how many were solved for.
    - `reciprocity_before`: violation in the data, over the pairs of samples that are each other's swap (`pairs` may be
      0). `reciprocity_after`: that of the model, over the directions of the data. None where they were not asked for.
    - `covariance`: `(modes, modes)`, to be multiplied by `noise`, the estimated variance per channel of a sample of
      weight 1 (of the series that is fitted: of z_i z_o ρ in norm D): the posterior of the coefficients for Gaussian
      noise. None where it was not asked for. Constraints do not enter it.
    - `certificate`: what was found of the physical validity of the fit. None where no constraint was asked for.
    - `result`: how the fit ended, an `Outcome`.
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
