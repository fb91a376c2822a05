"""Weighted least squares on the differences between neighbouring pixels of a grid: a discrete Poisson equation."""

from typing import Any, NamedTuple, cast

import numpy as np

from hshjax._typing import Float

ITERATIONS = 5000


class Edges(NamedTuple):
    """A number for each pair of neighbours: to the right `(rows, columns - 1)`, upwards `(rows - 1, columns)`."""

    right: Float[np.ndarray, "rows columns_1"]
    up: Float[np.ndarray, "rows_1 columns"]


def differences(values: Float[np.ndarray, "rows columns"]) -> Edges:
    """Of values: right minus left, upper minus lower. Row 0 is the upmost."""
    return Edges(values[:, 1:] - values[:, :-1], values[:-1] - values[1:])


def divergence(edges: Edges) -> Float[np.ndarray, "rows columns"]:
    """The adjoint of `differences`."""
    result = np.zeros((edges.right.shape[0], edges.up.shape[1]))
    result[:, 1:] += edges.right
    result[:, :-1] -= edges.right
    result[:-1] += edges.up
    result[1:] -= edges.up
    return result


def solve(
    weights: Edges, weighted: Edges, start: Float[np.ndarray, "rows columns"], tolerance: float
) -> Float[np.ndarray, "rows columns"]:
    """Values that minimise the sum of weight * (difference - target)², given weights and weight * target.

    A weight of 0 cuts an edge; values are determined up to a constant in each piece, and have no meaning where all
    edges of a pixel are cut.

    Conjugate gradients with the inverse of the unweighted operator of the whole rectangle, by the cosine transform,
    between the roots of the mean weights about each pixel: exact for equal weights on a rectangle, ten iterations
    where they vary smoothly, some hundred where they or the outline are ragged.
    Source: Concus and Golub, Use of fast direct methods for the efficient numerical solution of nonseparable elliptic
    equations, SIAM J. Numer. Anal. 10(6), 1973.

    **Raises:** RuntimeError if the residual does not fall to `tolerance` of the right-hand side.
    """
    count = _around(Edges(*(np.not_equal(weight, 0) for weight in weights)))
    if not count.any():
        return np.zeros(start.shape)
    (top, bottom), (left, right) = ((axis.min(), axis.max() + 1) for axis in np.nonzero(count))
    # Transforms of prime lengths take four times as long. What is added is cut off, as what lies in the box may be.
    rows, columns = (_fast(int(size)) for size in (bottom - top, right - left))
    result = np.zeros(start.shape)

    def framed(array: np.ndarray, height: int, width: int) -> np.ndarray:
        frame, found = np.zeros((height, width)), array[top:bottom, left:right]
        frame[: found.shape[0], : found.shape[1]] = found
        return frame

    def framed_edges(edges: Edges) -> Edges:
        inner = Edges(edges.right[:, : right - 1], edges.up[: bottom - 1])
        return Edges(framed(inner.right, rows, columns - 1), framed(inner.up, rows - 1, columns))

    solution = _solve(framed_edges(weights), framed_edges(weighted), framed(start, rows, columns), tolerance)
    result[top:bottom, left:right] = solution[: bottom - top, : right - left]
    return result


def _fast(size: int) -> int:
    """The next length that transforms take well."""
    from scipy.fft import next_fast_len  # imported where it is used, as all of scipy

    return cast(int, next_fast_len(size, real=True))  # the signature has a None for sizes that there are not


def _solve(
    weights: Edges, weighted: Edges, start: Float[np.ndarray, "rows columns"], tolerance: float
) -> Float[np.ndarray, "rows columns"]:
    from scipy.fft import dctn, idctn
    from scipy.sparse.linalg import LinearOperator, cg

    rows, columns = shape = start.shape
    modes = [2 - 2 * np.cos(np.pi * np.arange(size) / size) for size in shape]
    eigenvalues = modes[0][:, None] + modes[1]
    eigenvalues[0, 0] = 1 if start.size == 1 else np.sort(eigenvalues, axis=None)[1]  # constants: see below
    present = Edges(*(np.not_equal(weight, 0) for weight in weights))
    count, total = _around(present), _around(weights)
    root = np.sqrt(np.where(count > 0, total / np.maximum(count, 1), 1))

    def operator(flat: np.ndarray) -> np.ndarray:
        steps = differences(flat.reshape(shape))
        return divergence(Edges(weights.right * steps.right, weights.up * steps.up)).ravel()

    def preconditioner(flat: np.ndarray) -> np.ndarray:
        # Positive on constants, too: scaled by the root they are not what the operator leaves open.
        spectrum = dctn(flat.reshape(shape) / root, norm="ortho", overwrite_x=True)
        return (idctn(spectrum / eigenvalues, norm="ortho", overwrite_x=True) / root).ravel()

    linear: Any = LinearOperator  # what it is called with is not what its class declares
    size = (start.size, start.size)
    right_side = divergence(weighted).ravel()
    solution, failed = cg(
        linear(size, operator, dtype=float),
        right_side,
        start.ravel(),
        rtol=tolerance,
        maxiter=ITERATIONS,
        M=linear(size, preconditioner, dtype=float),
    )
    if failed or not np.all(np.isfinite(solution)):
        left = np.linalg.norm(operator(solution) - right_side) / np.linalg.norm(right_side)
        raise RuntimeError(
            f"heights of {rows} x {columns} pixels did not converge in {ITERATIONS} iterations: residual {left:.1e}, "
            f"of {tolerance:.0e} asked for; leave out normals nearer to the horizon, or pixels of a ragged mask"
        )
    return solution.reshape(shape)


def _around(edges: Edges) -> Float[np.ndarray, "rows columns"]:
    """Sum over the edges of each pixel."""
    result = np.zeros((edges.right.shape[0], edges.up.shape[1]))
    result[:, 1:] += edges.right
    result[:, :-1] += edges.right
    result[:-1] += edges.up
    result[1:] += edges.up
    return result
