"""What there is to say of a material: of the file, of its angles, of the BRDF."""

from typing import Any, NamedTuple

from hshjax.cli._console import Figures


def describe_file(figures: Figures, found: Any) -> None:
    """What the reader of a measured file found, its `Findings`."""
    figures.add("format", found.format)
    figures.add("material", found.material, words=found.material or "not declared")
    figures.add("channels", found.channel_names)
    figures.add("units", found.units)
    figures.add("entries", found.entries, label="pairs of directions")
    for key, why in (("dropped", found.dropped), ("masked", found.masked)):
        counts = "; ".join(f"{count}: {reason}" for reason, count in why.items())
        figures.add(key, dict(why), words=counts or "none")
    figures.add(
        "invalid_share", found.invalid_share, label="share that does not count", words=f"{found.invalid_share:.2%}"
    )
    figures.add("negative", found.negative, label="with a negative value")
    figures.add("notes", found.notes, label="decisions", words="\n".join(found.notes) or "none")


def describe_coverage(figures: Figures, found: Any) -> None:
    """The angles of samples, a `Coverage`."""
    lows = f"{found.theta_i[0]:.4g} to {found.theta_i[1]:.4g} degrees, {found.incidences} of them"
    figures.add("theta_i_degrees", found.theta_i, label="incidences", words=lows)
    figures.add("incidences", found.incidences, label="number of incidences")
    low, high = found.theta_o
    figures.add("theta_o_degrees", found.theta_o, label="outgoing angles", words=f"{low:.4g} to {high:.4g} degrees")
    if found.azimuths is None or found.azimuth_span is None:
        words = "none: all at the normal"
    else:
        words = "{:.4g} to {:.4g} degrees from that of incidence, over {:.4g} degrees in all".format(
            *found.azimuths, found.azimuth_span
        )
    figures.add("azimuths_degrees", found.azimuths, label="azimuths", words=words)
    figures.add("azimuth_span_degrees", found.azimuth_span, label="azimuth span")


def describe_model(figures: Figures, brdf: Any) -> None:
    """Class and numbers of a BRDF, without evaluating it."""
    import numpy as np

    from hshjax.brdfs import AbstractPositiveBRDF, HalfVectorTable, LinearBRDF, LogLinearBRDF, RGLTable

    figures.add("kind", type(brdf).__name__)
    if isinstance(brdf, HalfVectorTable):
        nodes = brdf.values.shape[:3]
        figures.add("nodes", nodes, words=" x ".join(map(str, nodes)) + " in θ_h, θ_d, φ_d")
    if isinstance(brdf, RGLTable):
        low, high = (float(np.degrees(theta)) for theta in (brdf.theta_i[0], brdf.theta_i[-1]))
        words = f"{low:.4g} to {high:.4g} degrees, {brdf.theta_i.size} of them"
        figures.add("theta_i_degrees", (low, high), label="incidences", words=words)
        figures.add("incidences", int(brdf.theta_i.size), label="number of incidences")
    if isinstance(brdf, LogLinearBRDF):
        _series(figures, brdf)
    if isinstance(brdf, LinearBRDF | AbstractPositiveBRDF):
        figures.add("basis", str(brdf.basis))
        shape = brdf.coefficients.shape
        figures.add("coefficients", shape, words=" x ".join(map(str, shape)))
    if isinstance(brdf, LinearBRDF):
        figures.add("target", brdf.target, label="the series stands for")


def _series(figures: Figures, brdf: Any) -> None:
    from hshjax.bases import AnisotropicHalfVectorBasis, HalfVectorBasis
    from hshjax.bases._warp import AbstractScaledWarp

    parts = [int((brdf.terms[:, 1] == j).sum()) for j in range(brdf.mixing.shape[0])]
    words = f"{brdf.count}: {' + '.join(map(str, parts))}, of {brdf.basis.count} functions each"
    figures.add("coefficients", brdf.count, words=words)
    if isinstance(brdf.basis, HalfVectorBasis | AnisotropicHalfVectorBasis):
        warps = {"warp": brdf.basis.warp, "difference_warp": brdf.basis.difference_warp}
        for name, warp in warps.items():
            if isinstance(warp, AbstractScaledWarp):
                alpha = float(warp.alpha)
                label = f"scale of the {name.replace('_', ' ')}"
                figures.add(f"{name}_scale", alpha, label, f"{alpha:.3g} ({type(warp).__name__})")


class Energy(NamedTuple):
    """The largest hemispherical albedo of channels, and the share of the energy that negative values have."""

    albedo: float
    negative: float


def describe_energy(figures: Figures, brdf: Any) -> Energy:
    """Albedos, the smallest value and the negative share: takes an evaluation of the BRDF in many directions."""
    import jax.numpy as jnp
    import numpy as np

    from hshjax.brdfs._isotropy import is_isotropic
    from hshjax.fitting._compare import ANGLES
    from hshjax.geometry import direction
    from hshjax.metrics import albedo, hemispherical_albedo, negativity
    from hshjax.quadrature import ANISOTROPIC_DEGREE, hemisphere_rule, isotropic_pair_rule, pair_rule

    known = getattr(getattr(brdf, "basis", None), "isotropic", None)
    isotropic = is_isotropic(brdf) if known is None else known
    # All directions at once, and of isotropic BRDFs those at one azimuth: a command is to start at once.
    node, weight = np.polynomial.legendre.leggauss(24)
    z, weight = (node + 1) / 2, weight / 2
    theta = jnp.asarray([*np.radians(ANGLES), *np.arccos(z)])
    directional = albedo(brdf, direction(theta, jnp.zeros_like(theta)), hemisphere_rule(64))
    rows, along = directional[: len(ANGLES)], directional[len(ANGLES) :]
    figures.add(
        "albedo", {f"{angle:g}": row for angle, row in zip(ANGLES, rows, strict=True)},
        "albedo at 0, 45, 75 degrees", "   ".join(numbers(row) for row in rows),
    )  # fmt: skip
    if isotropic:
        white = 2 * jnp.sum(jnp.asarray(weight * z)[:, None] * along, axis=0)
    else:
        white = hemispherical_albedo(brdf, hemisphere_rule(32))
    figures.add("hemispherical_albedo", white, words=numbers(white))
    negative = negativity(brdf, isotropic_pair_rule(32) if isotropic else pair_rule(ANISOTROPIC_DEGREE))
    smallest, share = float(negative.minimum), float(negative.share)
    figures.add("smallest_value", smallest, words=f"{smallest:.3g} sr^-1")
    figures.add("negative_share", share, "negative share of the energy", f"{share:.2g}")
    return Energy(float(jnp.max(white)), share)


def describe_log_error(figures: Figures, error: Any) -> None:
    """Mean |Δ ln(1 + ρ cos θ)| of two materials, per channel."""
    figures.add("log_error", error, "error of ln(1 + ρ cos θ), up to 80 degrees", numbers(error))


def numbers(values: Any) -> str:
    """One number a channel, for people; of more than four channels their range."""
    values = [float(v) for v in values]
    if len(values) > 4:
        return f"{min(values):.4g} to {max(values):.4g} in {len(values)} channels"
    return " ".join(f"{v:.4g}" for v in values)
