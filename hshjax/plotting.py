"""Pictures of BRDFs, for reports and for looking at a fit. Axes need matplotlib (the extra `experiments`).

Nothing here opens a window: functions draw on axes that they are given, or return an image for `write_picture`.
"""

import itertools
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from hshjax import surface
from hshjax._typing import PairFunction
from hshjax.brdfs._known import known
from hshjax.camera import OrthographicCamera
from hshjax.geometry import direction, from_half_difference
from hshjax.io import write_exr
from hshjax.io._images import write_png
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


def slice_image(brdf: PairFunction, *, size: int = 180, phi_d: float = np.pi / 2, root: bool = False) -> np.ndarray:
    """ρ [sr^-1] over half and difference angle, `(size, size, channels)`: θ_h to the right, θ_d upwards, to 90 degrees.

    The highlight is the left edge, grazing reflection (Fresnel) the top, the bottom reflects back to the light, what
    lies between is diffuse. Values are at the centres of pixels, of an isotropic BRDF or at φ_h = 0; pairs
    below the horizon, of which there are none at φ_d = π/2, are NaN, and so are those that a table has not measured.
    Linear values: see `display`.

    - `phi_d`: azimuth of the difference vector [radians]. - `root`: the right edge is 90 degrees still, but sqrt(θ_h)
      grows evenly, which widens highlights.

    Source: Burley, Physically-Based Shading at Disney, SIGGRAPH course 2012, section 3 (the image slice).
    """
    place = (np.arange(size) + 0.5) / size
    theta_h, theta_d = np.meshgrid((place**2 if root else place) * np.pi / 2, place[::-1] * np.pi / 2)
    wi, wo = from_half_difference(jnp.asarray(theta_h), jnp.asarray(theta_d), jnp.asarray(phi_d))
    above = np.asarray((wi[..., 2] > 0) & (wo[..., 2] > 0))
    there = above & np.asarray(known(brdf, wi.reshape(-1, 3), wo.reshape(-1, 3))).reshape(above.shape)
    return np.where(there[..., None], np.asarray(brdf(wi, wo), float), np.nan)


def lobe_image(brdf: PairFunction, wi: Any, *, size: int = 256) -> np.ndarray:
    """ρ [sr^-1] over the hemisphere of wo under light from `wi` `(3,)`, of any length: `(size, size, channels)`.

    The radiance per irradiance that an eye at wo sees. Seen from above on the equal-area disk, (x, y) = wo / sqrt(1 +
    z), x to the right and y up: the normal in the middle, the horizon its rim, every pixel 8 / size² sr. Pixels off the
    disk are NaN. Linear values: see `display`.

    **Raises:** ValueError for light from below the horizon.
    """
    light = np.asarray(wi, float)
    if light.shape != (3,) or not light[2] > 0:
        raise ValueError(f"wi must be a direction (3,) above the horizon, got {wi}")
    step = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(step, -step)
    square = x * x + y * y
    inside = square < 1
    rim = np.sqrt(2 - np.where(inside, square, 0))
    wo = np.where(inside[..., None], np.stack([rim * x, rim * y, 1 - square], -1), (0.0, 0.0, 1.0))
    values = np.asarray(brdf(jnp.asarray(light / np.linalg.norm(light)), jnp.asarray(wo)), float)
    return np.where(inside[..., None], values, np.nan)


def write_picture(
    path: str | PathLike, radiance: np.ndarray, *, factor: float | None = None, suffix: str | None = None
) -> None:
    """Write an image `(height, width, channels)` as its suffix says; as `suffix` does, if there is one.

    `.exr`: the values themselves, times the `factor` if there is one, in float; NaN pixels are 0 under an alpha channel
    A, which is 1 elsewhere and present if there are such pixels. Channels are Y, or R, G, B, or else C0, C1, ...
    `.png`: what `display` shows at the factor (default: `exposure`), 8 bits; it needs the extra `photographs`.

    **Raises:** ValueError for another suffix, and as `display`, `exposure` and `hshjax.io.write_exr`.
    """
    suffix = Path(path).suffix.lower() if suffix is None else suffix
    if suffix == ".png":
        shown = display(radiance, exposure(radiance) if factor is None else factor)
        write_png(path, np.rint(255 * shown).astype(np.uint8))
        return
    if suffix != ".exr":
        raise ValueError(f"a picture is written as .exr or .png, got {Path(path).name!r}")
    count = radiance.shape[-1]
    names = {1: ("Y",), 3: ("R", "G", "B")}.get(count, tuple(f"C{k}" for k in range(count)))
    hidden = np.isnan(radiance).any(axis=-1, keepdims=True)
    values = np.where(hidden, 0, radiance) * (1.0 if factor is None else factor)
    if hidden.any():
        values, names = np.concatenate([values, np.where(hidden, 0.0, 1.0)], axis=-1), (*names, "A")
    write_exr(path, values, names)


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
