"""What goes wrong with photographs: noise, saturation, wrong brightness, ruined images, single wrong values.

Every function returns new `Photographs` whose `notes` say what was done; `level(photographs)` is the unit of radiance.
Values that are NaN stay NaN. All chance comes from `seed`.
"""

from dataclasses import replace
from typing import Literal

import numpy as np

from hshjax.photographs import Photographs


def level(photographs: Photographs) -> float:
    """The 99 % quantile of what is known of the radiance: about white, whatever highlights do."""
    return float(np.nanquantile(photographs.values, 0.99))


def noisy(photographs: Photographs, *, read: float = 0.002, photons: float = 10_000.0, seed: int = 0) -> Photographs:
    """Noise of the dark and of counting, normal: of variance (`read` level)² + value level / `photons`.

    `photons`: how many count as one level. Radiance may become negative, as differences from a dark image do.
    """
    if read < 0 or photons <= 0:
        raise ValueError(f"read must be >= 0 and photons > 0, got {read} and {photons}")
    unit, values = level(photographs), photographs.values
    deviation = np.sqrt((read * unit) ** 2 + np.maximum(values, 0) * unit / photons)
    noise = deviation * np.random.default_rng([seed, 11]).normal(size=values.shape)
    return _changed(photographs, values + noise, f"noise: {read:g} of the level, {photons:g} photons a level, {seed=}")


def saturated(photographs: Photographs, share: float = 0.01, kind: Literal["nan", "clipped"] = "nan") -> Photographs:
    """The brightest `share` of values reaches the ceiling of the sensor: they become NaN, or the ceiling itself."""
    if not 0 < share < 1 or kind not in ("nan", "clipped"):
        raise ValueError(f"share must be in (0, 1) and kind nan or clipped, got {share} and {kind!r}")
    values = photographs.values
    ceiling = np.nanquantile(values, 1 - share)
    values = np.where(values > ceiling, np.nan if kind == "nan" else ceiling, values)
    return _changed(photographs, values, f"saturation: values above {ceiling:.6g} are {kind}")


def misjudged(
    photographs: Photographs, count: int, *, low: float = 0.15, high: float = 0.35, seed: int = 0
) -> Photographs:
    """`count` photographs are too bright by a factor of 1 + `low` to 1 + `high`, though their lights say nothing."""
    rng, chosen = _chosen(photographs, count, [seed, 12])
    factor = np.ones(photographs.count)
    factor[chosen] = 1 + rng.uniform(low, high, count)
    said = ", ".join(f"{k} by {factor[k]:.4f}" for k in chosen)
    return _changed(photographs, photographs.values * factor[:, None], f"too bright: {said}")


def ruined(
    photographs: Photographs, count: int, kind: Literal["black", "garbage"] = "garbage", *, seed: int = 0
) -> Photographs:
    """`count` photographs show nothing, or values from 0 to the level that have to do with nothing."""
    if kind not in ("black", "garbage"):
        raise ValueError(f"kind must be black or garbage, got {kind!r}")
    rng, chosen = _chosen(photographs, count, [seed, 13])
    values = photographs.values.copy()
    shape = values[:, chosen].shape
    values[:, chosen] = rng.uniform(0, level(photographs), shape) if kind == "garbage" else 0
    return _changed(photographs, values, f"{kind}: {', '.join(map(str, chosen))}")


def outliers(photographs: Photographs, share: float, *, seed: int = 0) -> Photographs:
    """That share of pixels, of every photograph others, has values from 0 to twice the level instead of their own."""
    if not 0 <= share <= 1:
        raise ValueError(f"share must be in [0, 1], got {share}")
    rng = np.random.default_rng([seed, 14])
    values = photographs.values.copy()
    pixels, lights, channels = values.shape
    hit = rng.permuted(np.broadcast_to(np.arange(pixels)[:, None], (pixels, lights)), axis=0)[: round(share * pixels)]
    values[hit, np.arange(lights)] = rng.uniform(0, 2 * level(photographs), (*hit.shape, channels))
    return _changed(photographs, values, f"outliers: {share:g} of the pixels of each photograph, {seed=}")


def _chosen(photographs: Photographs, count: int, seed: list[int]) -> tuple[np.random.Generator, np.ndarray]:
    """Numbers of `count` photographs, rising."""
    if not 0 <= count <= photographs.count:
        raise ValueError(f"count must be 0 to {photographs.count}, the number of photographs, got {count}")
    rng = np.random.default_rng(seed)
    return rng, np.sort(rng.choice(photographs.count, count, replace=False))


def _changed(photographs: Photographs, values: np.ndarray, note: str) -> Photographs:
    values = np.where(np.isnan(photographs.values), np.nan, values).astype(photographs.values.dtype)
    return replace(photographs, values=values, notes=(*photographs.notes, note))
