"""How far a BRDF is from samples, in a named norm."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import Mesh

from hshjax._typing import Array, Float, PairFunction
from hshjax.bases._base import matmul
from hshjax.brdfs._base import AbstractBRDF
from hshjax.brdfs._linear import LinearBRDF, foreshortening
from hshjax.fitting._blocks import ROWS, series
from hshjax.fitting._mesh import fold_each
from hshjax.fitting._norms import named_norm
from hshjax.samples import Samples


def relative_error(brdf: PairFunction, samples: Samples, norm: str = "D") -> Float[Array, " channels"]:
    """sqrt(Σ w |ρ - ρ̂|² / Σ w |ρ|²) per channel, in the judge's weight of the norm "A" ... "E" (see `NORMS`).

    Any BRDF against any samples: a fit on those it has not seen, say. Weight 0 masks a sample. NaN where no sample
    counts, as norm E beyond 80 degrees. In bounded memory.
    """
    error, size = misfit(brdf, samples, norm)
    return ratio(error, size)


@jax.jit
def ratio(error: Float[Array, " channels"], size: Float[Array, " channels"]) -> Float[Array, " channels"]:
    """error / size; 0 for a black channel that is met exactly, NaN where nothing was compared."""
    return jnp.where(error == 0, error, error / jnp.where(error == 0, 1, size))


@eqx.filter_jit
def misfit(
    brdf: PairFunction, samples: Samples, norm: str, mesh: Mesh | None = None
) -> tuple[Float[Array, " channels"], Float[Array, " channels"]]:
    """Numerator and denominator of `relative_error`. With a flat mesh, of samples that are `spread` over it."""
    judge = named_norm(norm)
    if isinstance(brdf, LinearBRDF):
        brdf = _InBlocks(brdf)

    arrays, rest = eqx.partition(brdf, eqx.is_array)

    def visit(arrays, sums, wi, wo, value, weight):
        brdf = eqx.combine(arrays, rest)
        weight = weight * judge.judge_weight(wi, wo)
        value = jnp.where((weight > 0)[:, None], value, 0)
        error = jnp.where((weight > 0)[:, None], brdf(wi, wo) - value, 0)
        return sums + jnp.stack([matmul(weight, error**2), matmul(weight, value**2)])

    empty = jnp.zeros((2, samples.channels), samples.value.dtype)
    sums = jnp.sum(fold_each(mesh, samples, ROWS, empty, visit, arrays), axis=0)
    compared = jnp.any(samples.weight * judge.judge_weight(samples.wi, samples.wo) > 0)
    error, size = jnp.where(compared, jnp.sqrt(sums), jnp.nan)
    return error, size


class _InBlocks(AbstractBRDF):
    """A `LinearBRDF` that is called for a block of samples at a time."""

    brdf: LinearBRDF

    def formula(self, wi, wo):
        values = series(self.brdf.basis, self.brdf.coefficients, wi, wo)
        return values / foreshortening(wi, wo, self.brdf.target)[..., None]
