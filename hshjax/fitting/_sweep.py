"""The error of every order at once, for isotropic reciprocal bases.

An isotropic BRDF on a grid (z_i, z_o, Δφ) splits into cos(m Δφ) components F_m(z_i, z_o), and the least-squares
problem splits with it: for each m, F_m against P A Pᵀ with the radial functions P of that m. With Q an orthonormal
basis of the weighted columns of P, the optimum is Q Qᵀ F_m Q Qᵀ, and since the columns of a lower order come first,
the optimum of every order is a leading block of one matrix QᵀF_mQ. A sweep costs as much as its largest order, and
that is a few products of small matrices.
"""

import math
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import PairFunction
from hshjax.bases import AbstractBasis
from hshjax.fitting._norms import named_norm
from hshjax.geometry import direction
from hshjax.quadrature import graded_azimuths, polar_nodes


@dataclass(frozen=True)
class IsotropicTable:
    """An isotropic BRDF by azimuthal components on a Gauss-Legendre grid in (z_i, z_o). Host arrays, float64.

    - `z`, `dz`: nodes in (cos max_theta, 1) and weights. - `components`: `(order + 1, z_i, z_o, channels)` with
      ρ = Σ_m components[m] cos(m Δφ) + (what is above the order or not bilateral).
    - `power`: `(z_i, z_o, channels)`, ∫ ρ² dΔφ.
    """

    z: np.ndarray
    dz: np.ndarray
    components: np.ndarray
    power: np.ndarray
    max_theta: float

    @classmethod
    def from_brdf(
        cls, brdf: PairFunction, order: int, *, max_theta: float = math.pi / 2, polar: int = 128, levels: int = 8
    ) -> "IsotropicTable":
        """Evaluate `brdf` at `polar`² pairs of elevations x a rule in Δφ, refined `levels` times towards 0 and π.

        A specular lobe narrows in azimuth like its width times (z_i + z_o): equispaced azimuths miss it at grazing.
        The grid must resolve the BRDF: compare the errors with those of a finer one.
        """
        z, dz = polar_nodes(
            polar - 1, sqrt=True
        )  # denser at grazing, where Cook-Torrance and Oren-Nayar are not smooth
        # A range that ends at θ_max gets nodes of its own: a cut through a grid would cost accuracy.
        edge = math.cos(max_theta)
        z, dz = edge + (1 - edge) * z, (1 - edge) * dz
        phi, dphi = graded_azimuths(levels, order)
        analysis = np.cos(np.outer(phi, np.arange(order + 1))) * dphi[:, None] / np.pi
        analysis[:, 0] /= 2

        theta = np.arccos(z)
        wo = direction(jnp.asarray(theta)[:, None], jnp.asarray(phi)[None, :])
        call = eqx.filter_jit(lambda brdf, wi: brdf(wi, wo))
        components, power = [], []
        for theta_i in theta:  # one incidence at a time: bounded memory
            value = np.asarray(call(brdf, direction(jnp.asarray(theta_i), jnp.asarray(0.0))), np.float64)
            value = value.reshape(polar, phi.size, -1)
            components.append(np.einsum("oac,am->moc", value, analysis, optimize=True))
            power.append(np.einsum("oac,a->oc", value**2, dphi, optimize=True))
        return cls(z, dz, np.stack(components, axis=1), np.stack(power), max_theta)


def order_sweep(basis: AbstractBasis, table: IsotropicTable, norm: str = "D") -> np.ndarray:
    """Relative errors `(order + 1, channels)` of the reciprocal, bilateral, isotropic fit at orders 0 ... basis.order.

    What `project(IsotropicBasis(type(basis)(n)), ...)` reports for every n, at the cost of one. Parts of the BRDF that
    are not reciprocal or not bilateral count as error, as they do there.

    `norm`: A-E, see `NORMS`. For `SphericalHarmonics` the projections B, C, D are those of the BRDF extended by zero
    below the horizon, so that their errors need not fall with the order as fast as the approximation allows.

    **Raises:** ValueError for an unknown norm, a table of another range of angles, or a table of a lower order.
    """
    judge = named_norm(norm)
    if not math.isclose(judge.max_theta, table.max_theta):
        raise ValueError(f"norm {norm} needs a table with max_theta = {judge.max_theta:.4f}, got {table.max_theta:.4f}")
    if table.components.shape[0] <= basis.order:
        raise ValueError(f"the table holds orders up to {table.components.shape[0] - 1}, {basis} needs {basis.order}")

    z = table.z
    target = np.multiply.outer(z, z) ** judge.exponent
    root = np.sqrt(table.dz * z**judge.fit)
    rejudge = np.multiply.outer(z, z) ** ((judge.judge_series - judge.fit) / 2)
    measure = np.multiply.outer(root, root) * rejudge * target  # takes ρ to the judged, weighted series
    energy = 2 * np.pi * np.einsum("io,ioc->c", measure**2, table.power)

    channels = energy.size
    rest, error = energy.copy(), np.zeros((basis.order + 1, channels))
    for m, (orders, functions) in enumerate(_radial_functions(basis, z)):
        azimuth = (2 * np.pi) ** 2 * (0.5 if m else 1.0)
        columns = root[:, None] * functions
        # Flat weights leave the columns as they are: the coefficients are the inner products that the norm asks for.
        columns = columns * np.sqrt(np.pi * (1 if m else 2)) if judge.fit == 0 else np.linalg.qr(columns)[0]
        sizes = np.searchsorted(orders, np.arange(basis.order + 1), side="right")
        for c in range(channels):
            weighted = root[:, None] * (target * table.components[m, :, :, c]) * root[None, :]
            core = columns.T @ weighted @ columns
            core = (core + core.T) / 2
            # The energy of cos(m Δφ) leaves the rest, and comes back as the residual of each order.
            rest[c] -= azimuth * np.sum((rejudge * weighted) ** 2)
            for n, k in enumerate(sizes):
                q = columns[:, :k]
                error[n, c] += azimuth * np.sum((rejudge * (weighted - q @ core[:k, :k] @ q.T)) ** 2)
    # The rest is a difference of equal sums where the BRDF has no other components: rounding may leave it negative.
    # A black channel is met exactly.
    return np.sqrt((error + np.maximum(rest, 0)) / np.where(energy > 0, energy, 1))


def _radial_functions(basis: AbstractBasis, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """For every m >= 0 the orders n and the functions at φ = 0, `(nodes, degrees)`."""
    meridian = direction(jnp.asarray(np.arccos(z)), jnp.zeros(z.size))
    rows = np.asarray(basis(meridian), np.float64)
    modes = np.array(basis.modes)
    picks = [modes[:, 1] == m for m in range(basis.order + 1)]
    return [(modes[pick, 0], rows[:, pick]) for pick in picks]
