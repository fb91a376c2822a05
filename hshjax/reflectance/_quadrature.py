"""Eq. 1 as a sum over the light's emitters: for any BRDF and any light."""

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float, PairFunction
from hshjax.geometry import frame, to_local, upper
from hshjax.lighting import AbstractLighting, Points
from hshjax.reflectance._given import Given

PAIRS = 2**15
"""Pairs of a point and an emitter that are looked at together unless the caller says otherwise: some MB, in the cache.

With 2^18 a GGX lobe under 32768 emitters took 1.4 times as long.
"""


@eqx.filter_jit
def sum_over_emitters(
    brdf: PairFunction, lighting: AbstractLighting, given: Given, chunk: int | None
) -> Float[Array, "n channels"]:
    """Radiance that leaves points."""
    n = given.normals.shape[0]
    chunk = max(1, min(PAIRS // lighting.emitters if chunk is None else chunk, n))
    blocks = -(-n // chunk)
    # The last block is filled up with the first points: values that are made up might have no finite derivative.
    index = jnp.arange(blocks * chunk).reshape(blocks, chunk) % max(n, 1)

    @jax.checkpoint
    def block(part):
        normals, view, positions, index = part
        return _radiance(brdf, lighting, Points(frame(normals), positions, index, given.pixels), view)

    normals, view, positions = (None if a is None else a[index] for a in (given.normals, given.view, given.positions))
    radiance = jax.lax.map(block, (normals, view, positions, index))
    return radiance.reshape(blocks * chunk, radiance.shape[2])[:n]


def _radiance(brdf: PairFunction, lighting: AbstractLighting, points: Points, view: Float[Array, "n 3"]) -> Array:
    incident = lighting.incident(points)
    wi = to_local(points.frame[:, None], incident.direction)
    wo = jnp.broadcast_to(to_local(points.frame, view)[:, None], wi.shape)
    return jnp.sum(brdf(wi, wo) * upper(wi[..., 2:]) * incident.irradiance, axis=1)
