"""Single photographs, and what their surfaces are made of, for shape from shading."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from hshjax import DirectionalLight, Lambert, reflect
from hshjax._typing import Array, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.brdfs._base import in_dtype
from hshjax.photographs import Photographs
from hshjax.stereo import solve_calibrated
from hshjax.stereo._columns import column_brdfs, combined, default_columns, positive_columns

VIEW = (0.0, 0.0, 1.0)

PIXELS, DARK = 400, 0.2
"""How many pixels a BRDF is fitted to, and of the mean of a photograph, below which errors count as they are."""


class Mixture(AbstractBRDF):
    """One material of many colours: channels of `brdf` mixed by `weights` `(materials, channels)`."""

    brdf: AbstractBRDF
    weights: Float[Array, "materials channels"]

    def formula(self, wi, wo):
        return self.brdf.formula(wi, wo) @ in_dtype(self, wi.dtype).weights


def towards(angle: float, azimuth: float) -> np.ndarray:
    """The direction at angles [degrees] from the view, and about it."""
    theta, phi = np.radians([angle, azimuth])
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def lights_at(angles: tuple[float, ...], azimuth: float) -> DirectionalLight:
    """Lights of irradiance π."""
    directions = np.stack([towards(angle, azimuth) for angle in angles])
    return jax.vmap(DirectionalLight)(jnp.asarray(directions), jnp.full(len(angles), np.pi))


def angles_of(photographs: Photographs) -> np.ndarray:
    """Between lights and view [degrees]."""
    direction = np.asarray(photographs.lights.direction)
    return np.degrees(np.arccos(direction[:, 2] / np.linalg.norm(direction, axis=1)))


def only(photographs: Photographs, chosen: list[int]) -> Photographs:
    """Some of the photographs."""
    lights = jax.tree.map(lambda leaf: leaf[np.asarray(chosen)], photographs.lights)
    return dataclasses.replace(photographs, values=photographs.values[:, chosen], lights=lights)


def thinned(photographs: Photographs, every: int) -> Photographs:
    """Every so many pixels of a row and of a column."""
    chosen = np.zeros_like(photographs.mask)
    chosen[every // 2 :: every, every // 2 :: every] = True
    kept = chosen[photographs.mask]
    mask = photographs.mask[every // 2 :: every, every // 2 :: every]
    truth = None if photographs.truth is None else photographs.truth[kept]
    return dataclasses.replace(photographs, values=photographs.values[kept], mask=mask, truth=truth)


def as_sphere(photographs: Photographs) -> Photographs:
    """With the normals of the sphere whose outline the mask is."""
    row, column = np.nonzero(photographs.mask)
    radius = np.sqrt(photographs.pixels / np.pi)
    x = (column - (column.min() + column.max()) / 2) / radius
    y = ((row.min() + row.max()) / 2 - row) / radius
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return dataclasses.replace(photographs, truth=normal)


def with_fitted_lights(photographs: Photographs) -> Photographs:
    """Directions by which values that are neither dark nor brightest are linear in the true normals; in grey."""
    values, found = np.nanmean(photographs.values, axis=2), []
    for column in values.T:
        known = np.isfinite(column)
        low, high = np.quantile(column[known], [0.3, 0.95])
        used = known & (column > low) & (column < high)
        found.append(np.linalg.lstsq(photographs.truth[used], column[used], rcond=None)[0])
    directions = np.stack(found)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lights = jax.vmap(DirectionalLight)(jnp.asarray(directions), photographs.lights.irradiance)
    return dataclasses.replace(photographs, lights=lights)


def learned(photographs: Photographs, number: int) -> tuple[AbstractBRDF, np.ndarray]:
    """The BRDF of an object of one material, from all photographs but one and without its true normals; and the light
    that strays on that one `(channels,)`."""
    others = [k for k in range(photographs.count) if k != number]
    solved = solve_calibrated(only(photographs, others))
    weights = np.median(solved.weights, axis=0)
    stray = solved.stray * np.nanmean(photographs.values[:, number], axis=0)
    return Mixture(solved.brdf, jnp.asarray(weights, float)), stray


def fitted_to_normals(photographs: Photographs, number: int) -> tuple[AbstractBRDF, np.ndarray]:
    """As `learned`, but by least squares of relative values for the true normals: the material as it would be known
    from a sample of known shape. In the columns that photometric stereo has, highlights at least 0, and stray light."""
    from scipy.optimize import lsq_linear

    columns = default_columns()
    low = np.concatenate([np.where(positive_columns(columns), 0, -np.inf), [0]])
    others = only(photographs, [k for k in range(photographs.count) if k != number])
    irradiance = np.asarray(others.lights.irradiance, float).reshape(others.count, -1)
    truth, view, step = jnp.asarray(photographs.truth, float), jnp.asarray(VIEW), max(1, photographs.pixels // PIXELS)
    rows = []
    for direction in np.asarray(others.lights.direction, float):
        light = DirectionalLight(jnp.asarray(direction), 1.0)
        parts = [np.asarray(reflect(brdf, light, truth[::step], view)) for brdf in column_brdfs(columns)]
        rows.append(np.concatenate(parts, axis=1))
    shading, found = np.stack(rows, axis=1), []
    for channel in range(photographs.channels):
        values = others.values[::step, :, channel] / irradiance[:, channel % irradiance.shape[1]]
        mean = np.nanmean(values, axis=0)
        design = np.concatenate([shading, np.broadcast_to(mean[:, None], (*values.shape, 1))], axis=2)
        known = np.isfinite(values) & np.isfinite(photographs.truth[::step]).all(axis=1)[:, None]
        weight = 1 / (np.where(known, values, 0) + DARK * mean)[known]
        found.append(lsq_linear(design[known] * weight[:, None], values[known] * weight, (low, np.inf)).x)
    coefficients = np.stack(found)
    stray = coefficients[:, -1] * np.nanmean(photographs.values[:, number], axis=0)
    return combined(columns, jnp.asarray(coefficients[:, :-1])), stray


def best_lambert(photographs: Photographs) -> Lambert:
    """Lambert's law with the albedo that suits one photograph best, in each channel, given the true normals."""
    light = jax.tree.map(lambda leaf: leaf[0], photographs.lights)
    white = np.asarray(reflect(Lambert(1.0), light, jnp.asarray(photographs.truth), jnp.asarray(VIEW)))
    values = photographs.values[:, 0]
    known = np.isfinite(values) & (white > 0) & np.isfinite(photographs.truth).all(axis=1, keepdims=True)
    white = np.where(known, white, 0)
    albedo = np.sum(white * np.where(known, values, 0), axis=0) / np.sum(white * white, axis=0)
    return Lambert(albedo)
