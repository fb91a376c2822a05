"""Measured values whose noise has two parts, one in proportion to the value and one that is there in the dark, too."""

import numpy as np


def generalised_log(value: np.ndarray, dark: float) -> np.ndarray:
    """ln((ρ + sqrt(ρ² + dark²)) / 2): ln ρ of bright values, linear about 0, finite for negative ones. Host array.

    Noise of standard deviation σ sqrt(ρ² + dark²) becomes one of σ, whatever ρ.

    Source: Durbin, Hardin, Hawkins and Rocke, A variance-stabilizing transformation for gene-expression microarray
    data, Bioinformatics 18, 2002.
    """
    # ρ + root cancels where ρ < 0; (root + ρ)(root - ρ) = dark².
    size = np.log(np.hypot(value, dark) + np.abs(value))
    return np.where(value < 0, 2 * np.log(dark) - size, size) - np.log(2)


def log_density(value: np.ndarray, dark: float) -> float:
    """Σ ln of the derivative of `generalised_log`: densities of values with another `dark` become comparable."""
    return -float(np.sum(np.log(np.hypot(value, dark))))


def linearised(value: np.ndarray, logarithm: np.ndarray, dark: float) -> tuple[np.ndarray, np.ndarray]:
    """What ln ρ was seen to be, and the weight of that, for values about exp(`logarithm`); all of one shape.

    One step of Gauss and Newton: the generalised logarithm is linear in ln ρ about `logarithm`, with the slope
    1 / sqrt(1 + dark²/ρ²). The noise of what is returned has the variance σ² / weight.
    """
    slope = 1 / np.hypot(1, dark * np.exp(-logarithm))
    here = generalised_log(np.exp(logarithm), dark)
    return logarithm + (generalised_log(value, dark) - here) / slope, slope**2
