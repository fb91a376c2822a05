"""Where a radial coordinate runs fast: warps of o = 1 - cos θ_h or 1 - cos θ_d, for lobes of any width."""

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hshjax._fields import bounded
from hshjax._typing import Array, Float, Real


class AbstractWarp(eqx.Module):
    """A rising function u of o = 1 - cos θ = 2 sin²(θ/2) on [0, 1], with u(0) = 0 and u(1) = 1; θ is θ_h or θ_d."""

    @abc.abstractmethod
    def ratio(self, o: Real) -> Real:
        """u(o) / o, also in the limit o -> 0 where there is one."""

    def __call__(self, o: Real) -> Real:
        """u(o)."""
        return o * self.ratio(o)


class IdentityWarp(AbstractWarp):
    """u = o: polynomials in cos θ."""

    def ratio(self, o):
        return jnp.ones_like(o)


class RootWarp(AbstractWarp):
    """u = sqrt(o), in proportion to sin(θ/2). Not smooth at o = 0, where derivatives are reported as 0."""

    def ratio(self, o):
        positive = o > 0
        return jnp.where(positive, 1 / jnp.sqrt(jnp.where(positive, o, 1)), 0)


class AbstractScaledWarp(AbstractWarp):
    """A warp with a scale α.

    **Raises:** ValueError unless α is a scalar > 0; values inside a compiled program cannot be seen.
    """

    alpha: Float[Array, ""] = bounded(1e-8, 10.0, search=(1e-6, 1.0), logarithmic=True)

    def __check_init__(self):
        if self.alpha.shape != ():
            raise ValueError(f"{type(self).__name__} needs a scalar alpha, got shape {self.alpha.shape}")
        if not isinstance(self.alpha, Tracer) and not (np.isfinite(self.alpha) and self.alpha > 0):
            raise ValueError(f"{type(self).__name__} needs alpha > 0, got {self.alpha}")


class RationalWarp(AbstractScaledWarp):
    """u = (1 + α) o / (o + α): resolves lobes down to a width of about sqrt(2 α) [radians] in θ."""

    def ratio(self, o):
        alpha = self.alpha.astype(o.dtype)
        return (1 + alpha) / (o + alpha)


class LogWarp(AbstractScaledWarp):
    """u = ln(1 + o/α) / ln(1 + 1/α): as `RationalWarp`, with equal care for every scale above that width."""

    def ratio(self, o):
        alpha = self.alpha.astype(o.dtype)
        x = o / alpha
        small = x < 1e-2
        # ln(1 + x) / x by its series where the quotient is 0/0: the first term left out is below 1e-14.
        series = 1 / 7
        for k in range(6, 0, -1):
            series = 1 / k - x * series
        safe = jnp.where(small, 1, x)
        return jnp.where(small, series, jnp.log1p(safe) / safe) / (alpha * jnp.log1p(1 / alpha))
