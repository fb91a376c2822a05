"""Materials as a table over the angles of both directions: what goniometers sample on a grid."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._fields import floating
from hshjax._typing import Array, Bool, Float
from hshjax.brdfs._cells import GRAZING, Axis, arcs, cell, check_grid, interpolated, periodic_cell, walls
from hshjax.brdfs._tabulated import TabulatedBRDF
from hshjax.geometry import direction
from hshjax.samples import Samples


class AngleTable(TabulatedBRDF):
    """ρ at nodes (θ_i, φ_i, θ_o, φ_o), multilinear between them, periodic in both azimuths: anisotropic.

    - `values` `(theta_i, phi_i, theta_o, phi_o, channels)` [sr^-1, no cosine], at the nodes:
    - `theta_i`, `theta_o`: from the normal, rising, in [0, π/2], two or more; `phi_i`, `phi_o`: from +x, rising, in
      [0, 2π), one or more. All in radians. They are no parameters: their derivative is 0.
    - `measured`: optional, `values` without channels, which nodes hold a value; between nodes the weights of the
      measured ones are scaled to a sum of 1. Where a cell has none, and at a node that was not measured (up to 1/10000
      of a cell), nothing is known and the BRDF is 0.

    Beyond the first and last elevation the nearest one holds: the BRDF is constant there, which a line through the last
    two nodes would soon take below 0. At the normal, within rounding, φ counts as 0 and derivatives are 0. The values
    are as measured, not reciprocal but by chance.

    **Raises:** ValueError for values that do not fit the nodes, or nodes out of order or range.
    """

    values: Float[Array, "theta_i phi_i theta_o phi_o channels"] = eqx.field(converter=floating)
    theta_i: Float[Array, " theta_i"] = eqx.field(converter=floating)
    phi_i: Float[Array, " phi_i"] = eqx.field(converter=floating)
    theta_o: Float[Array, " theta_o"] = eqx.field(converter=floating)
    phi_o: Float[Array, " phi_o"] = eqx.field(converter=floating)
    description: str = eqx.field(static=True, default="")
    channel_names: tuple[str, ...] = eqx.field(static=True, default=("R", "G", "B"))
    measured: Bool[Array, "theta_i phi_i theta_o phi_o"] | None = None

    def __check_init__(self):
        axes = {
            "theta_i": Axis(self.theta_i, np.pi / 2, closed=True),
            "phi_i": Axis(self.phi_i, 2 * np.pi, closed=False),
            "theta_o": Axis(self.theta_o, np.pi / 2, closed=True),
            "phi_o": Axis(self.phi_o, 2 * np.pi, closed=False),
        }
        least = "two nodes along θ_i and θ_o and one along φ_i and φ_o"
        check_grid(self.values, self.measured, self.channel_names, axes, least)

    def node_samples(self) -> Samples:
        """The values at the nodes themselves, nothing interpolated, each weighted by the solid angle [sr²] of its cell.

        Nodes without a measurement, or with a direction on the horizon, are left out. A cell reaches halfway to the
        next nodes, to the normal, and beyond the last elevation as far as before it, but not below the horizon. On the
        host, and not under `jax.jit`.
        """
        sides, solid = [], []
        for theta, phi in ((self.theta_i, self.phi_i), (self.theta_o, self.phi_o)):
            theta, phi = np.asarray(theta, np.float64), np.asarray(phi, np.float64)
            end = min(np.pi / 2, theta[-1] + (theta[-1] - theta[-2]) / 2)
            solid.append(np.outer(-np.diff(np.cos(walls(theta, end))), arcs(phi, 2 * np.pi)))
            sin = np.sin(theta)[:, None]
            z = np.broadcast_to(np.cos(theta)[:, None], (theta.size, phi.size))
            sides.append(np.stack([sin * np.cos(phi), sin * np.sin(phi), z], axis=-1))
        used = (sides[0][..., 2] > GRAZING)[:, :, None, None] & (sides[1][..., 2] > GRAZING)
        if self.measured is not None:
            used &= np.asarray(self.measured)
        i, p, o, q = np.nonzero(used)
        dtype = self.values.dtype
        weight = (solid[0][i, p] * solid[1][o, q]).astype(dtype)
        wi, wo = sides[0][i, p].astype(dtype), sides[1][o, q].astype(dtype)
        return Samples.scattered(*map(jnp.asarray, (wi, wo, np.asarray(self.values)[used], weight)))

    def formula(self, wi, wo):
        batch = wi.shape[:-1]
        theta_i, phi_i, theta_o, phi_o = jax.lax.stop_gradient((self.theta_i, self.phi_i, self.theta_o, self.phi_o))
        ends = []
        for w, theta, phi in ((wi, theta_i, phi_i), (wo, theta_o, phi_o)):
            elevation, azimuth = _angles(w.reshape(-1, 3))
            ends += [cell(theta, elevation), periodic_cell(phi, azimuth, 2 * np.pi)]
        return interpolated(self.values, self.measured, ends).reshape(*batch, self.values.shape[-1])


def _angles(w: Float[Array, "n 3"]) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """θ, and φ in [0, 2π) up to rounding; both 0 with derivative 0 at the pole."""
    at_pole = (w[:, 0] ** 2 + w[:, 1] ** 2 <= float(jnp.finfo(w.dtype).eps) ** 2)[:, None]
    w = jnp.where(at_pole, direction(jnp.asarray(1, w.dtype), jnp.asarray(0, w.dtype)), w)
    phi = jnp.arctan2(w[:, 1], w[:, 0])
    theta = jnp.arctan2(jnp.sqrt(w[:, 0] ** 2 + w[:, 1] ** 2), w[:, 2])
    return jnp.where(at_pole[:, 0], 0, theta), jnp.where(at_pole[:, 0], 0, jnp.where(phi < 0, phi + 2 * jnp.pi, phi))
