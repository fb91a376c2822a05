"""Where a table has values of its own, and where it can only guess."""

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array, Bool, Float, PairFunction
from hshjax.brdfs._angle_table import AngleTable
from hshjax.brdfs._base import ScaledBRDF, SumBRDF
from hshjax.brdfs._half_vector_table import HalfVectorTable
from hshjax.quadrature import PairRule
from hshjax.samples import Samples


def known(brdf: PairFunction, wi: Float[Array, "n 3"], wo: Float[Array, "n 3"]) -> Bool[Array, " n"]:
    """Whether a BRDF has a value at pairs: a table, which is 0 at nodes that were not measured and in cells without
    any, has none there; a sum has one where all its terms have. Everything else has values everywhere.
    """
    if isinstance(brdf, SumBRDF):
        return known(brdf.a, wi, wo) & known(brdf.b, wi, wo)
    if isinstance(brdf, ScaledBRDF):
        return known(brdf.brdf, wi, wo)
    if not isinstance(brdf, AngleTable | HalfVectorTable) or brdf.measured is None:
        return jnp.ones(wi.shape[0], bool)
    # Interpolation scales the weights of measured nodes to a sum of 1: a table of ones is 1 where there are any.
    ones = eqx.tree_at(lambda table: table.values, brdf, jnp.ones_like(brdf.values))
    return ones(wi, wo)[:, 0] > 0.5


def table_samples(brdf: PairFunction, rule: PairRule) -> Samples:
    """`Samples.from_function`, with weight 0 where the table has no value; then they are no whole rule."""
    samples = Samples.from_function(brdf, rule)
    there = known(brdf, rule.wi, rule.wo)
    return samples if bool(jnp.all(there)) else samples.reweighted(jnp.where(there, samples.weight, 0))
