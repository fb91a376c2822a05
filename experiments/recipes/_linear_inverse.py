"""What the recovery of lights shares: a Laplacian on maps of the sphere, and Tikhonov's regularisation. Host arrays."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular


def gradient_energy(height: int, width: int) -> np.ndarray:
    """K with xᵀ K x = ∫ |∇L|² dω over an equirectangular map x, its pixels row by row; (pixels, pixels).

    Finite volumes: what flows between two pixels is the length of their common edge over the distance of their
    centres. So K y ≈ n(n+1) Ω y for a spherical harmonic y of order n, with the solid angles Ω.
    """
    across, along = np.pi / height, 2 * np.pi / width
    centre, edge = np.pi * (np.arange(height) + 0.5) / height, np.pi * np.arange(1, height) / height
    index = np.arange(height * width).reshape(height, width)
    beside = np.stack([index, np.roll(index, -1, axis=1)]), (across / (np.sin(centre) * along))[:, None]
    below = np.stack([index[:-1], index[1:]]), (np.sin(edge) * along / across)[:, None]
    energy = np.zeros((index.size, index.size))
    for (a, b), flow in (beside, below):
        flow = np.broadcast_to(flow, a.shape)
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            np.add.at(energy, (i, j), sign * flow)
    return energy


@dataclass(frozen=True)
class Tikhonov:
    """min |A x - b|² + λ |R x|² for any b and λ, by the eigenvectors of B Bᵀ, B = A R⁻¹.

    - `root` R: upper triangular, (unknowns, unknowns). - `matrix` B. - `modes`: eigenvectors of B Bᵀ, its columns.
    - `squares`: their eigenvalues, the squared singular values of B, (data,).
    """

    root: np.ndarray
    matrix: np.ndarray
    modes: np.ndarray
    squares: np.ndarray

    @classmethod
    def of(cls, matrix: np.ndarray, root: np.ndarray) -> "Tikhonov":
        """Of A `(data, unknowns)` and R."""
        whitened = solve_triangular(root, matrix.T, trans="T").T
        squares, modes = np.linalg.eigh(whitened @ whitened.T)
        return cls(root, whitened, modes, np.maximum(squares, 0))

    def weights(self, count: int = 121) -> np.ndarray:
        """Candidates for λ, in equal ratios over 12 decades below the largest eigenvalue and one above."""
        return self.squares[-1] * np.logspace(-12, 1, count)

    def cross_validated(self, data: np.ndarray) -> float:
        """The λ of least generalised cross-validation |(I - H) b|² / tr(I - H)², which asks for no noise level.

        Golub, Heath, Wahba, Technometrics 21(2), 1979.
        """
        weights = self.weights()
        left = weights / (self.squares[:, None] + weights)
        score = np.sum((left * (self.modes.T @ data)[:, None]) ** 2, axis=0) / np.sum(left, axis=0) ** 2
        return float(weights[np.argmin(score)])

    def discrepancy(self, data: np.ndarray, sigma: float) -> float:
        """The largest λ whose residual is no larger than noise of standard deviation `sigma` (Morozov); or the least.

        `sigma` is that of an element of b.
        """
        weights = self.weights()
        left = weights / (self.squares[:, None] + weights)
        small = np.sum((left * (self.modes.T @ data)[:, None]) ** 2, axis=0) <= data.size * sigma**2
        return float(weights[small][-1] if small.any() else weights[0])

    def solution(self, data: np.ndarray, weight: Any) -> np.ndarray:
        """x `(unknowns,)` for one λ, `(unknowns, n)` for n of them."""
        shrunk = (self.modes.T @ data).reshape(-1, *[1] * np.ndim(weight)) / np.add.outer(self.squares, weight)
        return solve_triangular(self.root, self.matrix.T @ (self.modes @ shrunk))

    def variance(self, rows: np.ndarray, weight: float, sigma: float) -> np.ndarray:
        """Of `rows` x `(n,)`, after the data: noise of variance σ², and before them x of covariance σ²/λ (RᵀR)⁻¹."""
        whitened = solve_triangular(self.root, rows.T, trans="T").T
        seen = whitened @ self.matrix.T @ self.modes
        told = np.sum(seen**2 / (self.squares + weight), axis=1)
        return sigma**2 / weight * np.maximum(np.sum(whitened**2, axis=1) - told, 0)
