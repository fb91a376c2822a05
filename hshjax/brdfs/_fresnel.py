"""Fresnel factors of the microfacet models: constant, Schlick's approximation, exact for dielectrics and conductors.

Each maps the cosine of the angle between a direction and the half vector to a reflectance in [0, 1], unpolarised.
Refractive indices are relative to the medium that the light comes from.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._fields import bounded
from hshjax._typing import Array, Float, Real
from hshjax.brdfs._parameters import check_parameters


class AbstractFresnel(eqx.Module):
    """F(cos θ_d): cosines `(*batch,)` in [0, 1] to reflectances `(*batch, channels)`, in the dtype of the cosines.

    Parameters are scalars (one channel) or `(channels,)`.

    **Raises:** ValueError for parameters of other shapes.
    """

    @abc.abstractmethod
    def formula(self, cosine: Real) -> Real:
        """The reflectance at cosines `(*batch, 1)`; parameters arrive as `(1, ..., 1, channels)`."""

    def __call__(self, cosine: Float[Array, "*batch"]) -> Real:
        cosine = jnp.asarray(cosine)

        def lead(parameter):
            return jnp.reshape(parameter, (1,) * cosine.ndim + (-1,)).astype(cosine.dtype)

        return jax.tree.map(lead, self).formula(cosine[..., None])


class ConstantFresnel(AbstractFresnel):
    """F = value at every angle.

    `value` is a plain number and no parameter of a fit: it could not be told from the `specular` that multiplies it.

    **Raises:** ValueError for a value outside [0, 1].
    """

    value: float = eqx.field(static=True, default=1.0, converter=float)

    def __check_init__(self):
        if not 0 <= self.value <= 1:
            raise ValueError(f"a Fresnel reflectance lies in [0, 1], got {self.value}")

    def formula(self, cosine):
        return jnp.full_like(cosine, self.value)


class SchlickFresnel(AbstractFresnel):
    """F = f0 + (1 - f0) (1 - cos θ_d)^5, f0 the reflectance at normal incidence.

    Source: Schlick, An Inexpensive BRDF Model for Physically-based Rendering, Computer Graphics Forum 13(3), 1994.
    """

    f0: Real = bounded(0.0, 1.0, search=(0.02, 0.9), logarithmic=True)

    def __check_init__(self):
        check_parameters(self, spectra=("f0",))

    def formula(self, cosine):
        return self.f0 + (1 - self.f0) * (1 - cosine) ** 5


class DielectricFresnel(AbstractFresnel):
    """Exact reflectance of a lossless medium of relative index `eta` (dimensionless; below 1 from the denser side).

    Beyond the critical angle (eta < 1) the reflection is total: F = 1, with zero gradient.

    Source: Born & Wolf, Principles of Optics, 7th ed., section 1.5.2; mean of both polarisations.
    """

    eta: Real = bounded(0.25, 4.0, search=(1.2, 2.5))

    def __check_init__(self):
        check_parameters(self, spectra=("eta",))

    def formula(self, cosine):
        square = self.eta**2 - 1 + cosine**2  # (eta cos θ_t)², by Snell's law
        transmitted = square > 0
        refracted = jnp.sqrt(jnp.where(transmitted, square, 1))
        senkrecht = (cosine - refracted) / (cosine + refracted)
        parallel = (self.eta**2 * cosine - refracted) / (self.eta**2 * cosine + refracted)
        return jnp.where(transmitted, (senkrecht**2 + parallel**2) / 2, 1)


class ConductorFresnel(AbstractFresnel):
    """Exact reflectance of an absorbing medium of complex index eta + ik (dimensionless); k = 0 is the dielectric.

    Source: Born & Wolf, Principles of Optics, 7th ed., section 14.2; mean of both polarisations.
    """

    eta: Real = bounded(0.01, 10.0, search=(0.1, 5.0), logarithmic=True)
    k: Real = bounded(0.0, 20.0, search=(0.5, 10.0), logarithmic=True)

    def __check_init__(self):
        check_parameters(self, spectra=("eta", "k"))

    def formula(self, cosine):
        sine2 = (1 - cosine) * (1 + cosine)
        # a + ib = sqrt((eta + ik)² - sin²θ): a² + b² = modulus, a² - b² = real, ab = eta k.
        real = self.eta**2 - self.k**2 - sine2
        modulus2 = real**2 + 4 * (self.eta * self.k) ** 2
        nonzero = modulus2 > 0
        modulus = jnp.where(nonzero, jnp.sqrt(jnp.where(nonzero, modulus2, 1)), 0)
        # The larger of a, b comes from the sum without cancellation, the smaller one from their product; so k = 0
        # beyond the critical angle needs no root of zero.
        larger = jnp.sqrt(jnp.where(nonzero, (modulus + jnp.abs(real)) / 2, 1))
        a = jnp.where(nonzero, jnp.where(real >= 0, larger, self.eta * self.k / larger), 0)
        cosine2, cross = cosine**2, 2 * a * cosine
        senkrecht = (modulus + cosine2 - cross) / (modulus + cosine2 + cross)
        parallel = (cosine2 * modulus + sine2**2 - cross * sine2) / (cosine2 * modulus + sine2**2 + cross * sine2)
        return senkrecht * (1 + parallel) / 2
