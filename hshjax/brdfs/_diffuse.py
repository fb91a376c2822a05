"""Diffuse BRDFs: Lambert, Oren-Nayar."""

import equinox as eqx
import jax.numpy as jnp

from hshjax._fields import bounded
from hshjax._typing import Array, Float, Real
from hshjax.brdfs._base import AbstractBRDF, cosines, per_channel
from hshjax.brdfs._parameters import check_parameters
from hshjax.geometry import dot_xy


class Lambert(AbstractBRDF):
    """ρ = albedo / π.

    - `albedo`: scalar or `(channels,)`, dimensionless, the directional albedo at every angle.

    **Raises:** ValueError for parameters of other shapes.
    """

    albedo: Real = bounded(0.0, 1.0, amplitude=True)

    def __check_init__(self):
        check_parameters(self, spectra=("albedo",))

    def formula(self, wi, wo):
        return jnp.broadcast_to(per_channel(self.albedo / jnp.pi, wi), (*wi.shape[:-1], self.albedo.size))


class OrenNayar(AbstractBRDF):
    """Rough diffuse surface of V-shaped Lambertian grooves with Gaussian slopes.

    - `albedo`: scalar or `(channels,)`, dimensionless, of a facet; not the directional albedo of the surface.
    - `sigma`: scalar, standard deviation of the facets' tilt [radians]; 0 is `Lambert`.
    - `full`: the complete functional model with its interreflections (quadratic in `albedo`), not the qualitative one.

    Both are fits to numerical integrals and no exact energy balance, an exception to "directional albedo <= 1": at
    albedo 1 and grazing exit it reaches 1.016 (qualitative, sigma = 0.20) and 1.051 (full, sigma = 0.32).

    Source: Oren & Nayar, Generalization of Lambert's Reflectance Model, SIGGRAPH 1994 (the functional and the
    qualitative model), written in Cartesian components: with α the larger and β the smaller polar angle,
    cos Δφ sin α tan β = (x_i x_o + y_i y_o) / max(z_i, z_o).

    **Raises:** ValueError for parameters of other shapes.
    """

    albedo: Real = bounded(0.0, 1.0, amplitude=True)
    sigma: Float[Array, ""] = bounded(0.0, jnp.pi / 2, search=(0.05, 1.2))
    full: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        check_parameters(self, spectra=("albedo",), scalars=("sigma",))

    def formula(self, wi, wo):
        zi, zo, _ = cosines(wi, wo)
        albedo, variance = per_channel(self.albedo, wi), self.sigma**2
        # s = sin θ_i sin θ_o cos Δφ as a sum of products: wi·wo - zi zo would cancel near the pole.
        s = dot_xy(wi, wo)[..., None]
        cosine_tangent = s / jnp.maximum(zi, zo)
        constant = 1 - variance / (2 * (variance + 0.33))
        slope = 0.45 * variance / (variance + 0.09)
        if not self.full:
            return albedo / jnp.pi * (constant + slope * jnp.maximum(cosine_tangent, 0))

        theta_i, sine_i = _polar(wi)
        theta_o, sine_o = _polar(wo)
        beta = 2 / jnp.pi * jnp.minimum(theta_i, theta_o)
        sine_alpha = jnp.maximum(sine_i, sine_o)
        # A direction at the pole has no azimuth; every term with cos Δφ alone carries a power of beta, 0 there.
        tilted = beta > 0
        cosine = jnp.where(tilted, s / jnp.where(tilted, sine_i * sine_o, 1), 0)
        backward = jnp.where(tilted, beta**3 / jnp.where(tilted, sine_alpha, 1), 0)
        direct = (
            constant
            + slope * cosine_tangent * jnp.where(s >= 0, 1, 1 - backward)
            + 0.125 * variance / (variance + 0.09)
            * (4 / jnp.pi**2 * theta_i * theta_o) ** 2
            * (1 - jnp.abs(cosine))
            * (sine_i + sine_o) / (zi + zo)  # tan((α + β) / 2)
        )  # fmt: skip
        interreflected = 0.17 * variance / (variance + 0.13) * (1 - cosine * beta**2)
        return albedo / jnp.pi * (direct + albedo * interreflected)


def _polar(w: Float[Array, "*batch 3"]) -> tuple[Real, Real]:
    """θ and sin θ, each `(*batch, 1)`: below 1e-8 taken as 0 with zero derivatives.

    Only powers of θ from the second on are used, so that the change is below rounding; the root's derivatives are not.
    """
    square = dot_xy(w, w)[..., None]
    tilted = square > 1e-16
    sine = jnp.sqrt(jnp.where(tilted, square, 1))
    return jnp.where(tilted, jnp.arctan2(sine, w[..., 2:]), 0), jnp.where(tilted, sine, 0)
