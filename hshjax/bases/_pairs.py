"""Functions of a pair of directions: h(wi)ᵀ A h(wo) with A free, and with A symmetric (Helmholtz reciprocity)."""

import abc
from functools import lru_cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._special import blockwise
from hshjax._typing import Array, Float, Real
from hshjax.bases._base import AbstractBasis, check_modes, matmul
from hshjax.bases._merged import merged_pairs
from hshjax.bases._operation import Zero, instantiated, operation
from hshjax.geometry import as_directions, common_dtype

PAIR_BLOCK = 512
"""Pairs a block: rows of order 16 for both directions, and their product with A, then stay in the cache."""


class Entries(NamedTuple):
    """A pair basis inside the tensor basis: column `mode` is Σ value h_a(wi) h_b(wo) over its entries. Host arrays."""

    mode: np.ndarray
    a: np.ndarray
    b: np.ndarray
    value: np.ndarray


class AbstractPairBasis(eqx.Module):
    """Functions of a pair of directions (wi, wo).

    Directions are unit vectors in the local frame, both away from the surface; `wi` and `wo` broadcast. Arrays among
    the fields of a basis are differentiable.
    """

    @property
    @abc.abstractmethod
    def modes(self) -> tuple:
        """What each column is: see the class."""

    @property
    @abc.abstractmethod
    def count(self) -> int:
        """Number of functions, `len(modes)` without the list."""

    @abc.abstractmethod
    def degrees(self) -> np.ndarray:
        """Orders (n, p) of every column in its two variables, `(modes, 2)`. Host array."""

    @property
    @abc.abstractmethod
    def reciprocal(self) -> bool:
        """Whether every function is unchanged when wi and wo are swapped."""

    @property
    def isotropic(self) -> bool:
        """Whether every function is unchanged when both directions turn about the normal."""
        return False

    @abc.abstractmethod
    def block_rows(self, wi: Float[Array, "pairs 3"], wo: Float[Array, "pairs 3"]) -> Float[Array, "pairs modes"]:
        """The design rows of one block."""

    @abc.abstractmethod
    def block_sums(
        self, coefficients: Float[Array, "modes channels"], wi: Float[Array, "pairs 3"], wo: Float[Array, "pairs 3"]
    ) -> Float[Array, "pairs channels"]:
        """Σ_k c_k B_k of one block, by the cheapest contraction."""

    def written_out_sums(
        self, coefficients: Float[Array, "modes channels"], wi: Float[Array, "pairs 3"], wo: Float[Array, "pairs 3"]
    ) -> Float[Array, "pairs channels"] | None:
        """Σ_k c_k B_k of all pairs in one kernel, for values only; None if there is none, or it would be a long one."""
        return None

    def __call__(self, wi: Float[Array, "... 3"], wo: Float[Array, "... 3"]) -> Real:
        """The design row `(*batch, modes)`. `evaluate` is faster wherever only Σ c_k B_k is needed."""
        wi, wo, batch = flat_pairs(wi, wo)
        arrays, static = eqx.partition(self, eqx.is_array)
        return _rows(static, arrays, wi, wo).reshape(*batch, self.count)

    def evaluate(
        self, coefficients: Float[Array, "modes ..."], wi: Float[Array, "... 3"], wo: Float[Array, "... 3"]
    ) -> Real:
        """Σ_k c_k B_k(wi, wo), `(*batch, *channels)`, for any number of channels; no row is formed.

        **Raises:** ValueError if `coefficients` does not have one row per mode.
        """
        wi, wo, batch = flat_pairs(wi, wo)
        coefficients, wi, wo = common_dtype(coefficients, wi, wo)
        check_modes(self, coefficients)
        channels = coefficients.shape[1:]
        arrays, static = eqx.partition(self, eqx.is_array)
        return _sums(static, arrays, coefficients.reshape(self.count, -1), wi, wo).reshape(*batch, *channels)


# Compiled once for a basis and a shape, as in hshjax/bases/_base.py. The blocks are recomputed, not stored, in reverse:
# what one keeps for its derivative is larger than what it returns. A basis comes in two parts, what is static of it and
# its arrays.


@partial(jax.jit, static_argnums=0)
def _rows(static: AbstractPairBasis, arrays: AbstractPairBasis, wi: Array, wo: Array) -> Array:
    pairs = eqx.combine(static, arrays)
    return blockwise(jax.checkpoint(lambda i, o: pairs.block_rows(i, o)), PAIR_BLOCK, wi, wo)


def _block_sums(static: AbstractPairBasis, arrays: AbstractPairBasis, coefficients: Array, wi: Array, wo: Array):
    pairs = eqx.combine(static, arrays)
    return blockwise(jax.checkpoint(lambda i, o: pairs.block_sums(coefficients, i, o)), PAIR_BLOCK, wi, wo)


class Parts(NamedTuple):
    """What is static of a sum: of the basis, and how its arrays lie among those of the call. Hashable."""

    basis: AbstractPairBasis
    tree: Any


def _values(static: Parts, *arrays: Array) -> Array:
    of_basis, coefficients, wi, wo = jax.tree.unflatten(static.tree, arrays)
    found = eqx.combine(static.basis, of_basis).written_out_sums(coefficients, wi, wo)
    return _block_sums(static.basis, of_basis, coefficients, wi, wo) if found is None else found


def _slope_of_values(static: Parts, primals, tangents) -> tuple[Array, Array]:
    """By coefficients, rows times dc: the columns of a Jacobian share the rows, and its transpose is one product."""
    arrays, coefficients, wi, wo = jax.tree.unflatten(static.tree, primals)
    *d_arrays, d_coefficients, d_wi, d_wo = tangents
    if all(isinstance(d, Zero) for d in (*d_arrays, d_wi, d_wo)):
        value = _pair_sums(static, *primals)
        tangent = jnp.zeros_like(value)
    else:
        d_others = jax.tree.unflatten(static.tree, [instantiated(d) for d in tangents])
        value, tangent = jax.jvp(
            lambda arrays, wi, wo: _block_sums(static.basis, arrays, coefficients, wi, wo),
            (arrays, wi, wo),
            (d_others[0], *d_others[2:]),
        )
    if not isinstance(d_coefficients, Zero):
        pairs = eqx.combine(static.basis, arrays)
        product = jax.checkpoint(lambda d, i, o: matmul(pairs.block_rows(i, o), d))
        tangent += blockwise(partial(product, d_coefficients), PAIR_BLOCK, wi, wo)
    return value, tangent


_pair_sums = operation("pair_sums", _values, _slope_of_values, merged_pairs, linear=-3)


def _all_sums(static: AbstractPairBasis, arrays: AbstractPairBasis, coefficients: Array, wi: Array, wo: Array):
    leaves, tree = jax.tree.flatten((arrays, coefficients, wi, wo))
    return _pair_sums(Parts(static, tree), *leaves)


_sums = jax.jit(_all_sums, static_argnums=0)


class AbstractProductBasis(AbstractPairBasis):
    """Sums of products h_a(wi) h_b(wo) [sr^-1], orthonormal for dω_i dω_o on the product of two hemispheres.

    That is where `basis.hemispherical`; over `SphericalHarmonics` they are orthonormal on two spheres. Columns are
    ordered by the larger of the two orders first, so that a lower order is a prefix of a higher one (but for
    `TensorBasis`, whose coefficients are a matrix read row by row).
    """

    basis: eqx.AbstractVar[AbstractBasis]

    def __check_init__(self):
        if not isinstance(self.basis, AbstractBasis):
            raise ValueError(f"{type(self).__name__} needs a basis of single directions, got {self.basis!r}")

    def degrees(self) -> np.ndarray:
        return np.array([[a[0], b[0]] for a, b in self.modes])

    @abc.abstractmethod
    def entries(self) -> Entries:
        """Every column as a sparse matrix over the single-direction basis; the columns are orthonormal there too."""


class TensorBasis(AbstractProductBasis):
    """All products h_a(wi) h_b(wo): K² functions, reciprocity free.

    `modes` holds ((n, m), (p, q)), incident first; column a K + b, so that coefficients reshape to the matrix A.
    """

    basis: AbstractBasis

    @property
    def modes(self) -> tuple[tuple[tuple[int, int], tuple[int, int]], ...]:
        return _tensor_modes(self.basis)

    @property
    def count(self) -> int:
        return self.basis.count**2

    @property
    def reciprocal(self) -> bool:
        return False

    def entries(self) -> Entries:
        k = self.basis.count
        a, b = (grid.ravel() for grid in np.meshgrid(np.arange(k), np.arange(k), indexing="ij"))
        return Entries(np.arange(k * k), a, b, np.ones(k * k))

    def block_rows(self, wi, wo):
        hi, ho = self.basis(wi), self.basis(wo)
        return (hi[:, :, None] * ho[:, None, :]).reshape(wi.shape[0], self.count)

    def block_sums(self, coefficients, wi, wo):
        k = self.basis.count
        return bilinear(self.basis, coefficients.reshape(k, k, coefficients.shape[1]), wi, wo)

    def __hash__(self) -> int:
        return hash((type(self), self.basis))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TensorBasis) and self.basis == other.basis


class HelmholtzBasis(AbstractProductBasis):
    """The paper's Eq. 2 over unordered pairs a <= b: K (K + 1) / 2 reciprocal functions.

        B_ab(wi, wo) = N_ab [h_a(wi) h_b(wo) + h_b(wi) h_a(wo)],   N_ab = 1 / sqrt(2 (1 + δ_ab))

    N is what orthonormality asks for (the paper leaves it open). `modes` holds ((n, m), (p, q)) of a and b.
    """

    basis: AbstractBasis

    @property
    def modes(self) -> tuple[tuple[tuple[int, int], tuple[int, int]], ...]:
        return _helmholtz_modes(self.basis)

    @property
    def count(self) -> int:
        return self.basis.count * (self.basis.count + 1) // 2

    @property
    def reciprocal(self) -> bool:
        return True

    def unordered(self) -> tuple[np.ndarray, np.ndarray]:
        """The columns (a, b) of the single basis, a <= b, behind every column of this one. Host arrays."""
        return _unordered_pairs(self.basis.count)

    def entries(self) -> Entries:
        a, b = self.unordered()
        norm = _pair_norm(a == b)
        mode = np.arange(a.size)
        return Entries(np.tile(mode, 2), np.r_[a, b], np.r_[b, a], np.tile(norm, 2))

    def block_rows(self, wi, wo):
        a, b = self.unordered()
        hi, ho = self.basis(wi), self.basis(wo)
        norm = jnp.asarray(_pair_norm(a == b), hi.dtype)
        return norm[None] * (hi[:, a] * ho[:, b] + hi[:, b] * ho[:, a])

    def block_sums(self, coefficients, wi, wo):
        return bilinear(self.basis, to_matrix(self, coefficients), wi, wo)

    def __hash__(self) -> int:
        return hash((type(self), self.basis))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, HelmholtzBasis) and self.basis == other.basis


def to_matrix(pairs: AbstractProductBasis, coefficients: Float[Array, " modes *channels"]) -> Real:
    """The matrix A, `(K, K, *channels)`, with ρ(wi, wo) = h(wi)ᵀ A h(wo); symmetric for a reciprocal basis."""
    coefficients = jnp.asarray(coefficients)
    check_modes(pairs, coefficients)
    k, (mode, a, b, value) = pairs.basis.count, pairs.entries()
    matrix = jnp.zeros((k, k, *coefficients.shape[1:]), coefficients.dtype)
    return matrix.at[a, b].add(_weights(value, coefficients) * coefficients[mode])


def from_matrix(pairs: AbstractProductBasis, matrix: Float[Array, "k k *channels"]) -> Real:
    """Coefficients `(modes, *channels)` of the function of `pairs` nearest in L2 to h(wi)ᵀ A h(wo).

    Exact where A lies in the span; otherwise the orthogonal projection: for `HelmholtzBasis` that is the
    reciprocal part (A + Aᵀ)/2 (claim 6 of the paper), for `IsotropicBasis` the average over rotations as well.
    """
    matrix = jnp.asarray(matrix)
    k, (mode, a, b, value) = pairs.basis.count, pairs.entries()
    if matrix.shape[:2] != (k, k):
        raise ValueError(f"the matrix of {pairs} must have shape ({k}, {k}, *channels), got {matrix.shape}")
    coefficients = jnp.zeros((pairs.count, *matrix.shape[2:]), matrix.dtype)
    return coefficients.at[mode].add(_weights(value, matrix[0]) * matrix[a, b])


def bilinear(
    basis: AbstractBasis, matrix: Float[Array, "k k channels"], wi: Float[Array, "pairs 3"], wo: Float[Array, "pairs 3"]
) -> Float[Array, "pairs channels"]:
    """h(wi)ᵀ A h(wo) for every channel: one product with A, then a dot; no K x K product per pair."""
    k, channels = matrix.shape[0], matrix.shape[2]
    product = matmul(basis(wi), matrix.reshape(k, k * channels)).reshape(wi.shape[0], k, channels)
    return jnp.sum(product * basis(wo)[:, :, None], axis=1)


def flat_pairs(wi: Array, wo: Array) -> tuple[Float[Array, "pairs 3"], Float[Array, "pairs 3"], tuple]:
    """Both directions broadcast against each other and flattened, and the batch shape."""
    wi, wo = as_directions(wi, wo)
    shape = jnp.broadcast_shapes(wi.shape, wo.shape)
    return jnp.broadcast_to(wi, shape).reshape(-1, 3), jnp.broadcast_to(wo, shape).reshape(-1, 3), shape[:-1]


def _weights(value: np.ndarray, like: Array) -> Array:
    return jnp.asarray(value, like.dtype).reshape(-1, *(1,) * (like.ndim - 1))


def _pair_norm(diagonal: np.ndarray) -> np.ndarray:
    return 1 / np.sqrt(2 * (1 + diagonal))


@lru_cache
def _unordered_pairs(k: int) -> tuple[np.ndarray, np.ndarray]:
    """(a, b) with a <= b, ordered by b: the pairs of a smaller basis come first."""
    b, a = np.tril_indices(k)
    return a.astype(np.int32), b.astype(np.int32)  # int32 for the reason that is given in _isotropic.py


@lru_cache
def _helmholtz_modes(basis: AbstractBasis) -> tuple:
    modes = basis.modes
    a, b = _unordered_pairs(len(modes))
    return tuple((modes[i], modes[j]) for i, j in zip(a, b, strict=True))


@lru_cache
def _tensor_modes(basis: AbstractBasis) -> tuple:
    return tuple((a, b) for a in basis.modes for b in basis.modes)
