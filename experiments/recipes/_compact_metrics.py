"""What compact models are judged by: a table that follows the highlight, images of spheres, measured pairs, albedo."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.linalg import block_diag

from experiments.recipes._blocks import square_blocks
from hshjax import (
    DirectionalLight,
    EnvironmentMap,
    LogLinearBRDF,
    OrthographicCamera,
    angles,
    direction,
    half_vector,
    half_vector_samples,
    plotting,
    reflect,
    sphere,
)
from hshjax.io import read_exr

SHAPE = (90, 30, 12)
"""Cells of the table in sqrt(θ_h), θ_d, φ_d."""

LARGEST = float(np.radians(80))
LAMPS = (((0.55, 0.55, 0.63), 2.0), ((-0.9, 0.3, 0.32), 1.2), ((0.2, -0.75, 0.63), 0.8))
CEILING = 80.0
"""Of a peak signal-to-noise ratio [dB]."""


class Cells(NamedTuple):
    """Pairs `(n, 3)` of the judge's table, and their weights in L2 `(n,)`."""

    wi: np.ndarray
    wo: np.ndarray
    weight: np.ndarray


def positive(brdf: Callable) -> Callable:
    """max(ρ, 0): measured values and networks may lie below."""
    return lambda wi, wo: jnp.maximum(brdf(wi, wo), 0)


def table(brdf: Callable) -> np.ndarray:
    """What a material is in the cells, reciprocal and bilateral, `(n, channels)`."""
    return np.asarray(half_vector_samples(positive(brdf), shape=SHAPE, largest=LARGEST).value)


def cells() -> Cells:
    """The cells of every table."""
    samples = half_vector_samples(lambda wi, wo: wi[:, 2], shape=SHAPE, largest=LARGEST)
    wi, wo = np.asarray(samples.wi), np.asarray(samples.wo)
    theta_h = np.asarray(angles(half_vector(samples.wi, samples.wo))[0])
    cos_d = np.linalg.norm(wi + wo, axis=1) / 2
    # dω_i dω_o = 4 cos θ_d dω_h dω_d, on cells of equal width in sqrt(θ_h).
    measure = np.sin(theta_h) * np.sqrt(theta_h) * np.sqrt(1 - np.minimum(cos_d, 1) ** 2) * cos_d
    return Cells(wi, wo, measure * (wi[:, 2] * wo[:, 2]) ** 2)


def log_error(value: np.ndarray, fitted: np.ndarray, wi: np.ndarray, wo: np.ndarray) -> float:
    """1000 x mean |Δ ln(1 + ρ z)| over pairs, channels and both cosines z."""
    errors = [np.mean(np.abs(np.log1p(value * w[:, 2:]) - np.log1p(fitted * w[:, 2:]))) for w in (wi, wo)]
    return 1e3 * float(np.mean(errors))


def l2_error(value: np.ndarray, fitted: np.ndarray, weight: np.ndarray) -> float:
    """Relative, of ρ cos cos, all channels together."""
    return float(np.sqrt(np.sum(weight[:, None] * (fitted - value) ** 2) / np.sum(weight[:, None] * value**2)))


class Picture(NamedTuple):
    """Normals `(pixels, 3)` that are seen from +z under up to 80 degrees, and a light."""

    normals: np.ndarray
    light: Any


def pictures(environments: Sequence[Path], size: int = 128) -> list[Picture]:
    """Three lamps on `size` pixels, and each environment, averaged over boxes to 64 x 32 pixels, on half as many."""
    lamps = [DirectionalLight(jnp.asarray(towards), jnp.asarray(power)) for towards, power in LAMPS]
    found = [Picture(_ball(size), lamps[0] + lamps[1] + lamps[2])]
    for path in environments:
        boxes = square_blocks(np.asarray(read_exr(path), float), 32).mean((1, 3))
        found.append(Picture(_ball(size // 2), EnvironmentMap(jnp.asarray(boxes), up="y")))
    return found


def _ball(size: int) -> np.ndarray:
    camera = OrthographicCamera(jnp.asarray([0.0, 0, 1]), jnp.asarray([0.0, 1, 0]), resolution=(size, size))
    normals = np.asarray(sphere(camera).normal).reshape(-1, 3)
    return normals[normals[:, 2] >= np.cos(LARGEST)]


def images(brdf: Callable, pictures: list[Picture]) -> list[np.ndarray]:
    """Radiance `(pixels, channels)` of each picture; of several materials together, each is lit in its own channels."""
    eye = jnp.asarray([0.0, 0, 1])
    channels = brdf(eye, eye).shape[-1]
    found = []
    for one in pictures:
        light = one.light
        if isinstance(light, EnvironmentMap):
            light = EnvironmentMap(jnp.tile(light.radiance, channels // light.radiance.shape[-1]), up=light.up)
        found.append(np.asarray(reflect(brdf, light, jnp.asarray(one.normals), eye)))
    return found


def psnr(truth: list[np.ndarray], fitted: list[np.ndarray]) -> float:
    """Mean over pictures [dB], each exposed as its truth and shown in sRGB."""
    found = []
    for a, b in zip(truth, fitted, strict=True):
        factor = plotting.exposure(a[None])
        found.append(min(CEILING, plotting.psnr(b[None], a[None], factor)))
    return float(np.mean(found))


def largest_albedo(brdf: Callable, polar: Sequence[float] = tuple(np.radians([0, 20, 40, 60, 70, 80]))) -> np.ndarray:
    """Of each channel, over these angles of the eye: integrals over half vectors, on nodes that follow highlights."""
    t, weight = np.polynomial.legendre.leggauss(240)
    t, weight = (t + 1) / 2, weight / 2
    phi = 2 * np.pi * (np.arange(64) + 0.5) / 64
    theta = t**3 * np.pi / 2
    h = np.asarray(direction(jnp.asarray(theta)[:, None], jnp.asarray(phi)[None]))
    measure = (weight * 3 * t**2 * np.pi / 2 * np.sin(theta))[:, None] * np.full(64, 2 * np.pi / 64)
    largest = []
    for angle in polar:
        wo = np.array([np.sin(angle), 0, np.cos(angle)])
        facing = h @ wo
        wi = 2 * facing[..., None] * h - wo
        seen = (facing > 0) & (wi[..., 2] > 0)
        value = np.asarray(brdf(jnp.asarray(wi[seen]), jnp.broadcast_to(jnp.asarray(wo), wi[seen].shape)))
        largest.append((measure * 4 * facing * wi[..., 2])[seen] @ value)
    return np.max(largest, axis=0)


def together(models: Sequence[LogLinearBRDF]) -> LogLinearBRDF:
    """Models over one basis as one of all their channels: functions are evaluated once."""
    first = models[0]
    return LogLinearBRDF(
        first.basis,
        [part for model in models for part in model.coefficients],
        jnp.asarray(block_diag(*(np.asarray(model.mixing) for model in models))),
        jnp.concatenate([model.low for model in models]),
        jnp.concatenate([model.high for model in models]),
    )
