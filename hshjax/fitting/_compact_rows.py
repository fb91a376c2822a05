"""Functions of a half-vector basis at samples, for least squares on the host: what compact fits ask of them."""

import abc
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from hshjax.bases import AbstractPairBasis

BLOCK = 2**14
"""Samples that are looked at together."""


class AbstractRows(abc.ABC):
    """B_a(s) for functions a and samples s. Host arrays, float64."""

    @abc.abstractmethod
    def gram(self, weight: np.ndarray) -> np.ndarray:
        """Σ_s w_s B_a(s) B_b(s), `(sets, functions, functions)`, for every set of weights in `(n, sets)`."""

    @abc.abstractmethod
    def moment(self, weighted: np.ndarray) -> np.ndarray:
        """Σ_s B_a(s) y_s, `(sets, functions)`, for values `(n, sets)`."""

    @abc.abstractmethod
    def evaluate(self, columns: np.ndarray) -> np.ndarray:
        """Σ_a c_a B_a(s), `(n, channels)`, for coefficients `(functions, channels)`."""


class ScatteredRows(AbstractRows):
    """Rows of scattered samples, in blocks; those of a single block are kept, those of several are made anew."""

    def __init__(self, basis: AbstractPairBasis, wi: np.ndarray, wo: np.ndarray):
        self.size = len(wi)
        self.parts = [slice(start, start + BLOCK) for start in range(0, self.size, BLOCK)]

        def rows(part: slice) -> np.ndarray:
            return np.asarray(basis(jnp.asarray(wi[part]), jnp.asarray(wo[part])))

        kept = rows(self.parts[0])
        self.count = kept.shape[1]
        self.rows: Callable[[slice], np.ndarray] = rows if len(self.parts) > 1 else lambda _: kept

    def gram(self, weight):
        found = np.zeros((weight.shape[1], self.count, self.count))
        for part in self.parts:
            rows = self.rows(part)
            for one, root in zip(found, np.sqrt(weight[part].T), strict=True):
                scaled = root[:, None] * rows
                one += scaled.T @ scaled  # a product with itself: half the work
        return found

    def moment(self, weighted):
        return sum((weighted[part].T @ self.rows(part) for part in self.parts), np.zeros(()))

    def evaluate(self, columns):
        return np.concatenate([self.rows(part) @ columns for part in self.parts])
