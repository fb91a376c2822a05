"""Which angles a measurement has: beyond them a fit extrapolates."""

from dataclasses import dataclass

import numpy as np

from hshjax.samples import Samples

STEP = 0.01
"""Incidences less than about that apart are one [degrees]: files round angles."""

POLE = 1e-4
"""Sine of an angle of incidence or view below which azimuths mean nothing."""


@dataclass(frozen=True)
class Coverage:
    """Angles of samples that count, in degrees.

    - `theta_i`, `theta_o`: smallest and largest angle to the normal.
    - `incidences`: number of distinct directions wi; angles θ_i alone where the samples are isotropic.
    - `azimuths`: smallest and largest |φ_o - φ_i|, folded to [0, 180]; None where all samples lie at the normal.
    - `azimuth_span`: the shortest arc that holds every φ_o - φ_i, up to 360 less the widest gap; None likewise.
    """

    theta_i: tuple[float, float]
    theta_o: tuple[float, float]
    incidences: int
    azimuths: tuple[float, float] | None
    azimuth_span: float | None


def coverage(samples: Samples) -> Coverage:
    """The angles of the samples whose weight is above 0.

    **Raises:** ValueError where there is none.
    """
    used = np.asarray(samples.weight) > 0
    if not used.any():
        raise ValueError(f"none of the {samples.size} samples has a weight above 0")
    wi, wo = (np.asarray(w)[used].astype(np.float64) for w in (samples.wi, samples.wo))
    rim_i, rim_o = (np.hypot(w[:, 0], w[:, 1]) for w in (wi, wo))
    theta_i, theta_o = (np.degrees(np.arctan2(rim, w[:, 2])) for rim, w in ((rim_i, wi), (rim_o, wo)))
    turned = (rim_i > POLE) & (rim_o > POLE)
    between = np.arctan2(wo[:, 1], wo[:, 0]) - np.arctan2(wi[:, 1], wi[:, 0])
    between = np.degrees(between[turned]) % 360
    azimuths = span = None
    if between.size:
        folded = np.minimum(between, 360 - between)
        azimuths = (float(folded.min()), float(folded.max()))
        rising = np.sort(between)
        span = float(360 - np.diff(rising, append=rising[0] + 360).max())
    incidence = np.round(theta_i / STEP)
    if not samples.isotropic:
        azimuth = np.where(rim_i > POLE, np.degrees(np.arctan2(wi[:, 1], wi[:, 0])) % 360, 0)
        incidence = incidence + 1e6 * (np.round(azimuth / STEP) % round(360 / STEP))
    return Coverage(
        (float(theta_i.min()), float(theta_i.max())),
        (float(theta_o.min()), float(theta_o.max())),
        int(np.unique(incidence).size),
        azimuths,
        span,
    )
