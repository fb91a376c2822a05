"""An isotropic BRDF as the tables of an RGL file: distribution of normals, its projections, and what is left.

Any positive distribution D of normals makes a valid parametrisation, if its projected area σ and the distribution of
visible normals belong to it: they only say where values are tabulated. That of Dupuy and Jakob (2018, section 4) suits
the material: for a microfacet material of D, whose masking is exact when it is seen along its own illumination,

    ρ(ω, ω) = D(ω) / (4 σ(ω) cos θ),    σ(ω) = ∫ D(m) max(m·ω, 0) dm,

so that D is the eigenvector of D -> ρ(ω, ω) cos θ σ(ω) that power iteration finds.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float, PairFunction
from hshjax.brdfs._isotropy import is_isotropic
from hshjax.brdfs._known import known
from hshjax.brdfs._rgl_table import cumulative
from hshjax.metrics import with_channels

ELEVATIONS, AZIMUTHS = 192, 64
"""Vertices of the distributions."""

FLOOR = 1e-4
"""Of D, whose integral against the cosine is 1: a normal that nothing reflects from is tabulated too."""

STEPS = 6
"""Of power iteration: D need not be exact."""

LAST = np.radians(89.0)
"""Largest angle of incidence that is tabulated [radians]."""


def resampled(brdf: PairFunction, slices: int, size: int) -> dict[str, np.ndarray]:
    """The tables by name, `values` `(slices, channels, size, size)` for either name that channels may have; float32.

    Values [sr^-1, with the cosine of wo] are 0 where wo lies on or below the horizon, as ρ cos θ_o is on it. `filled`
    `(slices, size, size)`: where the BRDF has no value (see `known`) and that of the nearest place stands.

    **Raises:** ValueError for an anisotropic BRDF, values that are not finite, or an angle of incidence without any.
    """
    with jax.enable_x64(True):
        if not is_isotropic(brdf):
            raise ValueError("this writer is for isotropic BRDFs, and this one is not")
        theta = np.pi / 2 * np.linspace(0, 1, ELEVATIONS) ** 2
        ndf, sigma = _distribution(brdf, theta)
        theta_i = np.linspace(0, LAST, slices).astype(np.float32)
        densities = np.stack([_visible(ndf, theta, float(t)) for t in theta_i])
        s = np.linspace(0, 1, size)
        values, filled = [], []
        for t, density in zip(theta_i.astype(np.float64), densities.astype(np.float64), strict=True):
            u_theta, u_phi = sampled(density, s)
            value, missing = _slice(brdf, t, u_theta, u_phi, ndf, sigma)
            values.append(value)
            filled.append(missing)
    table = np.moveaxis(np.stack(values), -1, 1).astype(np.float32)
    luminance = np.maximum(table.mean(axis=1), 0)
    luminance += 1e-3 * luminance.mean(axis=(1, 2), keepdims=True) + np.finfo(np.float32).tiny
    return {
        "theta_i": theta_i,
        "sigma": np.stack([sigma, sigma]),
        "ndf": np.stack([ndf, ndf]),
        "vndf": densities[None],
        "luminance": luminance[None],
        "values": table[None],
        "filled": np.stack(filled),
    }


def _distribution(brdf: PairFunction, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """D and σ at elevations, float32, D with ∫ D cos θ dω = 1."""
    lit = np.minimum(theta, LAST)
    w = jnp.asarray(np.stack([np.sin(lit), np.zeros_like(lit), np.cos(lit)], axis=-1))
    value, there = map(np.asarray, _evaluate(brdf, w, w))
    if not there.any():
        raise ValueError("this BRDF has no value towards the light at any angle: fit its samples, and write the model")
    back = np.maximum(_finite(value, there, "towards the light"), 0).mean(axis=1) * np.cos(lit)
    back = np.interp(theta, theta[there], back[there])  # D need not be exact
    u = np.linspace(0, 1, theta.size)
    weight = 2 * np.pi**2 * u * np.sin(theta) * _trapezoid(theta.size)  # dω = 2π² u sin θ du dv
    azimuth = np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS
    cosines = np.zeros((theta.size, theta.size))  # mean over φ of max(m·ω, 0)
    for phi in azimuth:
        rim = np.outer(np.sin(theta), np.sin(theta)) * np.cos(phi)
        cosines += np.maximum(np.outer(np.cos(theta), np.cos(theta)) + rim, 0) / AZIMUTHS
    ndf = np.ones(theta.size)
    for _ in range(STEPS):
        ndf = back * (cosines @ (weight * ndf))
        ndf /= max(float(np.sum(weight * ndf * np.cos(theta))), float(np.finfo(np.float64).tiny))
    ndf = (ndf + FLOOR).astype(np.float32)
    return ndf, (cosines @ (weight * ndf)).astype(np.float32)


def _visible(ndf: np.ndarray, theta: np.ndarray, theta_i: float) -> np.ndarray:
    """Density of visible normals over u, `(azimuths, elevations)` float32, not normalised: D max(m·wi, 0) dω/du."""
    phi = np.linspace(-np.pi, np.pi, AZIMUTHS)[:, None]
    cosine = np.cos(theta) * np.cos(theta_i) + np.sin(theta) * np.sin(theta_i) * np.cos(phi)
    density = ndf * np.maximum(cosine, 0) * np.sqrt(2 / np.pi * theta) * np.sin(theta)
    # An azimuth without visible normals would have no place in the table.
    return (density / density.max() + 1e-7).astype(np.float32)


def sampled(density: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Elevation and azimuth u at every (row, column) of s in [0, 1]: the inverse of what `RGLTable` looks up by.

    `density` `(azimuths, elevations)`, bilinear; rows of the result have the CDF of the azimuth from `s`, columns that
    of the elevation given it.
    """
    rows, columns = density.shape
    conditional = cumulative(density)
    marginal = cumulative(conditional[:, -1])
    u_theta, u_phi = np.empty((2, s.size, s.size))
    for k, part in enumerate(s * marginal[-1]):
        j, y = _inverse(marginal, conditional[:, -1], np.array([part]))
        j, y = int(j[0]), float(y[0])
        line = (1 - y) * density[j] + y * density[j + 1]
        mass = (1 - y) * conditional[j] + y * conditional[j + 1]
        i, x = _inverse(mass, line, s * mass[-1])
        u_theta[k], u_phi[k] = (i + x) / (columns - 1), (j + y) / (rows - 1)
    return u_theta, u_phi


def _inverse(cumulative: np.ndarray, density: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cells and positions x in them, where a x + (b - a) x²/2 makes up what is missing."""
    cell = np.clip(np.searchsorted(cumulative, target, side="right") - 1, 0, cumulative.size - 2)
    missing, a, b = target - cumulative[cell], density[cell], density[cell + 1]
    root = a + np.sqrt(np.maximum(a * a + 2 * (b - a) * missing, 0))
    return cell, np.minimum(2 * missing / np.where(root > 0, root, 1), 1)


def _slice(
    brdf: PairFunction, theta_i: float, u_theta: np.ndarray, u_phi: np.ndarray, ndf: np.ndarray, sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """ρ cos θ_o 4 σ(wi) / D(m) at half vectors m, `(rows, columns, channels)`; and where ρ / D is that of a
    neighbour.
    """
    theta, phi = np.pi / 2 * u_theta**2, np.pi * (2 * u_phi - 1)
    m = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    wi = np.array([np.sin(theta_i), 0, np.cos(theta_i)])
    wo = 2 * (m @ wi)[..., None] * m - wi
    above = wo[..., 2] > 0
    wo = np.where(above[..., None], wo, [0, 0, 1])
    value, there = map(np.asarray, _evaluate(brdf, jnp.broadcast_to(jnp.asarray(wi), wo.shape), jnp.asarray(wo)))
    seen = above & there
    value = _finite(value, seen, f"at θ_i = {theta_i:.6g}")
    u = np.linspace(0, 1, ndf.size)
    scale = 4 * np.interp(np.sqrt(2 * theta_i / np.pi), u, sigma) / np.interp(u_theta, u, ndf)
    value = scale[..., None] * np.where(seen[..., None], value, 0)  # smooth: fit to be that of a neighbour
    missing = above & ~there
    if missing.any():
        if not seen.any():
            raise ValueError(f"this BRDF has no value at θ_i = {theta_i:.6g} rad: fit its samples, and write the model")
        from scipy.ndimage import distance_transform_edt

        rows, columns = np.asarray(distance_transform_edt(~seen, return_distances=False, return_indices=True))
        value = np.where(missing[..., None], value[rows, columns], value)
    return np.where(above, wo[..., 2], 0)[..., None] * value, missing


def _finite(value: np.ndarray, there: np.ndarray, where: str) -> np.ndarray:
    """The values, which must be finite `there`."""
    wrong = there[..., None] & ~np.isfinite(value)
    if wrong.any():
        raise ValueError(f"values must be finite, got {value[wrong][0]} {where}")
    return value


def _trapezoid(count: int) -> np.ndarray:
    weight = np.full(count, 1 / (count - 1))
    weight[[0, -1]] /= 2
    return weight


@eqx.filter_jit  # every slice has the same shape: one program
def _evaluate(
    brdf: PairFunction, wi: Float[Array, "*batch 3"], wo: Float[Array, "*batch 3"]
) -> tuple[Array, Bool[Array, " *batch"]]:
    """ρ with channels, and whether it is known."""
    there = known(brdf, wi.reshape(-1, 3), wo.reshape(-1, 3))
    return with_channels(brdf(wi, wo), wi.ndim - 1), there.reshape(wi.shape[:-1])
