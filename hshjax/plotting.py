"""Pictures of BRDFs, for reports and for looking at a fit. Needs matplotlib (the extra `experiments`).

Nothing here opens a window or writes a file: functions draw on axes that they are given, or return an image.
"""

import itertools
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from hshjax import surface
from hshjax._typing import PairFunction
from hshjax.camera import OrthographicCamera
from hshjax.geometry import direction
from hshjax.lighting import DirectionalLight
from hshjax.reflectance import reflect

# Okabe and Ito's colours, told apart with every kind of colour vision.
COLOURS = ("#009E73", "#D55E00", "#0072B2", "#CC79A7", "#E69F00", "#56B4E9")


def incident_plane(
    axes: Any, brdfs: Mapping[str, PairFunction], theta_i: float, *, channel: int = 0, max_theta: float = np.radians(80)
) -> None:
    """Polar plot of ρ [sr^-1] over θ_o in the plane of incidence, incidence at `theta_i` [radians] on the left.

    - `axes`: polar matplotlib axes. - `brdfs`: label -> BRDF; the first is drawn solid and sets the scale: a fit that
      shoots up must not flatten everything else. - `channel`: which channel.
    - `max_theta`: largest |θ_o| that is drawn; nearer to grazing, BRDFs grow without bound and tables are extrapolated.

    Negative values, which a polar plot cannot show, are drawn as 0; the legend says how deep they go.
    """
    from matplotlib.ticker import MaxNLocator

    theta = np.linspace(-max_theta, max_theta, 641)
    wi = direction(jnp.asarray(theta_i), jnp.asarray(np.pi))
    wo = direction(jnp.asarray(theta), jnp.zeros(theta.size))
    values = {label: np.asarray(brdf(wi, wo))[:, channel] for label, brdf in brdfs.items()}
    top = 1.15 * next(iter(values.values())).max()
    axes.plot([-theta_i, -theta_i], [0, top], color="#E69F00", lw=1.6, ls="--", label="incidence")
    for colour, (label, value) in zip(itertools.cycle(COLOURS), values.items(), strict=False):
        if value.min() < 0:
            label = f"{label} (min {value.min():.2g})"
        style = {"lw": 2.2, "ls": "-"} if colour == COLOURS[0] else {"lw": 1.4, "ls": "--"}
        axes.plot(theta, np.maximum(value, 0), label=label, color=colour, **style)
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_thetalim(-np.pi / 2, np.pi / 2)
    axes.set_rlim(0, top)
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10], prune="both"))
    axes.tick_params(labelsize=8)


def sphere(brdf: PairFunction, light: tuple[float, float, float] = (-0.5, 0.5, 0.7), *, size: int = 192) -> np.ndarray:
    """Radiance image `(size, size, channels)` of a unit sphere under a directional light of irradiance 1 [W m^-2].

    Orthographic, seen along -z with x to the right and y up; `light` points from the sphere to the light, of any
    length. Pixels off the sphere are NaN. Linear values: see `display`.
    """
    camera = OrthographicCamera((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), resolution=(size, size))
    seen = surface.sphere(camera)
    radiance = reflect(brdf, DirectionalLight(light, jnp.ones(())), seen.normal, camera)
    return np.where(seen.mask[..., None], np.asarray(radiance, float), np.nan)


def exposure(radiance: np.ndarray, quantile: float = 0.95) -> float:
    """The factor that brings this quantile (over pixels, of the largest channel) to 0.9; NaN pixels do not count."""
    seen = ~np.isnan(radiance).any(axis=-1)
    level = float(np.quantile(radiance[seen].max(axis=-1), quantile))
    if not level > 0:
        raise ValueError(f"an image needs positive values to be exposed, its {quantile:.0%} quantile is {level}")
    return 0.9 / level


def display(radiance: np.ndarray, factor: float, background: float = 1.0) -> np.ndarray:
    """Display values in [0, 1], `(height, width, 3)`: exposed, clipped, sRGB curve (IEC 61966-2-1).

    One channel is shown as grey; NaN pixels get the `background`.
    """
    if radiance.shape[-1] not in (1, 3):
        raise ValueError(f"an image to display needs 1 or 3 channels, got {radiance.shape[-1]}")
    linear = np.clip(np.broadcast_to(radiance, (*radiance.shape[:-1], 3)) * factor, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)
    return np.where(np.isnan(linear), background, encoded)


def psnr(radiance: np.ndarray, reference: np.ndarray, factor: float) -> float:
    """Peak signal-to-noise ratio [dB] of what `display` shows of the two, over the pixels that are not NaN."""
    seen = ~np.isnan(reference).any(axis=-1)
    error = float(np.mean((display(radiance, factor) - display(reference, factor))[seen] ** 2))
    return float("inf") if error == 0 else -10 * float(np.log10(error))
