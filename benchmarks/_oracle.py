"""Basis functions by scipy, in float64: what the results of a benchmark are held against."""

import numpy as np
import scipy.special


def rows(basis: str, order: int, w: np.ndarray) -> np.ndarray:
    """`HSH` or `Zernike` at unit directions `(points, 3)`, `(points, modes)`."""
    w = np.asarray(w, np.float64)
    z, phi = w[:, 2], np.arctan2(w[:, 1], w[:, 0])
    if basis == "HSH":
        return _hsh(order, z, phi)
    if basis == "Zernike":
        return _zernike(order, z, phi)
    raise ValueError(f"scipy stands in for HSH and Zernike, got {basis!r}")


def _hsh(order: int, z: np.ndarray, phi: np.ndarray) -> np.ndarray:
    harmonics = scipy.special.sph_harm_y_all(order, order, np.arccos(np.clip(2 * z - 1, -1, 1)), phi)
    columns = []
    for n in range(order + 1):
        for m in range(-n, n + 1):
            value = (-1) ** m * harmonics[n, abs(m)]  # without the sign of Condon and Shortley
            columns.append(np.sqrt(2) * value.real if m == 0 else 2 * (value.imag if m < 0 else value.real))
    return np.stack(columns, -1)


def _zernike(order: int, z: np.ndarray, phi: np.ndarray) -> np.ndarray:
    rho, columns = np.sqrt(1 - z), []
    for n in range(order + 1):
        for m in range(-n, n + 1, 2):
            k = (n - abs(m)) // 2
            radial = (-1) ** k * rho ** abs(m) * scipy.special.eval_jacobi(k, abs(m), 0, 2 * z - 1)
            turn = np.sqrt(0.5) if m == 0 else np.cos(m * phi) if m > 0 else np.sin(-m * phi)
            columns.append(np.sqrt((n + 1) / np.pi) * radial * turn)
    return np.stack(columns, -1)
