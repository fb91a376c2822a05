"""Terms: what a fit asks of a model, each as a residual r(model) that enters the loss as ½|r|².

A term knows the model and nothing of solvers. `weight * term` scales its part of the loss.
"""

import abc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

from hshjax._fields import floating
from hshjax._typing import Array, Float, PairFunction, Real
from hshjax.bases import TensorBasis
from hshjax.brdfs._linear import LinearBRDF
from hshjax.brdfs._positive import AbstractPositiveBRDF
from hshjax.fitting._mappings import AbstractMapping, Identity
from hshjax.fitting._robust import AbstractRobustLoss
from hshjax.quadrature import PairRule, Rule
from hshjax.samples import Samples


class AbstractTerm(eqx.Module):
    """A part of an objective. ½|r|² enters the loss; `r` is an array of any shape, or a pytree of them."""

    @abc.abstractmethod
    def __call__(self, model: Any) -> Any:
        """The residual r."""

    def __mul__(self, weight: Real | float) -> "Weighted":
        return Weighted(self, floating(weight))

    __rmul__ = __mul__


class Weighted(AbstractTerm):
    """weight x term: the loss of the term times `weight` >= 0.

    **Raises:** ValueError for a weight that is negative or no scalar.
    """

    term: AbstractTerm
    weight: Float[Array, ""]

    def __check_init__(self):
        seen = not isinstance(self.weight, Tracer)
        if self.weight.shape != () or (seen and not self.weight >= 0):
            raise ValueError(f"the weight of a term must be a scalar >= 0, got {self.weight}")

    def __call__(self, model):
        return jax.tree.map(lambda r: jnp.sqrt(self.weight).astype(r.dtype) * r, self.term(model))


class Of(AbstractTerm):
    """A term about a part of the model: `Of(lambda scene: scene.brdf, Reciprocity(rule))`.

    `part` belongs to the compiled program: use one function again and again, for another one compiles anew.
    """

    part: Callable[[Any], Any] = eqx.field(static=True)
    term: AbstractTerm

    def __call__(self, model):
        return self.term(self.part(model))


class SampleMisfit(AbstractTerm):
    """sqrt(w) (f(ρ) - f(ρ_samples)) of every sample and channel.

    - `samples`: the data; weight 0 masks a sample, whatever its value. Weights enter as they are.
    - `mapping`: f, see `Identity`, `CosineWeighted`, `LogCosineWeighted`, `LogRelative`, `CubeRoot`.
    - `robust`: None for least squares, or `Huber`, `Cauchy`, `GemanMcClure` of the unweighted difference.

    **Raises:** ValueError where the model has other channels than the samples.
    """

    samples: Samples
    mapping: AbstractMapping = Identity()
    robust: AbstractRobustLoss | None = None

    def __call__(self, model: PairFunction):
        data = self.samples.cleared()
        wi, wo = data.wi, data.wo
        rho = model(wi, wo)
        if rho.shape != data.value.shape:
            raise ValueError(f"the model gives values of shape {rho.shape}, the samples have {data.value.shape}")
        difference = self.mapping(rho, wi, wo) - self.mapping(data.value, wi, wo)
        # What is masked must stay 0 even where the model itself is infinite at the normal.
        difference = jnp.where((data.weight > 0)[:, None], difference, 0)
        if self.robust is not None:
            difference = self.robust(difference)
        return jnp.sqrt(data.weight)[:, None] * difference


class Reciprocity(AbstractTerm):
    """sqrt(w) (ρ(wi, wo) - ρ(wo, wi)) at the pairs of a rule; without one, A - Aᵀ of a series in a `TensorBasis`.

    By orthonormality both have the same square, for the function that the series stands for, over a rule that is exact
    for the basis: ∫∫ (f(i, o) - f(o, i))² dω_i dω_o = ||A - Aᵀ||².

    **Raises:** ValueError without a rule for anything but a `LinearBRDF` over a `TensorBasis`.
    """

    pairs: PairRule | None = None

    def __call__(self, model):
        if self.pairs is not None:
            rule = self.pairs
            return jnp.sqrt(rule.weight)[:, None] * (model(rule.wi, rule.wo) - model(rule.wo, rule.wi))
        if not (isinstance(model, LinearBRDF) and isinstance(model.basis, TensorBasis)):
            raise ValueError(
                f"Reciprocity() in closed form needs a LinearBRDF over a TensorBasis, got {model}; give it pairs"
            )
        size = model.basis.basis.count
        matrix = model.coefficients.reshape(size, size, -1)
        return matrix - jnp.swapaxes(matrix, 0, 1)


class NonNegativity(AbstractTerm):
    """sqrt(w) min(ρ, 0) at the pairs of a rule."""

    pairs: PairRule

    def __call__(self, model: PairFunction):
        value = model(self.pairs.wi, self.pairs.wo)
        return jnp.sqrt(self.pairs.weight)[:, None] * jnp.minimum(value, 0)


class EnergyConservation(AbstractTerm):
    """max(a(wo) - 1, 0), the excess of the directional albedo a(wo) = ∫ ρ(wi, wo) z_i dω_i, for every `wo`.

    - `rule`: nodes of the integral over wi. - `wo`: directions `(n, 3)`.
    """

    rule: Rule
    wo: Float[Array, "n 3"]

    def __call__(self, model: PairFunction):
        weight = self.rule.weight * self.rule.w[:, 2]

        def excess(wo):
            value = model(self.rule.w, jnp.broadcast_to(wo, self.rule.w.shape))
            return jnp.maximum(jnp.tensordot(weight, value, 1, precision="highest") - 1, 0)

        return jax.lax.map(excess, self.wo)


class Smoothness(AbstractTerm):
    """(n(n+1) + p(p+1)) c of every coefficient of a series: the spectral prior of `project`, as a term.

    Its loss is half of what `ridge` with `prior="spectral"` adds to the squared error. Of an `ExpBRDF` it keeps the
    logarithm smooth: without it nothing holds the exponential where samples weigh little, towards grazing.
    """

    def __call__(self, model: LinearBRDF | AbstractPositiveBRDF):
        coefficients = model.coefficients
        orders = jnp.asarray(model.basis.degrees(), coefficients.dtype)
        return jnp.einsum("k,k...->k...", jnp.sum(orders * (orders + 1), axis=1), coefficients)


class Prior(AbstractTerm):
    """The difference to a given model of the same structure, leaf by leaf, over its scale.

    - `model`: where the prior is centred; a part of None is free. - `scale`: standard deviation, in the leaf's unit.
    """

    model: Any
    scale: Float[Array, ""] = eqx.field(converter=floating, default=1.0)

    def __call__(self, model):
        return jax.tree.map(
            lambda mean, leaf: None if mean is None else (leaf - mean) / self.scale.astype(leaf.dtype),
            eqx.filter(self.model, eqx.is_inexact_array),
            eqx.filter(model, eqx.is_inexact_array),
            is_leaf=lambda x: x is None,
        )


class Sparsity(AbstractTerm):
    """Σ |c| over the trainable numbers, the L1 norm: times its weight a part of the loss as it is, not as a square.

    Only `Jaxopt(jaxopt.ProximalGradient)` takes it: at 0, where it wants the numbers, it has no gradient.
    """

    def __call__(self, model):
        raise ValueError("Sparsity is no residual; only `fit` with Jaxopt(jaxopt.ProximalGradient) knows what to do")


def l1_weight(term: AbstractTerm) -> Array | None:
    """The weight of a `Sparsity` term, None for any other."""
    if isinstance(term, Weighted):
        inner = l1_weight(term.term)
        return None if inner is None else term.weight * inner.astype(term.weight.dtype)
    return jnp.asarray(1.0) if isinstance(term, Sparsity) else None
