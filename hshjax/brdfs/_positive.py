"""BRDFs that are positive and reciprocal by construction: a link of a series, or a sum of squares of series.

`hshjax.fit` finds their coefficients, from `hshjax.positive_start` on.
"""

import abc
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._fields import floating
from hshjax._typing import Array, Float, Real
from hshjax.bases import AbstractPairBasis
from hshjax.brdfs._base import AbstractBRDF
from hshjax.brdfs._parameters import check_coefficients


class AbstractPositiveBRDF(AbstractBRDF):
    """ρ = link(series) > 0 over a reciprocal pair basis.

    `link` and its inverse are elementwise functions of the BRDF [sr^-1] and need no instance.

    **Raises:** ValueError for a basis that is not reciprocal, or coefficients that do not match it.
    """

    basis: eqx.AbstractVar[AbstractPairBasis]
    coefficients: eqx.AbstractVar[Array]
    axes: ClassVar[tuple[str, ...]] = ("channels",)

    def __check_init__(self):
        check_coefficients(self, *self.axes)
        if not self.basis.reciprocal:
            raise ValueError(f"{type(self).__name__} needs a reciprocal basis, got {self.basis}")

    @staticmethod
    @abc.abstractmethod
    def link(series: Real) -> Real:
        """The BRDF [sr^-1] of a value of the series."""

    @staticmethod
    @abc.abstractmethod
    def inverse_link(rho: Real) -> Real:
        """The value of the series that stands for a BRDF > 0 [sr^-1]."""


class ExpBRDF(AbstractPositiveBRDF):
    """ρ = exp(Σ c_k B_k(wi, wo)) [sr^-1]; `coefficients` `(modes, channels)`.

    A multiplicative model: highlights and shades cost coefficients alike, and dark tones are resolved as finely as
    bright ones.
    """

    basis: AbstractPairBasis
    coefficients: Float[Array, "modes channels"] = eqx.field(converter=floating)

    @staticmethod
    def link(series):
        return jnp.exp(series)

    @staticmethod
    def inverse_link(rho):
        return jnp.log(rho)

    def formula(self, wi, wo):
        return self.link(self.basis.evaluate(self.coefficients, wi, wo))


class SoftplusBRDF(AbstractPositiveBRDF):
    """ρ = b log(1 + exp(Σ c_k B_k(wi, wo) / b)), b = 0.1 sr^-1; `coefficients` `(modes, channels)`.

    Above b the BRDF is the series itself, as in `LinearBRDF`; below it is bent to stay positive.
    """

    basis: AbstractPairBasis
    coefficients: Float[Array, "modes channels"] = eqx.field(converter=floating)
    bend: ClassVar[float] = 0.1

    @staticmethod
    def link(series):
        return SoftplusBRDF.bend * jax.nn.softplus(series / SoftplusBRDF.bend)

    @staticmethod
    def inverse_link(rho):
        # log(e^x - 1), which neither overflows for large x nor cancels for small ones.
        x = rho / SoftplusBRDF.bend
        return SoftplusBRDF.bend * (x + jnp.log(-jnp.expm1(-x)))

    def formula(self, wi, wo):
        return self.link(self.basis.evaluate(self.coefficients, wi, wo))


class SquaredBRDF(AbstractPositiveBRDF):
    """ρ = Σ_s (Σ_k c_ks B_k(wi, wo))²: a sum of squares [sr^-1]; `coefficients` `(modes, squares, channels)`.

    A polynomial wherever the basis is one, of twice its order. Where a series passes through 0 the BRDF touches it.
    """

    basis: AbstractPairBasis
    coefficients: Float[Array, "modes squares channels"] = eqx.field(converter=floating)
    axes = ("squares", "channels")

    @staticmethod
    def link(series):
        return series**2

    @staticmethod
    def inverse_link(rho):
        return jnp.sqrt(rho)

    def formula(self, wi, wo):
        return jnp.sum(self.link(self.basis.evaluate(self.coefficients, wi, wo)), axis=-2)
