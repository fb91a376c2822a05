"""How much an outlier counts in a `SampleMisfit`: losses that grow more slowly than a square."""

import abc

import equinox as eqx
import jax.numpy as jnp

from hshjax._fields import floating
from hshjax._typing import Array, Float, Real


class AbstractRobustLoss(eqx.Module):
    """A loss that grows more slowly than r² beyond `scale`, as the residual whose square it is."""

    scale: eqx.AbstractVar[Array]

    @abc.abstractmethod
    def __call__(self, residual: Real) -> Real:
        """r̃ with ½ r̃² = loss(r), of the sign of r."""


class Huber(AbstractRobustLoss):
    """½ r² up to |r| = scale, linear beyond."""

    scale: Float[Array, ""] = eqx.field(converter=floating)

    def __call__(self, residual):
        scale = self.scale.astype(residual.dtype)
        beyond = jnp.abs(residual) > scale
        size = jnp.where(beyond, jnp.abs(residual), scale)
        linear = jnp.sign(residual) * jnp.sqrt(scale * (2 * size - scale))
        return jnp.where(beyond, linear, residual)


class Cauchy(AbstractRobustLoss):
    """½ scale² log(1 + (r / scale)²)."""

    scale: Float[Array, ""] = eqx.field(converter=floating)

    def __call__(self, residual):
        x = (residual / self.scale.astype(residual.dtype)) ** 2
        some = x > 1e-4 if residual.dtype == jnp.float64 else x > 1e-2
        safe = jnp.where(some, x, 1)
        # sqrt(log1p(x) / x) by its series where the quotient would lose its derivatives.
        series = 1 + x * (-1 / 4 + x * (13 / 96 + x * (-35 / 384)))
        return residual * jnp.where(some, jnp.sqrt(jnp.log1p(safe) / safe), series)


class GemanMcClure(AbstractRobustLoss):
    """½ r² / (1 + (r / scale)²): bounded, so that a gross outlier has no pull at all."""

    scale: Float[Array, ""] = eqx.field(converter=floating)

    def __call__(self, residual):
        return residual / jnp.sqrt(1 + (residual / self.scale.astype(residual.dtype)) ** 2)
