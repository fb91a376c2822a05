"""In which numbers reflectance is compared by a `SampleMisfit`.

Every mapping is odd, f(-x) = -f(x): a linear model may pass through negative values on its way, and must find back.
"""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from hshjax._fields import floating
from hshjax._typing import Array, Float, Real


class AbstractMapping(eqx.Module):
    """A mapping of BRDF values, applied to model and samples alike before they are subtracted.

    `linear`: whether it is linear in ρ; to be said by every mapping that is.
    """

    linear: ClassVar[bool] = False

    @abc.abstractmethod
    def __call__(self, rho: Float[Array, "n channels"], wi: Float[Array, "n 3"], wo: Float[Array, "n 3"]) -> Real:
        """What is compared: `(n, channels)`."""


class Identity(AbstractMapping):
    """ρ itself: bright highlights decide."""

    linear = True

    def __call__(self, rho, wi, wo):
        return rho


class CosineWeighted(AbstractMapping):
    """ρ z_i z_o, what leaves a surface under a light: grazing directions count as little as they are seen."""

    linear = True

    def __call__(self, rho, wi, wo):
        return rho * _cosines(wi, wo)


class LogCosineWeighted(AbstractMapping):
    """log(1 + ρ z_i z_o): near to relative where ρ z_i z_o >> 1, absolute below."""

    def __call__(self, rho, wi, wo):
        return _odd(jnp.log1p, rho * _cosines(wi, wo))


class LogRelative(AbstractMapping):
    """log((ρ c + ε) / (ρ_ref c + ε)), c = max(z_i z_o, ε); the reference cancels in a difference and is left out.

    - `epsilon`: ε, below which a value is dark, dimensionless.

    Source: Nielsen, Jensen, Ramamoorthi, On Optimal, Minimal BRDF Sampling for Reflectance Acquisition, ACM TOG 34(6),
    2015, the log-relative mapping with ε = 0.001.
    """

    epsilon: Float[Array, ""] = eqx.field(converter=floating, default=1e-3)

    def __call__(self, rho, wi, wo):
        epsilon = self.epsilon.astype(rho.dtype)
        return _odd(jnp.log1p, rho * jnp.maximum(_cosines(wi, wo), epsilon) / epsilon)


class CubeRoot(AbstractMapping):
    """(ρ z_i z_o + ε)^(1/3) - ε^(1/3): as the eye weighs light and dark; ε keeps the slope finite at black."""

    epsilon: Float[Array, ""] = eqx.field(converter=floating, default=1e-3)

    def __call__(self, rho, wi, wo):
        epsilon = self.epsilon.astype(rho.dtype)

        def root(x):
            return jnp.cbrt(x + epsilon) - jnp.cbrt(epsilon)

        return _odd(root, rho * _cosines(wi, wo))


def _cosines(wi, wo):
    return (wi[..., 2] * wo[..., 2])[..., None]


def _odd(f, x):
    """The odd continuation of f from x >= 0; not by sign(x), whose 0 would lose the slope at 0."""
    return jnp.where(x < 0, -f(jnp.where(x < 0, -x, 0)), f(jnp.where(x < 0, 0, x)))
