"""Eq. 1 by Monte Carlo: for lobes that no rule resolves, with the variance of what it says."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float, PairFunction, Real
from hshjax.camera import AbstractCamera
from hshjax.geometry import frame, to_local, to_world, upper
from hshjax.lighting import AbstractLighting, EnvironmentMap, HarmonicLight
from hshjax.reflectance._given import given
from hshjax.reflectance._parts import lights_of
from hshjax.reflectance._proposals import CosineProposal, LobeProposal, MapProposal

POINTS = 4096
"""Points that are looked at together."""


class Estimate(NamedTuple):
    """Radiance `(*batch, channels)` [W m^-2 sr^-1], and the variance of that estimate."""

    radiance: Real
    variance: Real


def monte_carlo(
    brdf: PairFunction,
    lighting: AbstractLighting,
    normals: Float[Array, "*batch 3"],
    view: Float[Array, "... 3"] | AbstractCamera,
    *,
    key: Array,
    samples: int,
    lobes: Sequence[float] = (0.05, 0.2, 0.5),
    positions: Float[Array, "... 3"] | None = None,
) -> Estimate:
    """An unbiased estimate of `reflect` under light from everywhere around, `HarmonicLight` or `EnvironmentMap`.

    A map counts as what it is when it is called: bilinear between its pixels; `reflect` sums over their centres.

    Directions come from a mixture in equal parts: by the cosine; by GGX lobes about the mirror direction of roughness
    `lobes`, for whatever highlights the BRDF has; by the pixels of each map. Its density is the sum of theirs (balance
    heuristic), so that none of them needs to fit: one that does not costs samples, not exactness.

    - `samples`: directions for each point, at least 2; rounded up so that each proposal draws as many, and at least 2.
    - `lobes`: in (0, 1]. - `key`: of `jax.random`.

    Differentiable in BRDF, light and view: derivatives are those of the sum, at directions that stay. An emitter from
    one direction (`DirectionalLight`, `PointLight`) has no density: `reflect` is exact there.

    Source: Veach, Robust Monte Carlo Methods for Light Transport Simulation (1997), chapter 9; Walter et al.,
    Microfacet Models for Refraction through Rough Surfaces (2007), eq. 35.

    **Raises:** ValueError for other lights or lobes, fewer than 2 samples, or shapes that do not fit.
    """
    for roughness in lobes:
        if not 0 < roughness <= 1:
            raise ValueError(f"lobes are of a roughness above 0 and up to 1, got {roughness}")
    lights = lights_of(lighting)
    for light in lights:
        if not isinstance(light, HarmonicLight | EnvironmentMap):
            raise ValueError(f"no directions can be drawn for a {type(light).__name__}: use reflect, and add")
    proposals = [CosineProposal(), *(LobeProposal(jnp.asarray(a, float)) for a in lobes)]
    proposals += [MapProposal(light) for light in lights if isinstance(light, EnvironmentMap)]
    steps = -(-samples // len(proposals))
    if samples < 2:
        raise ValueError(f"a variance takes 2 samples or more, got {samples}")
    points = given(lighting, normals, view, positions)
    mean, variance = _estimate(brdf, lights, proposals, points.normals, points.view, key, max(2, steps))
    shape = (*points.pixels, mean.shape[1])
    return Estimate(mean.reshape(shape), variance.reshape(shape))


@eqx.filter_jit
def _estimate(brdf, lights, proposals, normals, view, key, steps) -> tuple[Array, Array]:
    n = normals.shape[0]
    chunk = max(1, min(POINTS, n))
    blocks = -(-n // chunk)
    index = jnp.arange(blocks * chunk).reshape(blocks, chunk) % max(n, 1)  # as in the sum over emitters

    def block(part):
        normals, view, key = part
        return _of_points(brdf, lights, proposals, normals, view, key, steps)

    found = jax.lax.map(block, (normals[index], view[index], jax.random.split(key, blocks)))
    mean, variance = (array.reshape(blocks * chunk, array.shape[2])[:n] for array in found)
    return mean, variance


def _of_points(brdf, lights, proposals, normals, view, key, steps) -> tuple[Array, Array]:
    """Mean and variance over steps, each of one direction from every proposal."""
    turn = frame(normals)
    wo = to_local(turn, view)
    seen = wo[:, 2:] > 0
    fixed = jax.lax.stop_gradient((wo, turn))

    @jax.checkpoint
    def once(key):
        keys = jax.random.split(key, len(proposals))
        drawn = jnp.stack([p.draw(k, *fixed) for p, k in zip(proposals, keys, strict=True)], axis=1)
        density = sum(p.density(drawn, *fixed) for p in proposals) / len(proposals)
        # Directions stay in the world while normals turn: what they bring depends smoothly on the normals.
        w = jax.lax.stop_gradient(to_world(fixed[1][:, None], drawn))
        weight = jax.lax.stop_gradient(jnp.where((density > 0) & seen, 1 / jnp.where(density > 0, density, 1), 0))
        wi = to_local(turn[:, None], w)
        radiance = sum(light(w) for light in lights)
        value = brdf(wi, jnp.broadcast_to(wo[:, None], wi.shape)) * upper(wi[..., 2:]) * radiance
        return jnp.mean(value * weight[..., None], axis=1)

    def step(state, part):
        mean, squares = state
        count, key = part
        value = once(key)
        change = value - mean
        mean = mean + change / count
        return (mean, squares + change * (value - mean)), None

    keys = jax.random.split(key, steps)
    start = once(keys[0])
    counts = jnp.arange(2, steps + 1).astype(start.dtype)
    (mean, squares), _ = jax.lax.scan(step, (start, jnp.zeros_like(start)), (counts, keys[1:]))
    return mean, squares / (steps * (steps - 1))
