"""Which unknowns a least-squares problem can do without."""

import numpy as np

SHARE = 0.1
"""Of the unknowns that are left, how many leave at a time."""


def eliminate(
    matrix: np.ndarray, moment: np.ndarray, count: int, *, ridge: float, needed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """`count` unknowns of min xᵀ A x - 2 bᵀ x, increasing, and their values where the others are 0. Host arrays.

    Those leave whose absence costs least, x_k² / (A⁻¹)_kk, which is exact for one that leaves by itself. All are solved
    for anew after each step, by a downdate of A⁻¹. `ridge` is relative to the diagonal of A, and must hold A where it
    is singular. The first `needed` unknowns stay.

    Source: Hassibi and Stork, Second Order Derivatives for Network Pruning: Optimal Brain Surgeon, NIPS 1992, Eq. 5.
    """
    diagonal = np.diag(matrix)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1))
    matrix = scale[:, None] * matrix * scale + ridge * np.eye(scale.size)
    moment = scale * moment
    kept = np.arange(scale.size)
    if count < kept.size:
        inverse = _inverse(matrix)
        value = inverse @ moment
        while kept.size > count:
            cost = value**2 / np.diag(inverse)
            cost[:needed] = np.inf
            order = np.argsort(cost, kind="stable")
            leaving = min(kept.size - count, max(1, int(SHARE * kept.size)))
            out, stay = order[:leaving], np.sort(order[leaving:])
            update = np.linalg.solve(inverse[np.ix_(out, out)], inverse[np.ix_(out, stay)])
            value = value[stay] - update.T @ value[out]
            inverse = inverse[np.ix_(stay, stay)] - inverse[np.ix_(stay, out)] @ update
            kept = kept[stay]
    return kept, scale[kept] * np.linalg.solve(matrix[np.ix_(kept, kept)], moment[kept])


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Of a positive definite matrix, in half the time of a general one.

    **Raises:** ValueError where rounding has made it indefinite.
    """
    from scipy.linalg import get_lapack_funcs  # here, to keep `import hshjax` cheap

    factor, invert = get_lapack_funcs(("potrf", "potri"), (matrix,))
    root, failed = factor(matrix, lower=1)
    if failed:
        raise ValueError(f"normal equations are not positive definite at unknown {failed} of {len(matrix)}")
    found = np.tril(invert(root, lower=1)[0])
    return found + np.tril(found, -1).T
