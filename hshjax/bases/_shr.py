"""Spherical harmonics restricted to the hemisphere and orthonormalised there: the control basis."""

from functools import lru_cache

import equinox as eqx
import numpy as np

from hshjax._special import RadialTables, radial_tables, stieltjes_matrix
from hshjax._typing import Array, Float
from hshjax.bases._base import AbstractBasis, Chart, checked_order
from hshjax.bases._hsh import full_triangle, sine_power_integral
from hshjax.geometry import upper


class SHR(AbstractBasis):
    """Spherical harmonics of degree <= order, restricted to the hemisphere and orthonormalised: (order + 1)² functions.

        S_n^{±m} = p_{n-m}^m(z) Re|Im((x + i y)^m),   p^m orthonormal for (1 - z²)^m on [0, 1]

    The span is that of all polynomials in (x, y, z) of degree <= order. As many functions as `HSH`, but smooth on the
    closed hemisphere and free at the horizon. The weight is not a Jacobi weight: the recurrence comes from the
    Stieltjes procedure on a Gauss-Legendre rule that is exact for it, on the host in float64.
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
        return Chart(z, (x * x - y * y, 2 * x * y), (x, y))


@lru_cache
def _tables(order: int) -> RadialTables:
    # p_j² z (1 - z²)^m has degree 2 (order + 1) at most.
    nodes, weights = np.polynomial.legendre.leggauss(order + 2)
    nodes, weights = (nodes + 1) / 2, weights / 2

    def first_norm(m):
        return 1 / np.sqrt((2 * np.pi if m == 0 else np.pi) * sine_power_integral(m))

    return radial_tables(
        [order - m + 1 for m in range(order + 1)],
        first_norm,
        lambda m, n: stieltjes_matrix(nodes, weights * (1 - nodes**2) ** m, n),
    )
