"""What the studies of the paper's claims share: its two BRDFs, the rival bases, slices, and the look of plots."""

import math
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from hshjax import HSH, SHR, AbstractBasis, AbstractBRDF, CookTorrance, OrenNayar, SphericalHarmonics, Zernike
from hshjax.geometry import direction
from hshjax.quadrature import graded_azimuths, polar_nodes

BASES: dict[str, type[AbstractBasis]] = {"HSH": HSH, "Zernike": Zernike, "SHR": SHR, "SH": SphericalHarmonics}

# Okabe and Ito's colours, told apart under every common colour blindness; markers tell them apart in grey.
GREEN, RED, BLUE, ORANGE, PURPLE = "#009E73", "#D55E00", "#0072B2", "#E69F00", "#CC79A7"
LOOK = {
    "HSH": {"color": RED, "marker": "o", "linestyle": "-"},
    "Zernike": {"color": BLUE, "marker": "s", "linestyle": "-"},
    "SHR": {"color": GREEN, "marker": "^", "linestyle": "--"},
    "SH": {"color": PURPLE, "marker": "v", "linestyle": ":"},
}

PAPER_BRDFS = ("CT_spec_Fconst", "OrenNayar_s0.3")
TITLES = {"CT_spec_Fconst": "Cook-Torrance", "OrenNayar_s0.3": "Oren-Nayar"}


def paper_brdf(name: str) -> AbstractBRDF:
    """The two surfaces that the paper validates on: the specular lobe of its Fig. 2 (F = 1), and Oren-Nayar, sigma 0.3.

    Relative errors do not depend on the scale of a BRDF, so that neither the factor 4 between the paper's lobe and this
    one nor the albedo matters.
    """
    if name == "CT_spec_Fconst":
        return CookTorrance(diffuse=0.0, specular=0.458, slope=0.125)
    return OrenNayar(albedo=1.0, sigma=0.3)


@dataclass(frozen=True)
class Slice:
    """wo -> ρ(wi, wo) at one incidence (θ_i, φ_i = 0) of an isotropic, bilateral BRDF. Host arrays, float64.

    - `z`, `dz`: nodes in cos θ_o and weights.
    - `components`: `(order + 1, nodes)`, ρ = Σ_m components[m] cos(m φ) + rest.
    - `power`: `(nodes,)`, ∫ ρ² dφ.
    """

    z: np.ndarray
    dz: np.ndarray
    components: np.ndarray
    power: np.ndarray

    @classmethod
    def of(cls, brdf: AbstractBRDF, theta_i: float, order: int, *, polar: int, levels: int) -> "Slice":
        """Tabulate `brdf`, channel 0, on `polar` elevations x azimuths refined `levels` times towards 0 and π."""
        z, dz = polar_nodes(polar - 1, sqrt=True)
        phi, dphi = graded_azimuths(levels, order)
        wo = direction(jnp.asarray(np.arccos(z))[:, None], jnp.asarray(phi)[None, :])
        value = np.asarray(brdf(_incident(theta_i), wo)[..., 0], np.float64)
        analysis = np.cos(np.outer(np.arange(order + 1), phi)) * dphi / np.pi
        analysis[0] /= 2
        return cls(z, dz, analysis @ value.T, value**2 @ dphi)

    @property
    def azimuthal_norm(self) -> np.ndarray:
        """∫ cos²(m φ) dφ for every m."""
        return np.pi * np.where(np.arange(len(self.components)) == 0, 2, 1)


@dataclass(frozen=True)
class Plane:
    """The incident plane: signed angles [radians], φ = 0 for θ > 0 and φ = π for θ < 0, weights dθ, and ρ there."""

    theta: np.ndarray
    dtheta: np.ndarray
    value: np.ndarray

    @classmethod
    def of(cls, brdf: AbstractBRDF, theta_i: float, *, limit: float, nodes: int) -> "Plane":
        """Gauss nodes over |θ_o| <= limit [radians], `nodes` on either side."""
        # v² from the limit inwards: nodes crowd where HSH fall to zero like a square root.
        v, dv = np.polynomial.legendre.leggauss(nodes)
        v, dv = (v + 1) / 2, dv / 2
        theta, dtheta = limit * (1 - v**2), limit * 2 * v * dv
        theta, dtheta = np.r_[theta, -theta], np.r_[dtheta, dtheta]
        value = np.asarray(brdf(_incident(theta_i), plane_directions(theta))[..., 0], np.float64)
        return cls(theta, dtheta, value)


def _incident(theta_i: float):
    return direction(jnp.asarray(theta_i), jnp.asarray(0.0))


def plane_directions(theta: np.ndarray):
    """Directions `(*batch, 3)` in the incident plane at signed angles [radians]; negative: away from the light."""
    return direction(jnp.asarray(np.abs(theta)), jnp.asarray(np.where(theta < 0, np.pi, 0.0)))


def bilateral_rows(basis: AbstractBasis, w) -> np.ndarray:
    """The columns with m >= 0 at directions `(n, 3)`, all that a function even in φ needs."""
    return np.asarray(basis(w), np.float64)[:, np.array(basis.modes)[:, 1] >= 0]


def bilateral_modes(basis: AbstractBasis) -> np.ndarray:
    """(n, m) of those columns, `(columns, 2)`."""
    modes = np.array(basis.modes)
    return modes[modes[:, 1] >= 0]


def project_slice(basis: AbstractBasis, slice_: Slice) -> tuple[np.ndarray, np.ndarray]:
    """The slice's inner products with the functions m >= 0 for dω, and those functions at φ = 0, `(nodes, columns)`.

    The inner products are the coefficients of the best fit for an orthonormal basis, and for `SphericalHarmonics` those
    of the slice extended by zero below the horizon.
    """
    functions = bilateral_rows(basis, direction(jnp.asarray(np.arccos(slice_.z)), jnp.zeros(slice_.z.size)))
    m = bilateral_modes(basis)[:, 1]
    inner = slice_.azimuthal_norm[m] * np.einsum("zk,z,kz->k", functions, slice_.dz, slice_.components[m])
    return inner, functions


def hemisphere_errors(basis: AbstractBasis, slice_: Slice) -> np.ndarray:
    """Relative L2 errors for dω of the projections of orders 0 ... basis.order."""
    modes = bilateral_modes(basis)
    coefficients, functions = project_slice(basis, slice_)
    energy = slice_.power @ slice_.dz
    norms = slice_.azimuthal_norm[:, None] * slice_.dz
    # What the components up to the order of the table do not hold is an error at every order.
    rest = max(energy - np.sum(norms * slice_.components**2), 0.0)
    residual, errors = slice_.components.copy(), []
    for n in range(basis.order + 1):
        for k in np.flatnonzero(modes[:, 0] == n):
            residual[modes[k, 1]] -= coefficients[k] * functions[:, k]
        errors.append(math.sqrt((np.sum(norms * residual**2) + rest) / energy))
    return np.array(errors)


def plane_errors(basis: AbstractBasis, slice_: Slice, plane: Plane) -> np.ndarray:
    """Relative L2 errors for dθ in the incident plane of the same projections (fitted for dω on the hemisphere)."""
    order = bilateral_modes(basis)[:, 0]
    coefficients = project_slice(basis, slice_)[0]
    terms = bilateral_rows(basis, plane_directions(plane.theta)) * coefficients
    energy = plane.dtheta @ plane.value**2
    fits = (terms[:, order <= n].sum(axis=1) for n in range(basis.order + 1))
    return np.array([math.sqrt(plane.dtheta @ (plane.value - fit) ** 2 / energy) for fit in fits])


def bilateral_count(basis: AbstractBasis) -> int:
    """Number of functions that a slice of a bilateral BRDF uses."""
    return len(bilateral_modes(basis))


def ranges(numbers: list[int]) -> str:
    """[0, 1, 2, 5] as "0–2, 5"; "none" for nothing."""
    runs: list[list[int]] = []
    for n in sorted(numbers):
        if runs and n == runs[-1][-1] + 1:
            runs[-1].append(n)
        else:
            runs.append([n])
    return ", ".join(f"{run[0]}–{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs) or "none"


def plain(axes) -> None:
    """Axes without the upper and right frame, with a faint grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True, color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
