"""Real spherical harmonics on the whole sphere: the paper's opponent, and the language of distant light."""

from functools import lru_cache

import equinox as eqx

from hshjax._special import RadialTables, jacobi_matrix
from hshjax._typing import Array, Float
from hshjax.bases._base import Chart, checked_order
from hshjax.bases._triangle import AbstractTriangle, triangle_tables


class SphericalHarmonics(AbstractTriangle):
    """Real spherical harmonics Y_n^m, |m| <= n <= order, without Condon-Shortley sign: (order + 1)² functions.

    Orthonormal over the SPHERE, unlike every other basis here, and evaluated below the horizon as well. A function on
    the hemisphere is projected on them by extending it with zero.
    """

    order: int = eqx.field(static=True, converter=checked_order)

    @property
    def hemispherical(self) -> bool:
        return False

    def tables(self) -> RadialTables:
        return _tables(self)

    def chart(self, w: Float[Array, "points 3"]) -> Chart:
        x, y, z = w[:, 0], w[:, 1], w[:, 2]
        return Chart(z, (x * x - y * y, 2 * x * y), (x, y))


@lru_cache
def _tables(basis: SphericalHarmonics) -> RadialTables:
    return triangle_tables(basis, 2.0, lambda m, size: jacobi_matrix(m, m, size))
