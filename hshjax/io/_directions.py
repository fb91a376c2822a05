"""Directions on the host, in float64 whatever jax's configuration: what readers of angles share.

A reader makes unit vectors `(n, 3)` in the local frame (normal +z) that point away from the surface. Angles in radians.
"""

import numpy as np

from hshjax.geometry import tilted


def polar(theta: np.ndarray, phi: np.ndarray | float) -> np.ndarray:
    """Unit vectors at θ from the normal and φ from +x towards +y; θ < 0 is |θ| at φ + π."""
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def mirrored(w: np.ndarray) -> np.ndarray:
    """The mirror direction of w at a surface: half a turn about the normal."""
    return w * (-1.0, -1.0, 1.0)


def from_half_and_difference(theta_h: np.ndarray, phi_h: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """wi, wo from the half vector's angles and the difference vector d `(n, 3)`, which belongs to wo.

    d is wo in the frame of the half vector, wo = R_z(φ_h) R_y(θ_h) d, and wi = 2 (h·wo) h - wo. (Rusinkiewicz 1998 has
    d for wi; of a reciprocal material φ_d and φ_d + π are the same.)
    """
    sin_h, cos_h, sin_p, cos_p = np.sin(theta_h), np.cos(theta_h), np.sin(phi_h), np.cos(phi_h)
    x, y, z = tilted(cos_h, sin_h, *d.T)
    wo = np.stack([cos_p * x - sin_p * y, sin_p * x + cos_p * y, z], axis=-1)
    return 2 * d[:, 2:] * polar(theta_h, phi_h) - wo, wo


def one_azimuth(wi: np.ndarray) -> bool:
    """Whether all directions that are not along the normal have one azimuth, to 1e-6 rad."""
    rim = np.hypot(wi[:, 0], wi[:, 1])
    tilted = rim > 1e-6
    if not tilted.any():
        return True
    flat = wi[tilted, :2] / rim[tilted, None]
    return bool(np.all(np.hypot(*(flat - flat[0]).T) <= 1e-6))
