"""The closed form over samples that no memory holds: one pass over blocks, from wherever they come.

The factor R of the weighted design matrix is all that least squares needs to know of the samples, and R of two blocks
is that of their two R, one above the other. A block is read, folded into the factor, and forgotten.
"""

from collections.abc import Iterable, Iterator
from functools import partial

import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.bases import AbstractPairBasis
from hshjax.bases._base import matmul
from hshjax.brdfs._linear import LinearBRDF, cosine_power
from hshjax.fitting._checks import Counts, check_determined, check_enough, check_isotropy, check_values
from hshjax.fitting._lapack import suited_threads
from hshjax.fitting._misfit import ratio
from hshjax.fitting._norms import Norm, named_norm
from hshjax.fitting._prior import Prior, penalty
from hshjax.fitting._project import factorize, posterior_of, solve_factor
from hshjax.fitting._result import Fit
from hshjax.fitting._sample_blocks import BlockError, filled, read_blocks, regrouped
from hshjax.samples import Samples

STEP = 2**16
"""Samples that one call of the compiled program folds."""


def project_blocks(
    basis: AbstractPairBasis,
    blocks: Iterable[Samples],
    *,
    norm: str = "D",
    ridge: float = 0.0,
    prior: Prior | None = None,
    covariance: bool = False,
) -> Fit[LinearBRDF]:
    """`project`, in one pass over blocks of samples, of which one at a time is held.

    - `blocks`: anything that yields `Samples` of the same channels, dtype and `isotropic`, of any sizes: a list, a
      generator, `SampleBlocks` over files. Where it has a length, so many blocks must come.
    - `basis`, `norm`, `ridge`, `prior`, `covariance`: see `project`. Least squares by QR throughout: a rule that comes
      in blocks is not recognised as exact. Reciprocity of the data is not measured.

    **Returns:** the `Fit` that `project` gives of all samples together, to rounding.

    **Raises:** BlockError, naming the block, for one that is no `Samples`, differs from the first in channels, dtype
    or `isotropic`, or holds what `project` refuses, and where fewer or more blocks come than the length says. What
    reading raises is passed on, with a note that names the block. ValueError as of `project` where all blocks together
    do not determine the fit.
    """
    chosen = named_norm(norm)
    gamma = penalty(basis, ridge, prior)
    sums = _Sums(basis, chosen)
    with suited_threads(basis.count):
        for samples in regrouped(sums.counted(blocks), STEP):
            sums.add(samples)
        check_enough(sums.counts, chosen, basis.count, ridged=gamma is not None)
        assert sums.factor is not None  # or there was no sample
        coefficients, condition, root = jax.block_until_ready(solve_factor(sums.factor, gamma, basis.count))
    check_determined(condition, basis.count, ridged=gamma is not None)
    residual, size = _misfit(sums.factor if sums.judged is None else sums.judged, coefficients)
    spread = noise = None
    if covariance:
        spread, noise = posterior_of(sums.factor, root, coefficients, jnp.asarray(sums.seen))
    return Fit(
        LinearBRDF(basis, coefficients, chosen.target),
        residual,
        ratio(residual, size),
        condition,
        norm=norm,
        method="QR",
        samples=sums.counts.used,
        unknowns=basis.count,
        covariance=spread,
        noise=noise,
    )


class _Sums:
    """What is known of the blocks so far.

    `factor`: R of [sqrt(w) B, sqrt(w) f] under the weight of the fit; `judged`: under that of the judge, None where it
    is the same. `counts` of samples; `seen`: those that have a weight in the fit.
    """

    def __init__(self, basis: AbstractPairBasis, norm: Norm):
        self.basis, self.norm = basis, norm
        self.counts, self.seen = Counts(0, 0, 0, 0.0), 0
        self.factor: Array | None = None
        self.judged: Array | None = None

    def counted(self, blocks: Iterable[Samples]) -> Iterator[Samples]:
        """The blocks, each checked and counted before it is handed on."""
        for number, samples in read_blocks(blocks):
            try:
                check_isotropy(self.basis, samples)
                # Filled up to a power of two: a program is compiled for every size.
                whole = filled(samples, 1 << (samples.size - 1).bit_length())
                self.counts = self.counts.plus(check_values(whole, self.norm, samples.size))
            except ValueError as error:
                raise BlockError(number, str(error)) from error
            yield samples

    def add(self, samples: Samples) -> None:
        """Fold samples into the factors."""
        self.factor = _folded(self.basis, self.norm, self.factor, samples)
        if self.norm.judge_series != self.norm.fit:
            power = cosine_power(samples.wi, samples.wo, self.norm.judge_series - self.norm.fit)
            judged = samples.reweighted(samples.weight * power)
            self.judged = _folded(self.basis, self.norm, self.judged, judged)
        self.seen += int(_seen(self.norm, samples))


def _folded(basis: AbstractPairBasis, norm: Norm, factor: Array | None, samples: Samples) -> Array:
    new = factorize(basis, norm, samples)
    return new if factor is None else _merged(factor, new)


@jax.jit
def _merged(above: Float[Array, "n n"], below: Float[Array, "n n"]) -> Float[Array, "n n"]:
    return jnp.linalg.qr(jnp.concatenate([above, below]), mode="r")


@partial(jax.jit, static_argnums=0)
def _seen(norm: Norm, samples: Samples) -> Array:
    return jnp.sum(samples.weight * norm.fit_weight(samples.wi, samples.wo) > 0)


@jax.jit
def _misfit(factor: Array, coefficients: Float[Array, "modes channels"]) -> tuple[Array, Array]:
    """Root of Σ w |f - Σ c B|² and of Σ w |f|² by channel, of the samples behind a factor."""
    channels = coefficients.shape[1]
    size = jnp.linalg.norm(factor[:, -channels:], axis=0)
    difference = matmul(factor, jnp.concatenate([coefficients, -jnp.eye(channels, dtype=factor.dtype)]))
    return jnp.linalg.norm(difference, axis=0), size
