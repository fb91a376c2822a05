"""The reflectance equation, Eq. 1 of the paper: radiance that leaves a surface under a light.

    R(n, v) = ∫ L(w) ρ(wi, wo) max(n·w, 0) dω,   wi, wo: w and v in the local frame of n

as a sum over the light's emitters, for any BRDF and any light, differentiable in both and in the normals.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float, PairFunction, Real
from hshjax.geometry import as_directions, frame, upper
from hshjax.lighting import AbstractLighting, Points

PAIRS = 2**18
"""Pairs of a point and an emitter that are looked at together unless the caller says otherwise: some tens of MB."""


def reflect(
    brdf: PairFunction,
    lighting: AbstractLighting,
    normals: Float[Array, "*batch 3"],
    view: Float[Array, "... 3"],
    *,
    positions: Float[Array, "... 3"] | None = None,
    chunk: int | None = None,
) -> Real:
    """Radiance `(*batch, channels)` [W m^-2 sr^-1] that leaves points towards the eye.

    - `brdf`: a BRDF, or any function of pairs of directions [sr^-1].
    - `normals` `(*batch, 3)`: unit, in the world. A zero vector marks a pixel without a surface: it is black.
    - `view`: unit, in the world, from the points TOWARDS the eye; `(3,)` for orthographic views, or one for each point.
    - `positions` `(*batch, 3)`: in the world; lights nearby need them.
    - `chunk`: points that are looked at together; None: as many as make 2^18 pairs with the light's emitters. Memory
      grows with it, in derivatives too: what a chunk computed is computed again instead of being kept.

    Light from below the horizon of a point does not reach it (attached shadows). The result has the common dtype of
    normals, view and positions. An anisotropic BRDF is turned as `hshjax.geometry.frame` of the normal says.

    **Raises:** ValueError for a light that needs positions and gets none, and for shapes that do not fit.
    """
    normals, view = as_directions(normals, view)
    if positions is not None:
        normals, view, positions = as_directions(normals, view, positions)
    elif lighting.needs_positions:
        raise ValueError("this light depends on where the points are: give their positions")
    given = {"normals": normals, "view": view, "positions": positions}
    for name, array in given.items():
        if array is not None and array.shape not in (normals.shape, (3,)):
            raise ValueError(f"{name} must have shape (3,) or that of the normals, {normals.shape}, got {array.shape}")
    if chunk is None:
        chunk = max(1, PAIRS // lighting.emitters)
    elif chunk < 1:
        raise ValueError(f"chunk must be >= 1, got {chunk}")
    flat = jax.tree.map(lambda array: jnp.broadcast_to(array, normals.shape).reshape(-1, 3), given)
    radiance = _in_chunks(brdf, lighting, flat, chunk)
    return radiance.reshape(*normals.shape[:-1], radiance.shape[1])


@eqx.filter_jit
def _in_chunks(
    brdf: PairFunction, lighting: AbstractLighting, given: dict[str, Any], chunk: int
) -> Float[Array, "n channels"]:
    n = given["normals"].shape[0]
    chunk = max(1, min(chunk, n))
    blocks = -(-n // chunk)
    # The last block is filled up with the first points: values that are made up might have no finite derivative.
    index = jnp.arange(blocks * chunk).reshape(blocks, chunk) % max(n, 1)

    @jax.checkpoint
    def block(part):
        given, index = part
        return _radiance(brdf, lighting, Points(frame(given["normals"]), given["positions"], index), given["view"])

    radiance = jax.lax.map(block, (jax.tree.map(lambda array: array[index], given), index))
    return radiance.reshape(blocks * chunk, radiance.shape[2])[:n]


def _radiance(brdf: PairFunction, lighting: AbstractLighting, points: Points, view: Float[Array, "n 3"]) -> Array:
    incident = lighting.incident(points)
    turn, exact = points.frame, jax.lax.Precision.HIGHEST
    shape = (turn.shape[0], *incident.direction.shape[1:])
    wi = jnp.einsum("nij,nej->nei", turn, jnp.broadcast_to(incident.direction, shape), precision=exact)
    wo = jnp.broadcast_to(jnp.einsum("nij,nj->ni", turn, view, precision=exact)[:, None], shape)
    return jnp.sum(brdf(wi, wo) * upper(wi[..., 2:]) * incident.irradiance, axis=1)
