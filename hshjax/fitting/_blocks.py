"""Samples block by block, in bounded memory."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, PairFunction
from hshjax.bases import AbstractPairBasis
from hshjax.bases._base import matmul
from hshjax.metrics import with_channels
from hshjax.samples import Samples

ROWS = 4096
"""Samples a block: large enough for the matrix products, small enough for the cache."""

FUSED = 4
"""Channels up to which the fused sum of a series costs less than the row that serves all channels."""


PAIRS = 2**15
"""Of directions that a BRDF is evaluated at together."""


def evaluated(brdf: PairFunction, wi: np.ndarray, wo: np.ndarray) -> Float[np.ndarray, "pairs channels"]:
    """ρ at any number of pairs `(pairs, 3)`, in blocks of one size: it is compiled once. Host arrays."""
    parts = []
    for start in range(0, len(wi), PAIRS):
        block = (jnp.asarray(np.resize(w[start : start + PAIRS], (PAIRS, 3))) for w in (wi, wo))
        parts.append(np.asarray(_call(brdf, *block))[: len(wi) - start])
    return np.concatenate(parts)


@eqx.filter_jit
def _call(brdf: PairFunction, wi: Array, wo: Array) -> Array:
    return with_channels(brdf(wi, wo), 1)


def series(
    basis: AbstractPairBasis,
    coefficients: Float[Array, "modes channels"],
    wi: Float[Array, "n 3"],
    wo: Float[Array, "n 3"],
) -> Float[Array, "n channels"]:
    """Σ c_k B_k at the pairs of a block, small enough for its rows to be formed where the channels are many."""
    if coefficients.shape[1] <= FUSED:
        return basis.evaluate(coefficients, wi, wo)
    return matmul(basis(wi, wo), coefficients)


def fold(
    samples: Samples, rows: int, carry: Array, visit: Callable[[Array, Array, Array, Array, Array], Array]
) -> Array:
    """Fold `visit(carry, wi, wo, value, weight)` over the samples, `rows` at a time, without a copy of them.

    The last block overlaps the one before it; what was seen there already comes with weight 0. Samples of weight 0 may
    hold anything, NaN included: `visit` sees the normal and the value 0 in their place.
    """
    n = samples.size
    rows = min(rows, n)
    if n == 0:
        return carry

    def step(i, carry):
        start = jnp.minimum(i * rows, n - rows)
        block = (samples.wi, samples.wo, samples.value, samples.weight)
        wi, wo, value, weight = (jax.lax.dynamic_slice_in_dim(a, start, rows) for a in block)
        weight = jnp.where(start + jnp.arange(rows) >= i * rows, weight, 0)
        clear = Samples(wi, wo, value, weight).cleared()
        return visit(carry, clear.wi, clear.wo, clear.value, weight)  # a weight of NaN is to be seen

    return jax.lax.fori_loop(0, -(-n // rows), step, carry)
