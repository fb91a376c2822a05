"""Hemispherical harmonics."""

from functools import lru_cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._special import RadialTables, jacobi_matrix, radial_tables
from hshjax._typing import Array, Float
from hshjax.bases._base import AbstractBasis, Chart, checked_order
from hshjax.geometry import upper


class HSH(AbstractBasis):
    """Hemispherical harmonics H_n^m, |m| <= n <= order: (order + 1)² functions.

        H_n^{±m} = sqrt2 K_n^m p_n^m(t) Re|Im(s^m),   t = 2z - 1,   s = 2 sqrt(z / (1 + z)) (x + i y)

    with P_n^m(t) = (1 - t²)^{m/2} p_n^m(t) and no Condon-Shortley sign: the real spherical harmonics on the hemisphere
    stretched over the sphere, times sqrt2. Every function with m ≠ 0 vanishes on the horizon.

    Even m is built from s² = 4z/(1+z) (x+iy)² and is smooth to the horizon. Odd m carries sqrt(z), whose derivative
    is infinite there for m = 1; on the horizon that factor and its derivatives are reported as 0.

    Source: Gautron, Křivánek, Pattanaik, Bouatouch, EGSR 2004; the paper, before Eq. 2.
    """

    order: int = eqx.field(static=True, converter=checked_order)

    @property
    def modes(self) -> tuple[tuple[int, int], ...]:
        return full_triangle(self.order)

    def radial_index(self, n: int, m: int) -> int:
        return n - abs(m)

    def tables(self) -> RadialTables:
        return _tables(self.order)

    def chart(self, w: Float[Array, "points 3"]) -> Chart:
        x, y, z = w[:, 0], w[:, 1], upper(w[:, 2])
        square = 4 * z / (1 + z)
        # Below eps² the root is the horizon's zero: its second derivative, ~ z^(-3/2), would overflow in float32.
        above = z > jnp.finfo(z.dtype).eps ** 2
        root = jnp.where(above, jnp.sqrt(jnp.where(above, square, 1)), 0)
        return Chart(2 * z - 1, (square * (x * x - y * y), square * 2 * x * y), (root * x, root * y))


def full_triangle(order: int) -> tuple[tuple[int, int], ...]:
    """(n, m) for all |m| <= n <= order."""
    return tuple((n, m) for n in range(order + 1) for m in range(-n, n + 1))


def sine_power_integral(m: int) -> float:
    """∫_0^1 (1 - t²)^m dt = Π_{k<=m} 2k / (2k + 1): a product of ratios, where factorials would overflow."""
    return float(np.prod([2 * k / (2 * k + 1) for k in range(1, m + 1)]))


@lru_cache
def _tables(order: int) -> RadialTables:
    # Weight (1 - t²)^m on [-1, 1], dω = dt/2 dφ; the azimuth integrates to π (2π at m = 0).
    def first_norm(m):
        return 1 / np.sqrt((2 * np.pi if m == 0 else np.pi) * sine_power_integral(m))

    return radial_tables([order - m + 1 for m in range(order + 1)], first_norm, lambda m, n: jacobi_matrix(m, m, n))
