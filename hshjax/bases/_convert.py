"""Between bases: embed, truncate, pad, factorise; the paper's ordered series."""

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array, Float, Real
from hshjax.bases._base import AbstractBasis, check_modes
from hshjax.bases._pairs import AbstractProductBasis, HelmholtzBasis, from_matrix, to_matrix
from hshjax.geometry import common_dtype


def convert(
    source: AbstractBasis | AbstractProductBasis,
    coefficients: Float[Array, " modes *channels"],
    target: AbstractBasis | AbstractProductBasis,
) -> Real:
    """Coefficients `(modes of target, *channels)` of the nearest function (in L2) that `target` can say.

    Both sides build on the same family (HSH, Zernike or SHR) and differ in order, symmetry or both: a higher order pads
    with zeros, a lower one truncates; isotropic embeds exactly in Helmholtz and Helmholtz in tensor, and the ways back
    project.

    **Raises:** ValueError for different families, or a single basis against a pair basis.
    """
    coefficients = jnp.asarray(coefficients)
    if isinstance(source, AbstractBasis) and type(source) is type(target):
        check_modes(source, coefficients)
        return _resized(coefficients, (target.count,))
    if (
        isinstance(source, AbstractProductBasis)
        and isinstance(target, AbstractProductBasis)
        and type(source.basis) is type(target.basis)
    ):
        k = target.basis.count
        return from_matrix(target, _resized(to_matrix(source, coefficients), (k, k)))
    raise ValueError(f"convert needs two bases, or two pair bases, of one family; got {source} and {target}")


def from_ordered(pairs: HelmholtzBasis, series: Float[Array, "k k *channels"]) -> Real:
    """The paper's a_np^mq of Eq. 3, `(K, K, *channels)` over ordered pairs, as coefficients over unordered ones.

    Eq. 3 counts every function with a ≠ b twice: its two coefficients add.
    """
    k = pairs.basis.count
    if series.shape[:2] != (k, k):
        raise ValueError(f"the ordered series of {pairs} must have shape ({k}, {k}, *channels), got {series.shape}")
    a, b = pairs.unordered()
    both = series[a, b] + series[b, a]
    return jnp.where(_column(a == b, both), both / 2, both)


def to_ordered(pairs: HelmholtzBasis, coefficients: Float[Array, " modes *channels"]) -> Real:
    """The ordered series of Eq. 3 with a_np^mq = a_pn^qm, the one of least norm among those that say the same."""
    check_modes(pairs, coefficients)
    k, (a, b) = pairs.basis.count, pairs.unordered()
    half = jnp.where(_column(a == b, coefficients), coefficients, coefficients / 2)
    empty = jnp.zeros((k, k, *coefficients.shape[1:]), coefficients.dtype)
    return empty.at[a, b].set(half).at[b, a].set(half)


class LowRank(eqx.Module):
    """A reciprocal function h(wi)ᵀ A h(wo) with A = Σ_r λ_r v_r v_rᵀ, one factorisation a channel.

    A is what a series stands for: of a `LinearBRDF` with another target than "brdf" it is a foreshortened BRDF, and to
    be divided by the cosines as there.

    - `values`: λ, `(rank, channels)`, by falling modulus. - `vectors`: v, `(modes, rank, channels)`.
    - `error`: ||A - Σ λ v vᵀ||_F / ||A||_F per channel, which is the relative L2 error of the function.
    """

    basis: AbstractBasis
    values: Float[Array, "rank channels"]
    vectors: Float[Array, "modes rank channels"]
    error: Float[Array, " channels"]

    def matrix(self) -> Float[Array, "modes modes channels"]:
        """A as it was kept, `(modes, modes, channels)`."""
        return jnp.einsum("arc,rc,brc->abc", self.vectors, self.values, self.vectors, precision="highest")

    def evaluate(self, wi: Float[Array, "... 3"], wo: Float[Array, "... 3"]) -> Real:
        """Σ_r λ_r (v_r·h(wi)) (v_r·h(wo)), `(*batch, channels)`: 2 rank fused sums in place of a K x K product."""
        vectors, values, wi, wo = common_dtype(self.vectors, self.values, wi, wo)
        product = self.basis.evaluate(vectors, wi) * self.basis.evaluate(vectors, wo)
        return jnp.sum(product * values.reshape((1,) * (product.ndim - 2) + values.shape), axis=-2)


def factorize(basis: AbstractBasis, matrix: Float[Array, "modes modes channels"], rank: int) -> LowRank:
    """The best rank-r approximation in L2 of a reciprocal function, by the eigenvectors of its symmetric matrix A.

    **Raises:** ValueError for a rank outside 1 ... K or a matrix of the wrong shape. Only the symmetric part is read.
    """
    k = basis.count
    if matrix.ndim != 3 or matrix.shape[:2] != (k, k):
        raise ValueError(f"the matrix of {basis} must have shape ({k}, {k}, channels), got {matrix.shape}")
    if not 1 <= rank <= k:
        raise ValueError(f"rank must lie in 1 ... {k}, got {rank}")
    stacked = jnp.moveaxis(matrix, -1, 0)
    values, vectors = jnp.linalg.eigh((stacked + jnp.swapaxes(stacked, 1, 2)) / 2)
    order = jnp.argsort(-jnp.abs(values), axis=-1)
    values = jnp.take_along_axis(values, order, axis=-1)
    vectors = jnp.take_along_axis(vectors, order[:, None, :], axis=-1)
    energy = jnp.cumsum(values[:, ::-1] ** 2, axis=-1)[:, ::-1]  # of the eigenvalues from r on
    dropped = energy[:, rank] if rank < k else jnp.zeros_like(energy[:, 0])
    error = jnp.sqrt(dropped / jnp.where(energy[:, 0] > 0, energy[:, 0], 1))
    return LowRank(basis, values[:, :rank].T, jnp.transpose(vectors[:, :, :rank], (1, 2, 0)), error)


def _resized(array: Array, sizes: tuple[int, ...]) -> Array:
    """The leading axes cut or padded with zeros to `sizes`."""
    array = array[tuple(slice(0, n) for n in sizes)]
    widths = [(0, n - have) for n, have in zip(sizes, array.shape, strict=False)]
    return jnp.pad(array, widths + [(0, 0)] * (array.ndim - len(sizes)))


def _column(flag, like: Array) -> Array:
    return jnp.asarray(flag).reshape(-1, *(1,) * (like.ndim - 1))
