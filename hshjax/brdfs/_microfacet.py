"""Microfacet BRDFs: Cook-Torrance (Beckmann facets) and ABC, both with V-cavity shadowing, and GGX (Smith shadowing).

All are F(h·wo) D(h) G(wi, wo) / (4 z_i z_o), with ∫ D z_h dω_h = 1 but for ABC. With s = wi + wo the half vector is
s/|s| and h·wi = h·wo = |s|/2; tan²θ_h = (s_x² + s_y²)/s_z² is free of the cancellation in 1 - z_h². G and the
denominator are written as one factor, which stays finite where G and z vanish together.
"""

import equinox as eqx
import jax.numpy as jnp

from hshjax._fields import bounded
from hshjax._typing import Array, Float, Real
from hshjax.brdfs._base import AbstractBRDF, cosines, per_channel
from hshjax.brdfs._fresnel import AbstractFresnel, ConstantFresnel, DielectricFresnel
from hshjax.brdfs._parameters import check_parameters
from hshjax.geometry import dot, dot_xy, half_vector


class CookTorrance(AbstractBRDF):
    """ρ = diffuse / π + specular F D G / (4 z_i z_o).

    D = exp(-tan²θ_h / m²) / (π m² cos⁴θ_h) (Beckmann), G = min(1, 2 z_h z_i / (h·wo), 2 z_h z_o / (h·wo)) (V-cavities).

    - `diffuse`: scalar or `(channels,)`, dimensionless. Energy is conserved for diffuse + specular <= 1.
    - `specular`: scalar or `(channels,)`, dimensionless.
    - `slope`: scalar m, root mean square slope of the facets, dimensionless.
    - `fresnel`: F, see `ConstantFresnel` (default, 1), `SchlickFresnel`, `DielectricFresnel`, `ConductorFresnel`.

    Source: Cook & Torrance, A Reflectance Model for Computer Graphics, ACM TOG 1(1), 1982. The paper's lobe,
    F D G / (π z_i z_o) with D = exp(-tan²θ_h / m²) / (m² cos⁴θ_h), is 4 times this one, whose D is normalised.

    **Raises:** ValueError for parameters of other shapes.
    """

    diffuse: Real = bounded(0.0, 1.0, amplitude=True)
    specular: Real = bounded(0.0, 1.0, amplitude=True)
    slope: Float[Array, ""] = bounded(1e-3, 1.0, search=(0.03, 0.9), logarithmic=True)
    fresnel: AbstractFresnel = eqx.field(default_factory=ConstantFresnel)

    def __check_init__(self):
        check_parameters(self, spectra=("diffuse", "specular"), scalars=("slope",))

    def formula(self, wi, wo):
        zi, zo, _ = cosines(wi, wo)
        s = wi + wo
        length = jnp.sqrt(dot(s, s))[..., None]
        fresnel = self.fresnel(length[..., 0] / 2)
        lobe = fresnel * beckmann(s, self.slope, self.slope) * v_cavities(s, length, zi, zo)
        return per_channel(self.diffuse, wi) / jnp.pi + per_channel(self.specular, wi) * lobe


class GGX(AbstractBRDF):
    """ρ = specular F D G / (4 z_i z_o); add a `Lambert` for the body colour.

    D = α² / (π (α² z_h² + 1 - z_h²)²); G is the product of Smith's G1(z) = 2z / (z + sqrt(α² + (1 - α²) z²)), or with
    `height_correlated` 1 / (1 + Λ(z_i) + Λ(z_o)), Λ = 1/G1 - 1, which is the larger of the two.

    - `specular`: scalar or `(channels,)`, dimensionless.
    - `roughness`: scalar α, dimensionless; NOT the squared "perceptual" roughness of some renderers.
    - `fresnel`: F, see `ConstantFresnel` (default, 1), `SchlickFresnel`, `DielectricFresnel`, `ConductorFresnel`.

    Source: Walter et al., Microfacet Models for Refraction through Rough Surfaces, EGSR 2007, Eqs. 20, 23, 33, 34;
    Heitz, Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs, JCGT 3(2), 2014, Eq. 99.

    **Raises:** ValueError for parameters of other shapes.
    """

    specular: Real = bounded(0.0, 1.0, amplitude=True)
    roughness: Float[Array, ""] = bounded(1e-3, 1.0, search=(0.03, 0.9), logarithmic=True)
    fresnel: AbstractFresnel = eqx.field(default_factory=ConstantFresnel)
    height_correlated: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        check_parameters(self, spectra=("specular",), scalars=("roughness",))

    def formula(self, wi, wo):
        zi, zo, _ = cosines(wi, wo)
        s = wi + wo
        fresnel = self.fresnel(jnp.sqrt(dot(s, s)) / 2)
        ri, ro = (jnp.sqrt(self.roughness**2 + (1 - self.roughness**2) * z * z) for z in (zi, zo))
        if self.height_correlated:
            shadowing = 1 / (2 * (zo * ri + zi * ro))
        else:
            shadowing = 1 / ((zi + ri) * (zo + ro))
        lobe = fresnel * trowbridge_reitz(half_vector(wi, wo), self.roughness) * shadowing
        return per_channel(self.specular, wi) * lobe


class ABC(AbstractBRDF):
    """ρ = diffuse / π + amplitude F S G / (π z_i z_o), S = (1 + sharpness (1 - z_h))^-exponent: the ABC model.

    S has a tail of any weight: a power of 1 - z_h, where Beckmann's ends and GGX's is the fourth power of tan θ_h. G
    is that of V-cavities. S is not normalised: an amplitude beyond what the lobe's width allows reflects more than it
    receives.

    - `diffuse`: scalar or `(channels,)`, dimensionless.
    - `amplitude`: scalar or `(channels,)`, A of the source, dimensionless.
    - `sharpness`: scalar B, dimensionless; the lobe is sqrt(2 / B) [radians] wide in θ_h.
    - `exponent`: scalar C, dimensionless.
    - `fresnel`: F, see `DielectricFresnel` (default, of index 1.5), `ConstantFresnel`, `SchlickFresnel`,
      `ConductorFresnel`.

    Source: Löw, Kronander, Ynnerman, Unger, BRDF Models for Accurate and Efficient Rendering of Glossy Surfaces, ACM
    TOG 31(1), 2012, the microfacet variant. The factor 1 / π, Cook and Torrance's own, is that of the parameters
    published with it, see docs/decisions.md.

    **Raises:** ValueError for parameters of other shapes.
    """

    diffuse: Real = bounded(0.0, 1.0, amplitude=True)
    amplitude: Real = bounded(0.0, float("inf"), amplitude=True)
    sharpness: Float[Array, ""] = bounded(0.0, 1e8, search=(3.0, 1e6), logarithmic=True)
    exponent: Float[Array, ""] = bounded(0.0, 10.0, search=(0.3, 3.0), logarithmic=True)
    fresnel: AbstractFresnel = eqx.field(default_factory=lambda: DielectricFresnel(jnp.asarray(1.5)))

    def __check_init__(self):
        check_parameters(self, spectra=("diffuse", "amplitude"), scalars=("sharpness", "exponent"))

    def formula(self, wi, wo):
        zi, zo, _ = cosines(wi, wo)
        s = wi + wo
        length = jnp.sqrt(dot(s, s))[..., None]
        h = s / length
        o = dot_xy(h, h)[..., None] / (1 + h[..., 2:])  # 1 - z_h without its cancellation
        tail = jnp.exp(-self.exponent * jnp.log1p(self.sharpness * o))
        lobe = self.fresnel(length[..., 0] / 2) * tail * v_cavities(s, length, zi, zo) * (4 / jnp.pi)
        return per_channel(self.diffuse, wi) / jnp.pi + per_channel(self.amplitude, wi) * lobe


def v_cavities(s: Float[Array, "*batch 3"], length: Real, zi: Real, zo: Real) -> Real:
    """G / (4 z_i z_o) of V-cavities, `(*batch, 1)`; `length` is that of s = wi + wo."""
    # min(zi, zo) of the masking terms cancels against the denominator. One division at a time: second derivatives of
    # 1 / (|s|² z) overflow in float32 at z = 1e-6, and poison even the branch where G = 1.
    return jnp.minimum(1 / (4 * zi * zo), s[..., 2:] / length / length / jnp.maximum(zi, zo))


def beckmann(h: Float[Array, "*batch 3"], mx: Float[Array, ""], my: Float[Array, ""]) -> Real:
    """Beckmann's D [sr^-1], `(*batch, 1)`, with slopes mx, my along x, y; `h` need not have unit length.

    Far in the tail, where the exponential is below the 0.8th power of the smallest float (1e-30 in float32), D is 0
    with zero derivatives: the exponential underflows there while the derivatives of its argument overflow.
    """
    tangent2 = (h[..., :2] / h[..., 2:]) ** 2
    exponent = tangent2[..., :1] / mx**2 + tangent2[..., 1:] / my**2
    seen = exponent < -0.8 * jnp.log(jnp.finfo(h.dtype).tiny)
    exponent = jnp.where(seen, exponent, 0)
    cosine2 = 1 / (1 + jnp.where(seen, tangent2[..., :1] + tangent2[..., 1:], 0))
    return jnp.where(seen, jnp.exp(-exponent) / (jnp.pi * mx * my * cosine2**2), 0)


def trowbridge_reitz(h: Float[Array, "*batch 3"], alpha: Float[Array, ""]) -> Real:
    """The GGX D [sr^-1] at unit half vectors, `(*batch, 1)`; Trowbridge & Reitz, JOSA 65(5), 1975."""
    return alpha**2 / (jnp.pi * (alpha**2 * h[..., 2:] ** 2 + dot_xy(h, h)[..., None]) ** 2)
