"""The fitted BRDF: a series in a pair basis."""

from typing import Literal, get_args

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.bases import AbstractPairBasis
from hshjax.brdfs._base import AbstractBRDF
from hshjax.brdfs._parameters import check_coefficients

Target = Literal["brdf", "half_foreshortened", "foreshortened"]

EXPONENTS: dict[Target, float] = {"brdf": 0.0, "half_foreshortened": 0.5, "foreshortened": 1.0}


def _known(target: str) -> Target:
    if target not in EXPONENTS:
        raise ValueError(f"target must be one of {', '.join(get_args(Target))}, got {target!r}")
    return target


class LinearBRDF(AbstractBRDF):
    """A BRDF that is linear in its coefficients `(modes, channels)`.

    `target` says what the series Σ c_k B_k(wi, wo) stands for, with z = cos θ:

    - "brdf": the BRDF ρ itself;
    - "half_foreshortened": sqrt(z_i z_o) ρ;
    - "foreshortened": g = z_i z_o ρ, what Eq. 1 integrates; bounded where ρ diverges at grazing angles.

    A call returns ρ [sr^-1] in every case: the series divided by (z_i z_o)^p, finite on the open hemisphere.

    **Raises:** ValueError for coefficients that do not match the basis, or an unknown target.
    """

    basis: AbstractPairBasis
    coefficients: Float[Array, "modes channels"] = eqx.field(converter=jnp.asarray)
    target: Target = eqx.field(static=True, default="brdf", converter=_known)

    def __check_init__(self):
        check_coefficients(self, "channels")

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.coefficients.shape[1]

    def formula(self, wi, wo):
        series = self.basis.evaluate(self.coefficients, wi, wo)
        if self.target == "brdf":
            return series
        return series / foreshortening(wi, wo, self.target)[..., None]


def foreshortening(
    wi: Float[Array, "*batch 3"], wo: Float[Array, "*batch 3"], target: Target
) -> Float[Array, " *batch"]:
    """(z_i z_o)^p with the exponent p of the target: the factor between a BRDF and what a series stands for."""
    return cosine_power(wi, wo, EXPONENTS[target])


def cosine_power(
    wi: Float[Array, "*batch 3"], wo: Float[Array, "*batch 3"], exponent: float
) -> Float[Array, " *batch"]:
    """(z_i z_o)^exponent; exactly 1 for the exponent 0."""
    product = wi[..., 2] * wo[..., 2]
    if exponent == 0:
        return jnp.ones_like(product)
    return product ** (int(exponent) if float(exponent).is_integer() else exponent)  # integer powers are exact
