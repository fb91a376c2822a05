"""Zernike functions on the hemisphere."""

from functools import lru_cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._special import RadialTables, jacobi_matrix, radial_tables
from hshjax._typing import Array, Float
from hshjax.bases._base import AbstractBasis, Chart, checked_order
from hshjax.geometry import upper


class Zernike(AbstractBasis):
    """Hemispherical Zernike functions Z_n^m, |m| <= n <= order, n - m even: (order + 1)(order + 2) / 2 functions.

        Z_n^{±m} = sqrt((n+1)/π) (-1)^k P_k^{(m,0)}(2z - 1) Re|Im(q^m),   k = (n - m)/2,   q = (x + i y) / sqrt(1 + z)

    (at m = 0 divided by sqrt2): Zernike's circle polynomials on the equal-area disk. Smooth on the closed hemisphere.

    Source: Koenderink, van Doorn, Stavridi, ECCV 1996; Koenderink and van Doorn, JOSA A 15(11), 1998.
    """

    order: int = eqx.field(static=True, converter=checked_order)

    @property
    def modes(self) -> tuple[tuple[int, int], ...]:
        return tuple((n, m) for n in range(self.order + 1) for m in range(-n, n + 1, 2))

    def radial_counts(self) -> tuple[int, ...]:
        return tuple((self.order - m) // 2 + 1 for m in range(self.order + 1))

    def radial_index(self, n: int, m: int) -> int:
        return (n - abs(m)) // 2

    def tables(self) -> RadialTables:
        return _tables(self)

    def chart(self, w: Float[Array, "points 3"]) -> Chart:
        x, y, z = w[:, 0], w[:, 1], upper(w[:, 2])
        scale = 1 / (1 + z)
        root = jnp.sqrt(scale)
        return Chart(1 - 2 * z, (scale * (x * x - y * y), scale * 2 * x * y), (root * x, root * y))


@lru_cache
def _tables(basis: Zernike) -> RadialTables:
    # In x = 1 - 2z = 2|q|² - 1 the weight |q|^{2m} is ((1 + x)/2)^m, and the sign (-1)^k is absorbed.
    def first_norm(m):
        return np.sqrt((m + 1) / (2 * np.pi if m == 0 else np.pi))

    return radial_tables(basis.radial_counts(), first_norm, lambda m, n: jacobi_matrix(0, m, n))
