"""How much a value counts: noise grows with brightness, dark values are shadows, what does not fit is an outlier."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float

BRIGHT = 0.9
"""Quantile over lights that a pixel is divided by: above most shadows, below most highlights."""

DARK = 0.15
"""Of that quantile: what is darker may lie in shadow, lit by other parts of the object."""

SHADOWS = 0.3
"""Trust of dark values where shared unknowns are learned and minima compared, relative to that at the limit."""

CUT = 3.0
"""Scales beyond which a value counts for nothing."""


def brightness(values: Float[np.ndarray, "pixels lights"]) -> Float[np.ndarray, "pixels 1"]:
    """What pixels are divided by, so that all count alike: a high quantile of what is known. 1 for black pixels."""
    level = quantile(values, BRIGHT)
    return np.where(level > 0, level, 1).astype(values.dtype)


def quantile(values: Float[np.ndarray, "pixels lights"], rank: float) -> Float[np.ndarray, "pixels 1"]:
    """Of the known values of each pixel, linear between ranks; 0 where nothing is known (NaN)."""
    ordered, last = np.sort(values, axis=1), np.sum(~np.isnan(values), axis=1, keepdims=True) - 1  # NaN come last
    place = rank * np.maximum(last, 0)
    below = place.astype(int)
    low, high = (np.take_along_axis(ordered, np.clip(k, 0, last.clip(0)), axis=1) for k in (below, below + 1))
    return np.where(last >= 0, low + (place - below) * (high - low), 0).astype(values.dtype)


def initial_trust(
    values: Float[Array, "n lights"], known: Float[Array, "n lights"], dark: float = 0.0
) -> Float[Array, "n lights"]:
    """1 / sqrt(I + 0.1) of values relative to `brightness`, as photon noise and a floor have it; 0 where unknown.

    Below `DARK` it is `dark` times what it is there: 0 for normals, which shadows would bend; more for what is learned
    of all pixels together, for shadows tell of light that strays.
    """
    lit = 1 / jnp.sqrt(jnp.maximum(values, DARK) + 0.1)
    return known * jnp.where(values > DARK, lit, dark * lit)


@eqx.filter_jit
def robust_trust(residual: Float[Array, "n lights"], initial: Float[Array, "n lights"]) -> Float[Array, "n lights"]:
    """Tukey's biweight of residuals [relative to `brightness`] times the initial trust.

    Source: Beaton & Tukey, The Fitting of Power Series, Meaning Polynomials, Technometrics 16(2), 1974.
    """
    return initial * biweight(residual, residual_scale(residual, initial > 0))


def residual_scale(residual: Float[Array, "n lights"], among: Bool[Array, "n lights"]) -> Float[Array, "n 1"]:
    """1.5 median |r| + 0.01, of some values of each pixel. Cast shadows are not among them: a pixel that lies in the
    shadow of others under half of the lights would fit whatever it shows."""
    return 1.5 * median(jnp.abs(residual), among) + 0.01


def median(values: Float[Array, "n lights"], among: Bool[Array, "n lights"]) -> Float[Array, "n 1"]:
    """The median of some values >= 0 (of an even number, the lower of the middle two) to 2^-14 of the largest of them;
    0 of none.

    By bisection: XLA's sort of a short row on a CPU takes fifty times as long.
    """
    half = (jnp.sum(among.astype(jnp.int32), axis=1, keepdims=True) + 1) // 2

    def halve(_, bounds):
        low, high = bounds
        middle = (low + high) / 2
        below = jnp.sum((among & (values <= middle)).astype(jnp.int32), axis=1, keepdims=True) >= half
        return jnp.where(below, low, middle), jnp.where(below, middle, high)

    high = jnp.max(jnp.where(among, values, 0), axis=1, keepdims=True)
    return jax.lax.fori_loop(0, 14, halve, (jnp.zeros_like(high), high))[1]


def biweight(residual: Float[Array, "n lights"], scale: Float[Array, "n 1"]) -> Float[Array, "n lights"]:
    """(1 - (r / 3 scale)²)², 0 beyond three scales."""
    x = residual / (CUT * scale)
    return jnp.where(jnp.abs(x) < 1, (1 - x * x) ** 2, 0)
