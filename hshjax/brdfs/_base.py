"""The BRDF: a function of a pair of directions, and sums and multiples of such."""

import abc
from typing import ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._fields import bounded
from hshjax._typing import Array, Float, Real
from hshjax.brdfs._parameters import check_parameters
from hshjax.geometry import as_directions, dot

M = TypeVar("M", bound=eqx.Module)


class AbstractBRDF(eqx.Module):
    """ρ(wi, wo) [sr^-1]: reflected radiance over irradiance, cosine NOT included.

    `wi` and `wo` are unit directions `(*batch, 3)` in the local frame (normal +z), both pointing AWAY from the surface;
    they broadcast against each other. The result is `(*batch, channels)` in the dtype of the directions. Outside the
    open hemisphere (z <= 0 in either direction) a BRDF is 0, with zero gradient.

    A final class writes one formula, `formula(wi, wo)`, and may take for granted that both z > 0. `a + b`, `2.0 * a`
    and `a * scale` make new BRDFs.

    **Raises:** ValueError, when called, for directions that do not have three components.
    """

    __array_ufunc__: ClassVar = None  # numpy_array * brdf asks the BRDF, instead of making an array of BRDFs

    @abc.abstractmethod
    def formula(self, wi: Float[Array, "*batch 3"], wo: Float[Array, "*batch 3"]) -> Float[Array, "*batch channels"]:
        """The BRDF [sr^-1] at directions of equal shape strictly above the horizon."""

    def __call__(self, wi: Float[Array, "... 3"], wo: Float[Array, "... 3"]) -> Real:
        return _above_the_horizon(self, *as_directions(wi, wo))

    def __add__(self, other: "AbstractBRDF") -> "SumBRDF":
        if not isinstance(other, AbstractBRDF):
            return NotImplemented
        return SumBRDF(self, other)

    def __mul__(self, scale: Real | float) -> "ScaledBRDF":
        if isinstance(scale, AbstractBRDF):
            raise TypeError("a product of two BRDFs is not a BRDF (its unit would be sr^-2); scale by a number")
        return ScaledBRDF(self, jnp.asarray(scale))

    __rmul__ = __mul__


@eqx.filter_jit  # a call without jit is one compiled program too, not some dozens of them
def _above_the_horizon(brdf: AbstractBRDF, wi: Array, wo: Array) -> Array:
    shape = jnp.broadcast_shapes(wi.shape, wo.shape)
    wi, wo = jnp.broadcast_to(wi, shape), jnp.broadcast_to(wo, shape)
    above = ~((wi[..., 2] <= 0) | (wo[..., 2] <= 0))[..., None]  # NaN is not below: it stays NaN
    # Directions below are replaced before the formula sees them: a masked infinity would still poison the gradient.
    pole = jnp.zeros(shape, wi.dtype).at[..., 2].set(1)
    value = in_dtype(brdf, wi.dtype).formula(jnp.where(above, wi, pole), jnp.where(above, wo, pole))
    return jnp.where(above, value, jnp.zeros_like(value))


class SumBRDF(AbstractBRDF):
    """a + b; channels broadcast (one channel against many)."""

    a: AbstractBRDF
    b: AbstractBRDF

    def __check_init__(self):
        for part in (self.a, self.b):
            if not isinstance(part, AbstractBRDF):
                raise ValueError(f"a sum of BRDFs needs BRDFs, got {part!r}")

    def formula(self, wi, wo):
        return self.a.formula(wi, wo) + self.b.formula(wi, wo)


class ScaledBRDF(AbstractBRDF):
    """scale x brdf; `scale` is a scalar or one factor per channel."""

    brdf: AbstractBRDF
    scale: Real = bounded(0.0, float("inf"), amplitude=True)

    def __check_init__(self):
        if not isinstance(self.brdf, AbstractBRDF):
            raise ValueError(f"a multiple of a BRDF needs a BRDF, got {self.brdf!r}")
        check_parameters(self, spectra=("scale",))

    def formula(self, wi, wo):
        return per_channel(self.scale, wi) * self.brdf.formula(wi, wo)


def in_dtype(module: M, dtype) -> M:
    """The same BRDF or light with its floating leaves in `dtype`: results follow the directions."""

    def cast(leaf):
        return leaf.astype(dtype) if eqx.is_inexact_array(leaf) and leaf.dtype != dtype else leaf

    return jax.tree.map(cast, module)


def per_channel(parameter: Real, w: Float[Array, "*batch 3"]) -> Real:
    """A scalar or `(channels,)` parameter with leading axes for the batch, ready to meet `(*batch, channels)`."""
    return jnp.reshape(parameter, (1,) * (w.ndim - 1) + (-1,))


def cosines(wi: Float[Array, "*batch 3"], wo: Float[Array, "*batch 3"]) -> tuple[Real, Real, Real]:
    """cos θ_i, cos θ_o and wi·wo, each `(*batch, 1)`."""
    return wi[..., 2:], wo[..., 2:], dot(wi, wo)[..., None]
