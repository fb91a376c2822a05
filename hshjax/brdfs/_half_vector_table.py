"""Isotropic materials as a table over half and difference angles: what databases hold, and what is quick to look up."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._fields import floating
from hshjax._typing import Array, Bool, Float
from hshjax.bases import IdentityWarp
from hshjax.bases._half_vector import half_chart
from hshjax.brdfs._cells import GRAZING, Axis, arcs, cell, check_grid, interpolated, periodic_cell, root, walls
from hshjax.brdfs._tabulated import TabulatedBRDF
from hshjax.geometry import tilted
from hshjax.samples import Samples


class HalfVectorTable(TabulatedBRDF):
    """ρ at nodes (θ_h, θ_d, φ_d), multilinear between them in sqrt(θ_h), θ_d and φ_d.

    - `values` `(theta_h, theta_d, phi_d, channels)` [sr^-1, no cosine], at the nodes:
    - `theta_h`, `theta_d`: half and difference angle, rising, in [0, π/2], two or more of each; `phi_d`: azimuth of the
      difference vector, rising, in [0, π), one or more. All in radians. They are no parameters: their derivative is 0.

    A swap of wi and wo adds π to φ_d, and φ_d counts modulo π: reciprocal by construction, and isotropic; bilateral
    where the values at φ_d and π - φ_d are the same. Below the first node and beyond the last one of θ_h or θ_d the
    nearest one holds.

    Where θ_h or θ_d is 0, within rounding, φ_d means nothing and counts as 0, and the derivatives of both are 0. The
    table is continuous there if its values do not depend on φ_d: `settled` sees to it. Towards θ_h = 0 the slope grows
    as that of sqrt(θ_h) does.

    The grid of a MERL file is (i/90)² π/2, i degrees, i degrees: 90 x 90 x 180 nodes.

    - `measured`: optional, `(theta_h, theta_d, phi_d)`, which nodes hold a value. Of the others nothing is read:
      between nodes the weights of the measured ones are scaled to a sum of 1. Where a cell has none, and at a node that
      was not measured itself, whatever is around it, nothing is known and the BRDF is 0. "At" is up to 1/10000 of a
      cell, along each axis: rounding does not decide.

    **Raises:** ValueError for values that do not fit the nodes, or nodes out of order or range.

    Source: Rusinkiewicz, A New Change of Variables for Efficient BRDF Representation, EGWR 1998 (the coordinates).
    """

    values: Float[Array, "theta_h theta_d phi_d channels"] = eqx.field(converter=floating)
    theta_h: Float[Array, " theta_h"] = eqx.field(converter=floating)
    theta_d: Float[Array, " theta_d"] = eqx.field(converter=floating)
    phi_d: Float[Array, " phi_d"] = eqx.field(converter=floating)
    description: str = eqx.field(static=True, default="")
    channel_names: tuple[str, ...] = eqx.field(static=True, default=("R", "G", "B"))
    measured: Bool[Array, "theta_h theta_d phi_d"] | None = None

    def __check_init__(self):
        axes = {
            "theta_h": Axis(self.theta_h, np.pi / 2, closed=True),
            "theta_d": Axis(self.theta_d, np.pi / 2, closed=True),
            "phi_d": Axis(self.phi_d, np.pi, closed=False),
        }
        least = "two nodes along θ_h and θ_d and one along φ_d"
        check_grid(self.values, self.measured, self.channel_names, axes, least)

    def settled(self) -> "HalfVectorTable":
        """The same table with the mean over φ_d where θ_h or θ_d is 0, and φ_d means nothing; of measured nodes, if any
        is, and they all count as measured then.
        """
        nowhere = ((self.theta_h == 0)[:, None] | (self.theta_d == 0)[None])[..., None]
        if self.measured is None:
            values = jnp.where(nowhere[..., None], jnp.mean(self.values, axis=2, keepdims=True), self.values)
            return eqx.tree_at(lambda table: table.values, self, values)
        count = jnp.sum(self.measured, axis=2, keepdims=True).astype(self.values.dtype)[..., None]
        total = jnp.sum(jnp.where(self.measured[..., None], self.values, 0), axis=2, keepdims=True)
        values = jnp.where(nowhere[..., None], total / jnp.maximum(count, 1), self.values)
        measured = jnp.where(nowhere, jnp.any(self.measured, axis=2, keepdims=True), self.measured)
        return eqx.tree_at(lambda table: (table.values, table.measured), self, (values, measured))

    def node_samples(self, *, folded: bool = False) -> Samples:
        """The values at the nodes themselves, nothing interpolated, each weighted by the solid angle [sr²] of its cell.

        Nodes without a measurement, or with a direction on the horizon or below, are left out. A cell reaches halfway
        to the next nodes in sqrt(θ_h), θ_d and φ_d, to 0 and π/2 at the ends; its solid angle is that of

            dω_i dω_o = 4 cos θ_d dω_h dω_d,

        over all φ_h, and over φ_d and φ_d + π, which a swap of the directions cannot tell apart. So the weights of a
        fine table add up to (2π)²; cells that the horizon cuts are not cut. On the host, and not under `jax.jit`.

        `folded`: nodes at φ_d and π - φ_d become one sample, with the mean of their values and the sum of their
        weights. A bilateral function is the same at both: a fit of one has the same coefficients, from half as many
        samples, and a residual without what the two differ by.

        Source: Walter et al., Microfacet Models for Refraction through Rough Surfaces, EGSR 2007, Eq. 14 (the measure).
        """
        theta_h, theta_d, phi_d = (np.asarray(axis, np.float64) for axis in (self.theta_h, self.theta_d, self.phi_d))
        there, values = self._measured_on_host(), np.asarray(self.values)
        half, azimuth = solid_angles(theta_h, theta_d, phi_d)
        first, second, arcs = folded_azimuth(phi_d, azimuth) if folded else _alone(azimuth)
        share = there[..., first] * arcs[0]
        value = values[:, :, first]
        if folded:
            other = there[..., second] * arcs[1]
            both = share + other
            part = np.divide(other, both, out=np.zeros_like(both), where=both > 0)[..., None]
            value = np.where(part < 1, value, 0) * (1 - part) + np.where(part > 0, values[:, :, second], 0) * part
            share = both
        wi, wo = _node_directions(theta_h, theta_d, phi_d[first])
        used = (wi[..., 2] > GRAZING) & (wo[..., 2] > GRAZING) & (share > 0)
        weight = (half[..., None] * share)[used].astype(values.dtype)
        wi, wo = (w[used].astype(values.dtype, copy=False) for w in (wi, wo))
        value = value[used].astype(values.dtype, copy=False)
        return Samples.scattered(*map(jnp.asarray, (wi, wo, value, weight)), isotropic=True)

    def _measured_on_host(self) -> np.ndarray:
        return np.ones(self.values.shape[:3], bool) if self.measured is None else np.asarray(self.measured)

    def formula(self, wi, wo):
        batch = wi.shape[:-1]
        theta_h, theta_d, phi_d = half_difference_angles(wi.reshape(-1, 3), wo.reshape(-1, 3))
        half, difference, azimuth = jax.lax.stop_gradient((self.theta_h, self.theta_d, self.phi_d))
        ends = (
            cell(jnp.sqrt(half), root(theta_h)),
            cell(difference, theta_d),
            periodic_cell(azimuth, phi_d, np.pi),
        )
        return interpolated(self.values, self.measured, ends).reshape(*batch, self.values.shape[3])


def half_difference_angles(
    wi: Float[Array, "pairs 3"], wo: Float[Array, "pairs 3"]
) -> tuple[Float[Array, " pairs"], Float[Array, " pairs"], Float[Array, " pairs"]]:
    """(θ_h, θ_d, φ_d) [radians], φ_d modulo π, in [0, π): the inverse of `from_half_difference`.

    Where θ_h or θ_d is 0 within rounding, it is 0 with derivative 0, and so is φ_d.
    """
    chart = half_chart(IdentityWarp(), wi, wo)
    tiny = float(jnp.finfo(wi.dtype).eps) ** 2
    nowhere = (chart.u <= tiny) | (chart.v <= tiny)
    # A factor that the angle does not depend on, and its derivative neither: (u v)² is too small for float32.
    scale = jax.lax.stop_gradient(1 / jnp.where(nowhere, 1, chart.u * chart.v))
    cos, sin = (jnp.where(nowhere, pole, scale * part) for part, pole in zip(chart.turn, (1, 0), strict=True))
    twice = jnp.arctan2(sin, cos)
    return _angle(chart.u, tiny), _angle(chart.v, tiny), jnp.where(twice < 0, twice / 2 + jnp.pi, twice / 2)


def _node_directions(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """wi and wo, `(theta_h, theta_d, phi_d, 3)`, of the nodes, φ_h = 0: as `from_half_difference`, but of three axes,
    whose sines are so many fewer.
    """
    h, d, f = theta_h[:, None, None], theta_d[None, :, None], phi_d[None, None, :]
    x, y, z = np.sin(d) * np.cos(f), np.sin(d) * np.sin(f), np.cos(d)
    out = np.empty((2, theta_h.size, theta_d.size, phi_d.size, 3))
    for w, sign in zip(out, (1, -1), strict=True):
        w[..., 0], w[..., 1], w[..., 2] = tilted(np.cos(h), np.sin(h), sign * x, sign * y, z)
    return out[0], out[1]


def solid_angles(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the cells, as factors `(theta_h, theta_d)` and `(phi_d,)`, their product in sr²: see `node_samples`."""
    half = -np.diff(np.cos(walls(np.sqrt(theta_h), float(np.sqrt(np.pi / 2))) ** 2))
    difference = 2 * np.diff(np.sin(walls(theta_d, np.pi / 2)) ** 2)
    # 2π for φ_h; twice, for φ_d and for φ_d + π.
    return 2 * np.pi * half[:, None] * difference, 2 * arcs(phi_d, np.pi)


class FoldedAzimuth(NamedTuple):
    """Nodes of φ_d and of π - φ_d, which are one sample: their indices, and their `arcs`, 0 of what has no other."""

    first: np.ndarray
    second: np.ndarray
    arcs: np.ndarray


def folded_azimuth(phi_d: np.ndarray, arcs: np.ndarray) -> FoldedAzimuth:
    """Every node once, with its arc [radians]."""
    mirrored = _mirrored(phi_d)
    first = np.flatnonzero(mirrored >= np.arange(phi_d.size))
    second = mirrored[first]
    return FoldedAzimuth(first, second, np.stack([arcs[first], np.where(second == first, 0, arcs[second])]))


def _alone(arcs: np.ndarray) -> FoldedAzimuth:
    own = np.arange(arcs.size)
    return FoldedAzimuth(own, own, np.stack([arcs, np.zeros_like(arcs)]))


def _mirrored(phi_d: np.ndarray) -> np.ndarray:
    """The index of π - φ_d modulo π; where there is no such node, the node's own."""
    own = np.arange(phi_d.size)
    gap = np.abs((phi_d[:, None] + phi_d + np.pi / 2) % np.pi - np.pi / 2)
    nearest = np.argmin(gap, axis=1)
    return np.where(gap[own, nearest] < 1e-5, nearest, own)


def _angle(o: Float[Array, " n"], tiny: float) -> Float[Array, " n"]:
    """θ of o = 1 - cos θ."""
    tilted = o > tiny
    safe = jnp.where(tilted, o, 1)
    return jnp.where(tilted, jnp.arctan2(jnp.sqrt(safe * (2 - safe)), 1 - safe), 0)
