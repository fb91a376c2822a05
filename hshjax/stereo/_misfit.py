"""What candidates for a normal are compared by: how badly values fit, where no value counts for much."""

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.stereo._refine import weigh
from hshjax.stereo._shading import AbstractShadingTable
from hshjax.stereo._trust import biweight

CUT = 0.15
"""Where the cost of a value's misfit ends to grow."""


@eqx.filter_jit
def misfit(
    table: AbstractShadingTable,
    values: Float[Array, "n lights"],
    trust: Float[Array, "n lights"],
    scale: Float[Array, "n 1"],
    pq: Float[Array, "n 2"],
) -> Float[Array, " n"]:
    """Mean over values of min(|residual| sqrt(trust), `CUT`), weights of materials found without outliers.

    - `trust`: before residuals are looked at. - `scale`: of a pixel's residuals, the same for all that are compared.
    """
    shading = table.at(pq)
    weights, _ = weigh(shading, values, trust)
    residual = values - jnp.sum(weights[..., None] * shading, axis=1)
    weights, _ = weigh(shading, values, trust * biweight(residual, scale))
    residual = values - jnp.sum(weights[..., None] * shading, axis=1)
    return jnp.mean(jnp.minimum(jnp.abs(residual) * jnp.sqrt(trust), CUT), axis=1)
