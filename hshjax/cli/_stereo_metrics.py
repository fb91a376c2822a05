"""How good a solution is: what the truth says where there is one, and what the photographs say themselves."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hshjax.lighting import DirectionalLight
from hshjax.photographs import Photographs
from hshjax.stereo import Stereo, angular_errors, predict

LIT = 0.1
"""Least n·l of the values that the prediction error looks at."""


class Solved(NamedTuple):
    """A solution, what it predicts, and figures.

    - `predicted` `(pixels, lights, channels)`: photographs from the model.
    - `error` `(pixels,)`: of normals [degrees], NaN where the truth is unknown; None without one.
    - `misfit` `(pixels,)`: RMS of what is not explained, relative to the pixel's RMS, over values that count; NaN where
      none do.
    - `metrics`: what metrics.json holds.
    """

    photographs: Photographs
    stereo: Stereo
    predicted: np.ndarray
    error: np.ndarray | None
    misfit: np.ndarray
    metrics: dict[str, Any]

    @classmethod
    def of(cls, photographs: Photographs, stereo: Stereo, lights: str, seconds: float) -> "Solved":
        """Everything, from photographs and result. `lights`: what was known of them."""
        predicted = predict(stereo)
        error = None if photographs.truth is None else angular_errors(stereo.normals, photographs.truth)
        misfit, explained = _explained(photographs, stereo, predicted)
        metrics = {
            "mean_angular_error_degrees": _of_known(np.mean, error),
            "median_angular_error_degrees": _of_known(np.median, error),
            "mean_light_direction_error_degrees": None,
            "mean_light_intensity_error": None,
            "seconds": round(seconds, 3),
            "lights_known": lights,
            "pixels": photographs.pixels,
            "photographs": photographs.count,
            "channels": photographs.channels,
            "materials": stereo.weights.shape[1],
            "stray": float(stereo.stray),
            **explained,
            "outlier_share": float(np.mean(stereo.outliers)),
            "shadow_share": float(np.mean(stereo.shadows)),
            "median_deviation_degrees": _finite(float(np.degrees(np.median(stereo.deviation)))),
            "stages": [{"name": name, "seconds": round(s, 3), **figures} for name, s, figures in stereo.history],
            "notes": list(photographs.notes),
        }
        return cls(photographs, stereo, predicted, error, misfit, metrics | light_errors(photographs, stereo, lights))

    def words(self) -> dict[str, str]:
        """The figures for people."""
        m = self.metrics
        found = {"pixels": f"{m['pixels']}", "photographs": f"{m['photographs']}, channels: {m['channels']}"}
        if m["mean_angular_error_degrees"] is not None:
            found["angular error of normals"] = (
                f"mean {m['mean_angular_error_degrees']:.2f}, median {m['median_angular_error_degrees']:.2f} degrees"
            )
        if m["mean_light_direction_error_degrees"] is not None:
            found["error of light directions"] = f"mean {m['mean_light_direction_error_degrees']:.2f} degrees"
        if m["mean_light_intensity_error"] is not None:
            found["error of light intensities"] = f"mean {m['mean_light_intensity_error']:.2%}"
        if any(stage.get("forced") for stage in m["stages"]):
            found["lights"] = "hardly determined: errors of 20 degrees are usual (docs/unknown_lights.md)"
        if m["prediction_error"] is not None:
            found["prediction error"] = (
                f"{m['prediction_error']:.2%} of the photographs' RMS, {m['masked_share']:.0%} of values masked"
            )
        if m["prediction_error_without_shadows"] is not None:
            found["the same without shadows"] = f"{m['prediction_error_without_shadows']:.2%}"
        found["stray light"] = f"{m['stray']:.2%} of the mean of a photograph"
        found["outliers"] = f"{m['outlier_share']:.1%} of all values, shadows: {m['shadow_share']:.1%}"
        found["time"] = f"{m['seconds']:.1f} s"
        found["decisions"] = "\n".join(m["notes"]) or "none"
        return found


def _explained(photographs: Photographs, stereo: Stereo, predicted: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
    """Misfit of pixels, and figures of the prediction; light by light, so that no second copy of the values is made."""
    names = {"prediction_error": np.zeros(3), "prediction_error_without_shadows": np.zeros(3)}
    own = np.zeros((2, photographs.pixels))
    for j in range(photographs.count):
        values = np.asarray(photographs.values[:, j], float)
        known = np.all(np.isfinite(values), axis=1)
        counts = known & (cosines(stereo, j) > LIT) & ~stereo.outliers[:, j]
        square = np.sum(np.where(known[:, None], values, 0) ** 2, axis=1)
        missed = np.sum(np.where(known[:, None], values - predicted[:, j], 0) ** 2, axis=1)
        lit = counts & ~stereo.shadows[:, j]
        for name, chosen in zip(names, (counts, lit), strict=True):
            names[name] += missed[chosen].sum(), square[chosen].sum(), chosen.sum()
        own += np.where(lit, (missed, square), 0)
    misfit = np.where(own[1] > 0, np.sqrt(own[0] / np.where(own[1] > 0, own[1], 1)), np.nan)
    ratios = {name: float(np.sqrt(a / b)) if b > 0 else None for name, (a, b, _) in names.items()}
    share = 1 - float(names["prediction_error"][2]) / (photographs.pixels * photographs.count)
    return misfit, {**ratios, "masked_share": share}


def light_errors(photographs: Photographs, stereo: Stereo, lights: str) -> dict[str, Any]:
    """Mean errors of what was searched for of the lights, where they are known otherwise: angles [degrees]; intensities
    relative, up to a factor that all share."""
    given = photographs.lights
    if lights == "known" or given is None or type(given) is not type(stereo.lights):
        return {}
    found = {}
    if lights == "unknown":  # of lights nearby nothing is found
        errors = angular_errors(directions(stereo.lights), directions(given))
        found["mean_light_direction_error_degrees"] = float(errors.mean())
    true, estimate = (intensities(kind) for kind in (given, stereo.lights))
    if not np.all(true == true[0]):  # a light file tells none, and all are 1
        ratio = estimate / true
        found["mean_light_intensity_error"] = float(np.mean(np.abs(ratio / np.median(ratio) - 1)))
    return found


def directions(lights: Any, positions: Any = None) -> np.ndarray:
    """Unit vectors towards lights, `(lights, 3)`; to `PointLight`s from the mean of positions `(pixels, 3)`."""
    if isinstance(lights, DirectionalLight):
        direction = np.asarray(lights.direction, float)
    else:
        direction = np.asarray(lights.position, float) - np.mean(positions, axis=0)
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def cosines(stereo: Stereo, j: int) -> np.ndarray:
    """n·l of every pixel with a light."""
    lights: Any = stereo.lights
    if isinstance(lights, DirectionalLight):
        return stereo.normals @ directions(lights)[j]
    towards = np.asarray(lights.position[j], float) - stereo.positions
    return np.sum(stereo.normals * towards, axis=1) / np.linalg.norm(towards, axis=1)


def strength(lights: Any) -> np.ndarray:
    """Irradiance of `DirectionalLight`s or intensity of `PointLight`s, `(lights, 1 or channels)`."""
    given = np.asarray(lights.irradiance if isinstance(lights, DirectionalLight) else lights.intensity, float)
    return given.reshape(len(given), -1)


def intensities(lights: Any) -> np.ndarray:
    """Means of channels of `strength`, `(lights,)`."""
    return strength(lights).mean(axis=1)


def _of_known(statistic: Callable, error: np.ndarray | None) -> float | None:
    """Of what is no NaN; None where there is nothing else."""
    known = np.zeros(0) if error is None else error[np.isfinite(error)]
    return float(statistic(known)) if known.size else None


def _finite(value: float) -> float | None:
    """JSON has no other numbers."""
    return value if math.isfinite(value) else None
