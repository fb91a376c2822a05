"""Materials of the RGL database: tables in a parameterisation that adapts to the material."""

import operator
from collections.abc import Iterable
from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float, Int, Real
from hshjax.brdfs._cells import cell
from hshjax.brdfs._tabulated import TabulatedBRDF


class RGLTable(TabulatedBRDF):
    """ρ cos θ_o = f(s; θ_i) D(u_h) / (4 σ(u_i)),   s = the distribution of visible normals, inverted at u_h.

    u = (sqrt(2 θ/π), (φ + π)/(2π)); u_h takes φ_h - φ_i where the material is isotropic. D is the distribution of
    normals, σ its projected area. s in [0, 1]² is (CDF of θ_h given φ_h, CDF of φ_h) under the distribution of visible
    normals at θ_i, so that highlights of any width fill the table f. Tables are bilinear over [0, 1]², linear in θ_i.

    With `phi_i`, slices are those of every φ_i, θ_i after θ_i, and tables are linear in φ_i as well, the last one
    holding beyond either end. More than two azimuths make the material anisotropic: u_h takes φ_h itself. If they span
    half a turn, from -π on, the material is taken to be unchanged by half a turn; if a quarter, by a mirror in x and
    one in y: pairs are brought to where the tables are.

    Directions within rounding of the pole count as the pole, with azimuth and derivative 0. Directions that were not
    measured (grazing ones above all) are extrapolated by the database.

    Build it with `from_tables`. Last axes of tables: (azimuth, elevation); `values` [sr^-1, with the cosine of wo].

    **Raises:** ValueError for tables that do not fit each other: lookups past an end would be clamped, not told.

    Source: Dupuy and Jakob, An Adaptive Parameterization for Efficient Material Acquisition and Rendering, ACM TOG
    37(6), 2018. That wi is the direction of incidence of the tables, and what the span of φ_i means, was settled
    against Mitsuba 3 (`measured`).
    """

    theta_i: Float[Array, " incidences"]
    sigma: Float[Array, "sigma_azimuths sigma_elevations"]
    ndf: Float[Array, "ndf_azimuths ndf_elevations"]
    density: Float[Array, "slices azimuths elevations"]
    conditional: Float[Array, "slices azimuths elevations"]
    row: Float[Array, "slices azimuths"]
    marginal: Float[Array, "slices azimuths"]
    values: Float[Array, "slices channels rows columns"]
    description: str = eqx.field(static=True, default="")
    channel_names: tuple[str, ...] = eqx.field(static=True, default=("R", "G", "B"))
    unmeasured: int | None = eqx.field(static=True, default=None)
    """Entries of one channel of `values` that the database filled in (its `valid` mask); None if it does not say."""
    phi_i: Float[Array, " turns"] | None = None

    def __check_init__(self):
        slices, azimuths, elevations = self.density.shape
        rows, columns = self.values.shape[-2:]
        turns = 1 if self.phi_i is None else self.phi_i.size
        if self.phi_i is not None and turns < 2:
            raise ValueError("phi_i of a table holds two azimuths or more; None for one")
        expected = {
            "theta_i": (slices // turns if slices % turns == 0 else -1,),
            "conditional": (slices, azimuths, elevations),
            "row": (slices, azimuths),
            "marginal": (slices, azimuths),
            "values": (slices, len(self.channel_names), rows, columns),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"{name} of a table of {slices} slices must have shape {shape}, got {getattr(self, name).shape}"
                )
        if min(self.theta_i.size, azimuths, elevations, rows, columns, *self.sigma.shape, *self.ndf.shape) < 2:
            raise ValueError("tables need two entries along every axis to interpolate between")

    @classmethod
    def from_tables(
        cls,
        theta_i: np.ndarray,
        sigma: np.ndarray,
        ndf: np.ndarray,
        vndf: np.ndarray,
        values: np.ndarray,
        *,
        description: str = "",
        channel_names: tuple[str, ...] = ("R", "G", "B"),
        unmeasured: int | None = None,
        phi_i: np.ndarray | None = None,
    ) -> "RGLTable":
        """The tables as the files hold them, φ_i and θ_i in one axis of slices: vndf `(slices, azimuths, elevations)`
        need not be normalised. `phi_i` of one azimuth, or None: isotropic. CDFs are summed on the host in float64 and
        kept in the default float of the caller's configuration.
        """
        density = np.asarray(vndf, np.float64)
        conditional = cumulative(density)
        marginal = cumulative(conditional[..., -1])
        total = marginal[:, -1]
        dtype = jnp.result_type(float)
        return cls(
            theta_i=jnp.asarray(theta_i, dtype),
            sigma=jnp.asarray(sigma, dtype),
            ndf=jnp.asarray(ndf, dtype),
            density=jnp.asarray(density / total[:, None, None], dtype),
            conditional=jnp.asarray(conditional / total[:, None, None], dtype),
            row=jnp.asarray(conditional[..., -1] / total[:, None], dtype),
            marginal=jnp.asarray(marginal / total[:, None], dtype),
            values=jnp.asarray(values, dtype),
            description=description,
            channel_names=channel_names,
            unmeasured=unmeasured,
            phi_i=None if phi_i is None or np.size(phi_i) == 1 else jnp.asarray(phi_i, dtype),
        )

    @property
    def _relative(self) -> bool:
        """Whether azimuths of the half vector count from that of wi."""
        return self.phi_i is None or self.phi_i.size <= 2

    def formula(self, wi, wo):
        shape = wi.shape[:-1]
        wi, wo = self._brought(wi.reshape(-1, 3), wo.reshape(-1, 3))
        h = wi + wo  # not normalised: only its angles are used
        x_axis = jnp.zeros_like(wi).at[:, 0].set(1)
        slices = self._slices(wi)
        u_i = jnp.stack([_elevation(wi), _azimuth(x_axis, wi)], axis=-1)
        u_h = jnp.stack([_elevation(h), _azimuth(wi if self._relative else x_axis, h)], axis=-1)
        s = self._invert(u_h, slices)
        jacobian = _bilinear(self.ndf[None], u_h) / (4 * _bilinear(self.sigma[None], u_i))
        value = _total(part[:, None] * _bilinear(self.values, s, slice_) for slice_, part in slices)
        return (value * jacobian / wo[:, 2:]).reshape(*shape, value.shape[-1])

    def _brought(self, wi: Float[Array, "n 3"], wo: Float[Array, "n 3"]) -> tuple[Array, Array]:
        """The pair turned or mirrored to where wi lies within the azimuths of the tables."""
        if self.phi_i is None:
            return wi, wo
        span = jax.lax.stop_gradient(self.phi_i[-1] - self.phi_i[0])
        parts = jnp.round(2 * jnp.pi / span)
        above, right = (jnp.where(wi[:, k] >= 0, -1, 1).astype(wi.dtype) for k in (1, 0))
        x, y = jnp.where(parts == 4, right, above), above
        x, y = (jnp.where(parts >= 2, sign, 1) for sign in (x, y))
        signs = jnp.stack([x, y, jnp.ones_like(x)], axis=-1)
        return signs * wi, signs * wo

    def _slices(self, wi: Float[Array, "n 3"]) -> list[tuple[Int[Array, " n"], Float[Array, " n"]]]:
        """The slices between which wi lies, with their weights."""
        at_pole = _at_pole(wi)
        theta = jnp.where(at_pole, 0, jnp.arctan2(jnp.sqrt(jnp.where(at_pole, 1, _rim_square(wi))), wi[:, 2]))
        elevations = cell(self.theta_i, theta)
        if self.phi_i is None:
            return list(elevations)
        phi = jnp.where(at_pole, 0, jnp.arctan2(jnp.where(at_pole, 0, wi[:, 1]), jnp.where(at_pole, 1, wi[:, 0])))
        count = self.theta_i.size
        return [(p * count + t, at_p * at_t) for p, at_p in cell(self.phi_i, phi) for t, at_t in elevations]

    def _invert(
        self, u: Float[Array, "n 2"], slices: list[tuple[Int[Array, " n"], Float[Array, " n"]]]
    ) -> Float[Array, "n 2"]:
        """(CDF of elevation given azimuth, CDF of azimuth) of a density that is bilinear between its vertices."""
        azimuths, elevations = self.density.shape[1:]
        i, x = _cell(u[:, 0], elevations)
        j, y = _cell(u[:, 1], azimuths)

        def between_slices(table, *index):
            return _total(part * table[(slice_, *index)] for slice_, part in slices)

        def between_rows(table, *index):
            return (1 - y) * between_slices(table, j, *index) + y * between_slices(table, j + 1, *index)

        # Inside a cell the density is linear, its integral the quadratic a x + (b - a) x²/2.
        left, right = between_rows(self.density, i), between_rows(self.density, i + 1)
        mass, row = between_rows(self.conditional, i) + x * (left + x / 2 * (right - left)), between_rows(self.row)
        lower, upper = between_slices(self.row, j), between_slices(self.row, j + 1)
        in_azimuth = between_slices(self.marginal, j) + y * (lower + y / 2 * (upper - lower))
        # An azimuth without visible normals has no conditional distribution; its neighbours end at 0 there.
        in_elevation = jnp.where(row > 0, mass / jnp.where(row > 0, row, 1), 0)
        return jnp.clip(jnp.stack([in_elevation, in_azimuth], axis=-1), 0, 1)


def _total(parts: Iterable[Real]) -> Real:
    return reduce(operator.add, parts)  # `sum` begins with the integer 0


def cumulative(density: np.ndarray) -> np.ndarray:
    """Trapezoid sums along the last axis, unit spacing, beginning at 0."""
    out = np.zeros(density.shape)
    np.cumsum((density[..., 1:] + density[..., :-1]) / 2, axis=-1, out=out[..., 1:])
    return out


def _rim_square(w: Float[Array, "n 3"]) -> Float[Array, " n"]:
    return w[:, 0] ** 2 + w[:, 1] ** 2


def _at_pole(w: Float[Array, "n 3"]) -> Bool[Array, " n"]:
    """Within rounding of the normal. There the angles have no derivative (1/|rim| would become NaN)."""
    return _rim_square(w) <= float(jnp.finfo(w.dtype).eps) ** 2


def _elevation(w: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """sqrt(2 θ/π), by arctan2: accurate near the pole, where arccos is not; w of any length."""
    at_pole = _at_pole(w)
    theta = jnp.arctan2(jnp.sqrt(jnp.where(at_pole, 1, _rim_square(w))), w[:, 2])
    return jnp.where(at_pole, 0, jnp.sqrt(2 / jnp.pi * theta))


def _azimuth(origin: Float[Array, "n 3"], w: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """(φ + π)/(2π), φ the azimuth of w seen from that of `origin`: one arctan2, hence already wrapped."""
    at_pole = _at_pole(origin) | _at_pole(w)
    cos = jnp.where(at_pole, 1, origin[:, 0] * w[:, 0] + origin[:, 1] * w[:, 1])
    sin = jnp.where(at_pole, 0, origin[:, 0] * w[:, 1] - origin[:, 1] * w[:, 0])
    return (jnp.arctan2(sin, cos) + jnp.pi) / (2 * jnp.pi)


def _cell(u: Float[Array, " n"], vertices: int) -> tuple[Int[Array, " n"], Float[Array, " n"]]:
    """The interval of [0, 1] that holds u, among `vertices` equispaced ones, and the position within it."""
    x = u * (vertices - 1)
    index = jnp.clip(jnp.floor(x).astype(jnp.int32), 0, vertices - 2)
    return index, x - index.astype(x.dtype)


def _bilinear(
    table: Real, u: Float[Array, "n 2"], slice_: Int[Array, " n"] | None = None
) -> Float[Array, "n channels"]:
    """Slice `slice_` of `(slices, channels, azimuth, elevation)`, or `(channels, azimuth, elevation)`, at u."""
    i, x = (a[:, None] for a in _cell(u[:, 0], table.shape[-1]))
    j, y = (a[:, None] for a in _cell(u[:, 1], table.shape[-2]))
    channel = jnp.arange(table.shape[-3], dtype=jnp.int32)[None, :]
    leading = () if slice_ is None else (slice_[:, None],)

    def at(j, i):
        return table[(*leading, channel, j, i)]

    return (1 - y) * ((1 - x) * at(j, i) + x * at(j, i + 1)) + y * ((1 - x) * at(j + 1, i) + x * at(j + 1, i + 1))
