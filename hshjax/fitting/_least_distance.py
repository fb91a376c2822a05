"""Small convex programs: the point nearest to another one, in a quadratic norm, under linear inequalities.

Least-distance programming (Lawson & Hanson, Solving Least Squares Problems, 1974, ch. 23). With u = R (c - c0) the
problem  min |R (c - c0)|²  subject to  G c >= h  becomes  min |u|²  subject to  M u >= f,  M = G R^-1,  f = h - G c0;
and that is a non-negative least-squares problem in the multipliers, one for each inequality.
"""

from typing import NamedTuple

import numpy as np


class Nearest(NamedTuple):
    """`point` `(n,)`, and a `multiplier` >= 0 `(rows,)` of every inequality: RᵀR (c - c0) = Gᵀ multiplier."""

    point: np.ndarray
    multiplier: np.ndarray


class InfeasibleError(ValueError):
    """No point satisfies the inequalities."""


def least_distance(root: np.ndarray, start: np.ndarray, rows: np.ndarray, bounds: np.ndarray) -> Nearest:
    """argmin |root (c - start)| subject to rows c >= bounds; `root` upper triangular `(n, n)`. Host arrays, float64.

    The rows of positive multiplier are linearly independent, so that each is the gradient of an active bound.

    **Raises:** InfeasibleError where no c satisfies all inequalities.
    """
    from scipy.linalg import solve_triangular  # here, to keep `import hshjax` cheap
    from scipy.optimize import nnls

    matrix = solve_triangular(root, rows.T, trans=1).T
    missing = bounds - rows @ start
    multiplier = np.zeros(missing.size)
    if not np.any(missing > 0):
        return Nearest(start, multiplier)
    # Inequalities of unit length, and distances near 1: neither changes the problem, both keep digits.
    length = np.linalg.norm(matrix, axis=1)
    if np.any(missing[length == 0] > 0):
        raise InfeasibleError("an inequality does not depend on the unknowns, and does not hold")
    length = np.where(length > 0, length, 1)
    matrix, missing = matrix / length[:, None], missing / length
    scale = np.max(missing)
    dual = np.vstack([matrix.T, missing / scale])
    target = np.zeros(dual.shape[0])
    target[-1] = 1
    weights, _ = nnls(dual, target, maxiter=30 * max(dual.shape))
    if 1 - dual[-1] @ weights <= 1e-12:  # the residual's last entry is 1 / (1 + |u|²): below this, u is infinite
        raise InfeasibleError("no point satisfies all inequalities")
    active = weights > 0
    # The residual of the dual problem is small where the distance is large; the normal equations of the active rows
    # give the point without that loss.
    tight = matrix[active]
    forces = np.linalg.lstsq(tight @ tight.T, missing[active], rcond=None)[0]
    multiplier[active] = np.maximum(forces, 0) / length[active]
    return Nearest(start + solve_triangular(root, tight.T @ forces), multiplier)
