"""Brightness of pixels that many lights make shine: a high quantile of their values is highlight, and beside it all
that is diffuse looks like shadow.

Where a lower brightness lets Lambert's law explain clearly more of the values, it is the one.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float
from hshjax.stereo._band import band_trust, cosines, scaled_normals
from hshjax.stereo._trust import DARK, quantile

RANKS = (0.75, 0.5)
"""Quantiles that may lie below the highlights."""

TIMES = 2.0
"""The brightness to try, over the median of what is not dark beside such a quantile: as cosines have it."""

CLEARLY, MOST = 0.1, 0.5
"""Share of values by which a lower brightness must explain more, and which it must explain: interreflection in a pixel
that lies in shadow under most lights is smooth, too, but by far less."""

RELATIVE, ABSOLUTE = 0.25, 0.03
"""Errors of a value that is explained, of the greater of it and its prediction, and of the brightness."""


def below_highlights(
    values: Float[np.ndarray, "pixels lights"],
    level: Float[np.ndarray, "pixels 1"],
    directions: Float[Array, "... lights 3"],
) -> Float[np.ndarray, "pixels 1"]:
    """`level`, the `brightness` of values (NaN: unknown), or a lower one.

    A pixel in shadow under most lights keeps its level: beside a lower one its shadows have values that no normal
    explains.
    """
    known = np.isfinite(values)
    filled = np.where(known, values, 0)

    def share(level):
        return np.asarray(_explained(jnp.asarray(filled / level), jnp.asarray(known), directions))

    best = share(level)
    for rank in RANKS:
        lit = np.where(values > DARK * quantile(values, rank), values, np.nan)
        lower = TIMES * quantile(lit, 0.5)
        found = np.where((lower > 0) & (lower < level), lower, level)
        explained = share(found)
        better = (explained > best + CLEARLY) & (explained > MOST)
        best, level = np.where(better, explained, best), np.where(better[:, None], found, level)
    return level


@eqx.filter_jit
def _explained(
    values: Float[Array, "n lights"], known: Bool[Array, "n lights"], directions: Float[Array, "... lights 3"]
) -> Float[Array, " n"]:
    """Share of known values that Lambert's law on middle ranks predicts."""
    weight = known.astype(values.dtype)
    predicted = jnp.maximum(cosines(scaled_normals(values, band_trust(values, weight), directions), directions), 0)
    near = jnp.abs(values - predicted) < RELATIVE * jnp.maximum(values, predicted) + ABSOLUTE
    return jnp.sum(jnp.where(near, weight, 0), axis=1) / jnp.maximum(jnp.sum(weight, axis=1), 1)
