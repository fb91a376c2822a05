"""Hemispherical harmonics."""

from functools import lru_cache

import equinox as eqx
import jax.numpy as jnp

from hshjax._special import RadialTables, jacobi_matrix
from hshjax._typing import Array, Float
from hshjax.bases._base import Chart, checked_order
from hshjax.bases._triangle import AbstractTriangle, triangle_tables
from hshjax.geometry import upper


class HSH(AbstractTriangle):
    """Hemispherical harmonics H_n^m, |m| <= n <= order: (order + 1)² functions.

        H_n^{±m} = sqrt2 K_n^m p_n^m(t) Re|Im(s^m),   t = 2z - 1,   s = 2 sqrt(z / (1 + z)) (x + i y)

    with P_n^m(t) = (1 - t²)^{m/2} p_n^m(t) and no Condon-Shortley sign: the real spherical harmonics on the hemisphere
    stretched over the sphere, times sqrt2. Every function with m ≠ 0 vanishes on the horizon.

    Even m is built from s² = 4z/(1+z) (x+iy)² and is smooth to the horizon. Odd m carries sqrt(z), whose derivative
    is infinite there for m = 1; on the horizon that factor and its derivatives are reported as 0.

    Source: Gautron, Křivánek, Pattanaik, Bouatouch, EGSR 2004; the paper, before Eq. 2.
    """

    order: int = eqx.field(static=True, converter=checked_order)

    def tables(self) -> RadialTables:
        return _tables(self)

    def chart(self, w: Float[Array, "points 3"]) -> Chart:
        x, y, z = w[:, 0], w[:, 1], upper(w[:, 2])
        square = 4 * z / (1 + z)
        # Below eps² the root is the horizon's zero: its second derivative, ~ z^(-3/2), would overflow in float32.
        above = z > jnp.finfo(z.dtype).eps ** 2
        root = jnp.where(above, jnp.sqrt(jnp.where(above, square, 1)), 0)
        return Chart(2 * z - 1, (square * (x * x - y * y), square * 2 * x * y), (root * x, root * y))


@lru_cache
def _tables(basis: HSH) -> RadialTables:
    # dω = dz dφ = dt/2 dφ: the mass of [-1, 1] under dt/2 is 1.
    return triangle_tables(basis, 1.0, lambda m, size: jacobi_matrix(m, m, size))
