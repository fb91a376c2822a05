"""Photometric stereo by Lambert's law alone: quick, and what everything else is compared with."""

from typing import Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.photographs import Photographs
from hshjax.stereo._band import band_trust, cosines, scaled_normals
from hshjax.stereo._observe import Observations
from hshjax.stereo._trust import initial_trust, robust_trust

Method = Literal["least squares", "robust", "band"]

ROUNDS = 8
"""Of reweighting."""


class Lambertian(NamedTuple):
    """Host arrays of the pixels of the mask.

    - `normals` `(pixels, 3)`: unit, in the world, see `Stereo`; NaN where photographs do not determine one.
    - `albedo` `(pixels, channels)`: dimensionless, up to the factor that the exposure is; NaN likewise.
    """

    normals: Float[np.ndarray, "pixels 3"]
    albedo: Float[np.ndarray, "pixels channels"]


def lambertian(photographs: Photographs, method: Method = "band") -> Lambertian:
    """Normals and albedo of a matte surface under known lights, by linear least squares in grey values.

    Lights or a camera nearby are taken as in `solve_calibrated`.

    - "least squares": of all values that are known, as Woodham had it. Shadows and highlights bend it.
    - "robust": of those that are not dark, outliers taken off in rounds by Tukey's biweight.
    - "band": of middle ranks, above most shadows and below most highlights. The best start for glossy surfaces.

    Source: Woodham, Photometric Method for Determining Surface Orientation from Multiple Images, Optical Engineering
    19(1), 1980.

    **Raises:** ValueError for photographs that do not determine normals, and for another method.
    """
    if method not in get_args(Method):
        raise ValueError(f"method must be one of {', '.join(get_args(Method))}, got {method!r}")
    observations = Observations(photographs)
    for _ in range(observations.geometry.starts):
        normals = _everywhere(observations, method).normals
        observations = observations.surfaced(np.where(np.isfinite(normals), normals, 0))
    return _everywhere(observations, method)


def _everywhere(observations: Observations, method: Method) -> Lambertian:
    photographs = observations.photographs
    normals = np.empty((photographs.pixels, 3), np.float32)
    albedo = np.empty((photographs.pixels, photographs.channels), np.float32)
    for part, pixels in observations.tiles():
        size, towards = part.stop - part.start, observations.towards(part)
        trust, normal = _solved(pixels.values, pixels.known, towards, method)
        colour = observations.colour(part)
        known = observations.filled(np.isfinite(colour).astype(np.float32))
        colour = observations.filled(np.where(np.isfinite(colour), colour, 0))
        normals[part] = observations.geometry.world(np.asarray(normal)[:size], part)
        albedo[part] = np.asarray(_albedo(colour, known, trust, normal, towards))[:size]
    return Lambertian(normals, albedo)


@eqx.filter_jit
def _solved(
    values: Float[Array, "n lights"],
    known: Float[Array, "n lights"],
    directions: Float[Array, "... lights 3"],
    method: str,
) -> tuple[Float[Array, "n lights"], Float[Array, "n 3"]]:
    """The trust that is left in values, and unit normals; NaN where there is none."""
    if method == "robust":
        plain = initial_trust(values, known)

        def reweighted(_, trust):
            return robust_trust(values - cosines(scaled_normals(values, trust, directions), directions), plain)

        trust = jax.lax.fori_loop(0, ROUNDS, reweighted, plain)
    else:
        trust = known if method == "least squares" else band_trust(values, known)
    scaled = scaled_normals(values, trust, directions)
    return trust, scaled / jnp.sqrt(jnp.sum(scaled * scaled, axis=1, keepdims=True))


@eqx.filter_jit
def _albedo(colour, known, trust, normal, directions) -> Float[Array, "n channels"]:
    """π Σ trust I (n·l) / Σ trust (n·l)²: radiance of unit irradiance is albedo / π times the cosine."""
    cosine = jnp.maximum(cosines(normal, directions), 0)[..., None]
    weight = trust[..., None] * known
    return jnp.pi * jnp.sum(weight * colour * cosine, axis=1) / jnp.sum(weight * cosine**2, axis=1)
