"""How bright lights are, from photographs alone: every light has pixels that face it."""

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.stereo._band import band_trust, cosines, scaled_normals
from hshjax.stereo._learn import Pixels

OF_PIXEL = 0.9
"""Quantile over lights that stands for a pixel: what it shows of the lights that it faces."""

OF_LIGHT = 0.75
"""Quantile over pixels, relative to them, that stands for a light: those that face it. Of 0.85, lights near the camera
come out darker by an eighth than those far from it (`docs/decisions.md`)."""

LIT = 0.3
"""What a light must make of a pixel, relative to its brightness, for the pixel to tell of it."""

WRONG = 0.08
"""Logarithm of a gain that is no chance any more. Smaller ones may be errors of Lambert's law."""


def diffuse_maxima(values: Float[np.ndarray, "pixels lights"], rounds: int = 10) -> Float[np.ndarray, " lights"]:
    """Intensities of lights, geometric mean 1, from grey values: what a pixel shows of the lights that it faces is its
    albedo, and what a light makes of the pixels that face it is its intensity. In turns. NaN are not looked at.

    Wrong where few pixels face a light, and then by a smooth function of its direction; known from methods for
    uncalibrated lights, e.g. Favaro & Papadhimitri, A Closed-Form Solution to Uncalibrated Photometric Stereo via
    Diffuse Maxima, CVPR 2012, in another form.

    **Raises:** ValueError for a light that reaches less than a quarter of the pixels.
    """
    intensity = np.ones(values.shape[1])
    for _ in range(rounds):
        albedo = np.nanquantile(values / intensity, OF_PIXEL, axis=1, keepdims=True)
        lit = albedo[:, 0] > 0
        intensity = intensity * np.nanquantile(values[lit] / (intensity * albedo[lit]), OF_LIGHT, axis=0)
        if not np.all(intensity > 0):
            dark = (np.flatnonzero(~(intensity > 0)) + 1).tolist()
            raise ValueError(f"lights {dark} reach too few pixels: their intensity is not determined")
        intensity /= np.exp(np.mean(np.log(intensity)))
    return intensity


def light_colours(values: Float[np.ndarray, "pixels lights channels"]) -> Float[np.ndarray, "lights channels"]:
    """What channels have of grey under each light, over what they have of it at the median light: the median of
    pixels. Geometric means over lights are 1: the colour that all lights share is not known from that of the surface.
    """
    total = np.mean(values, axis=2, keepdims=True)
    share = np.where(total > 0, values, np.nan) / np.where(total > 0, total, 1)
    share = share / np.nanmedian(np.where(share > 0, share, np.nan), axis=1, keepdims=True)
    colours = np.nanmedian(share, axis=0)
    return colours / np.exp(np.mean(np.log(colours), axis=0))


def band_gains(
    pixels: Pixels, directions: Float[Array, "... lights 3"], rounds: int = 4
) -> Float[np.ndarray, " lights"]:
    """Logarithms of gains, median 0: values of lit pixels over what Lambert's law on middle ranks predicts, in turns.

    **Raises:** ValueError for lights that reach no pixel.
    """
    gains = np.zeros(pixels.values.shape[1])
    for _ in range(rounds):
        given = pixels.under(jnp.asarray(gains, pixels.values.dtype))
        scaled = scaled_normals(given.values, band_trust(given.values, given.known), directions)
        predicted = np.asarray(cosines(scaled, directions))
        lit = (predicted > LIT) & (np.asarray(given.known) > 0)
        if not np.all(np.any(lit, axis=0)):
            dark = (np.flatnonzero(~np.any(lit, axis=0)) + 1).tolist()
            raise ValueError(f"lights {dark} reach no pixel: their intensity is not determined")
        ratio = np.where(lit, np.asarray(given.values) / np.where(lit, predicted, 1), np.nan)
        gains += np.log(np.nanmedian(ratio, axis=0))
        gains -= np.median(gains)
    return gains


def single_gains(
    gains: Float[np.ndarray, " lights"], directions: Float[np.ndarray, "lights 3"]
) -> Float[np.ndarray, " lights"]:
    """Gains of single lights: what differs by more than `WRONG` from a + b·l, 0 elsewhere.

    A part that is linear in the direction is taken for an error of normals, which undoes it. By least absolute
    deviations, in rounds of weights.
    """
    columns = np.concatenate([np.ones((len(gains), 1)), directions], axis=1)
    rest = gains - np.median(gains)
    for _ in range(20):
        weight = 1 / np.sqrt(np.maximum(np.abs(rest), 1e-3))
        found = np.linalg.lstsq(weight[:, None] * columns, weight * gains, rcond=None)[0]
        rest = gains - columns @ found
    return np.where(np.abs(rest) > WRONG, rest, 0)
