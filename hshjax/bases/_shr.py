"""Spherical harmonics restricted to the hemisphere and orthonormalised there: the control basis."""

from functools import lru_cache

import equinox as eqx
import numpy as np

from hshjax._special import RadialTables, stieltjes_matrix
from hshjax._typing import Array, Float
from hshjax.bases._base import Chart, checked_order
from hshjax.bases._triangle import AbstractTriangle, triangle_tables
from hshjax.geometry import upper


class SHR(AbstractTriangle):
    """Spherical harmonics of degree <= order, restricted to the hemisphere and orthonormalised: (order + 1)² functions.

        S_n^{±m} = p_{n-m}^m(z) Re|Im((x + i y)^m),   p^m orthonormal for (1 - z²)^m on [0, 1]

    The span is that of all polynomials in (x, y, z) of degree <= order. As many functions as `HSH`, but smooth on the
    closed hemisphere and free at the horizon. The weight is not a Jacobi weight: the recurrence comes from the
    Stieltjes procedure on a Gauss-Legendre rule that is exact for it, on the host in float64.
    """

    order: int = eqx.field(static=True, converter=checked_order)

    def tables(self) -> RadialTables:
        return _tables(self)

    def chart(self, w: Float[Array, "points 3"]) -> Chart:
        x, y, z = w[:, 0], w[:, 1], upper(w[:, 2])
        return Chart(z, (x * x - y * y, 2 * x * y), (x, y))


@lru_cache
def _tables(basis: SHR) -> RadialTables:
    # p_j² z (1 - z²)^m has degree 2 (order + 1) at most.
    nodes, weights = np.polynomial.legendre.leggauss(basis.order + 2)
    nodes, weights = (nodes + 1) / 2, weights / 2
    return triangle_tables(basis, 1.0, lambda m, size: stieltjes_matrix(nodes, weights * (1 - nodes**2) ** m, size))
