"""What the bases with all |m| <= n share: their mode table, and the norm of their radial weight."""

from collections.abc import Callable

import numpy as np

from hshjax._special import RadialTables, radial_tables
from hshjax.bases._base import AbstractBasis


class AbstractTriangle(AbstractBasis):
    """(order + 1)² functions, |m| <= n <= order, whose radial polynomials are orthogonal for (1 - t²)^m."""

    @property
    def modes(self) -> tuple[tuple[int, int], ...]:
        return tuple((n, m) for n in range(self.order + 1) for m in range(-n, n + 1))

    def radial_counts(self) -> tuple[int, ...]:
        return tuple(range(self.order + 1, 0, -1))

    def radial_index(self, n: int, m: int) -> int:
        return n - abs(m)


def triangle_tables(
    basis: AbstractTriangle, mass: float, matrix: Callable[[int, int], tuple[np.ndarray, np.ndarray]]
) -> RadialTables:
    """The recurrences of a basis over the full triangle.

    `mass` is ∫ dω / 2π over the domain, `matrix(m, size)` the Jacobi matrix of (1 - t²)^m; see `radial_tables`.
    """

    def first_norm(m):
        azimuth = 2 * np.pi if m == 0 else np.pi
        # Mean of (1 - t²)^m, Π_{k<=m} 2k / (2k + 1): a product of ratios, where factorials would overflow.
        mean = np.prod([2 * k / (2 * k + 1) for k in range(1, m + 1)])
        return 1 / np.sqrt(azimuth * mass * mean)

    return radial_tables(basis.radial_counts(), first_norm, matrix)
