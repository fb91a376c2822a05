"""Normal equations of what pixels share, on the host in float64: tens to hundreds of unknowns."""

import numpy as np

from hshjax._typing import Array, Float

BOUND = 1e-9
"""Between a bound and what stands on it: a box must not be empty."""

ROUNDING = 1e-5
"""Of equations, relative to their largest eigenvalue: less is not known of them."""


class System:
    """Equations of a step, to which priors are added.

    - `materials`: which unknowns are coefficients. - `stray`: which one is the share of stray light.
    - `kinds`: how many unknowns each of `lights` has; they come last, kind by kind.
    - `least`: how far down each unknown may go, -inf for any.
    """

    def __init__(self, matrix: Array, right: Array, size: int, lights: int):
        self.matrix, self.right = np.array(matrix, float), np.array(right, float)
        self.materials, self.stray, self.lights = slice(0, size), size, lights
        self.kinds = (len(self.right) - size - 1) // lights
        self.least = np.full_like(self.right, -np.inf)
        self._damping = np.empty_like(self.right)
        self._damping[self.materials] = 3e-4 * np.mean(self._diagonal[self.materials])
        self._damping[size:] = 1e-3 * self._diagonal[size:] + np.finfo(float).tiny

    @property
    def _diagonal(self) -> Float[np.ndarray, " unknowns"]:
        return np.diag(self.matrix)

    def of_lights(self, first: int, last: int) -> slice:
        """Which unknowns are those of kinds `first` to before `last`."""
        return slice(self.stray + 1 + first * self.lights, self.stray + 1 + last * self.lights)

    def pull(self, part: slice, strength: Float[np.ndarray, "n n"], moved: Float[np.ndarray, " n"]) -> None:
        """Adds moved·strength·moved to the cost, of unknowns that have moved so far already."""
        self.matrix[part, part] += strength
        self.right[part] -= strength @ moved

    def solve(self, stray: bool) -> Float[np.ndarray, " unknowns"]:
        """The best step within bounds; `stray`: whether stray light takes part in it."""
        from scipy.optimize import lsq_linear  # slow to import

        keep = np.ones(len(self.right), bool)
        keep[self.stray] = stray
        step = np.zeros_like(self.right)
        root, right = _halved((self.matrix + np.diag(self._damping))[np.ix_(keep, keep)], self.right[keep])
        # The least of |rootᵀ step - right|² above bounds; BOUND keeps what stands on one inside.
        bounds = (np.minimum(self.least[keep], 0) - BOUND, np.inf)
        step[keep] = lsq_linear(root.T, right, bounds, method="bvls").x
        return step


def _halved(
    matrix: Float[np.ndarray, "n n"], right: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
    """A root R, R Rᵀ = matrix, and the r of R r = right.

    Equations are sums in float32 of what is left when pixels have taken their own: where they take nearly all, rounding
    makes them indefinite. Then the root is that of the matrix with no eigenvalue below `ROUNDING`.
    """
    from scipy.linalg import solve_triangular

    try:
        root = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        scale = np.sqrt(np.maximum(values, ROUNDING * values[-1]))
        return vectors * scale, vectors.T @ right / scale
    return root, solve_triangular(root, right, lower=True)
