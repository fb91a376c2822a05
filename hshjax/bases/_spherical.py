"""Real spherical harmonics on the whole sphere: the paper's opponent, and the language of distant light."""

from functools import lru_cache

import equinox as eqx
import numpy as np

from hshjax._special import RadialTables, jacobi_matrix, radial_tables
from hshjax._typing import Array, Float
from hshjax.bases._base import AbstractBasis, Chart, checked_order
from hshjax.bases._hsh import full_triangle, sine_power_integral


class SphericalHarmonics(AbstractBasis):
    """Real spherical harmonics Y_n^m, |m| <= n <= order, without Condon-Shortley sign: (order + 1)² functions.

    Orthonormal over the SPHERE, unlike every other basis here, and evaluated below the horizon as well. A function on
    the hemisphere is projected on them by extending it with zero.
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
        x, y, z = w[:, 0], w[:, 1], w[:, 2]
        return Chart(z, (x * x - y * y, 2 * x * y), (x, y))


@lru_cache
def _tables(order: int) -> RadialTables:
    def first_norm(m):
        return 1 / np.sqrt((2 * np.pi if m == 0 else np.pi) * 2 * sine_power_integral(m))

    return radial_tables([order - m + 1 for m in range(order + 1)], first_norm, lambda m, n: jacobi_matrix(m, m, n))
