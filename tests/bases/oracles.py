"""The bases once more, from other sources: scipy's special functions, and mpmath where scipy has nothing.

Host arrays, float64. `cartesian` is the formula in (x, y, z), on and off the unit sphere; `angular` the one in angles.
"""

import math
from fractions import Fraction
from functools import lru_cache

import mpmath
import numpy as np
import scipy.special

DIGITS = 80
"""The moment matrix of order 32 is a Hilbert matrix of 33 rows, condition near 1e50: thirty digits are left."""


def cartesian(name: str, order: int, w: np.ndarray) -> np.ndarray:
    """Every function of the basis at w `(*batch, 3)`, z >= 0, in the order of `modes`."""
    x, y, z = np.moveaxis(np.asarray(w, np.float64), -1, 0)
    radial, power = {"hsh": _hsh, "zernike": _zernike, "shr": _shr}[name](order, x, y, z)
    return np.stack([radial[n, abs(m)] * _part(power ** abs(m), m) for n, m in _modes(name, order)], -1)


def angular(name: str, order: int, theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """`hsh` and `spherical` by scipy's associated Legendre functions, `zernike` by Jacobi polynomials in ρ."""
    functions = []
    for n, m in _modes(name, order):
        k = abs(m)
        if name == "zernike":
            rho = np.sqrt(2) * np.sin(theta / 2)
            jacobi = (-1) ** ((n - k) // 2) * scipy.special.eval_jacobi((n - k) // 2, k, 0, 1 - 2 * rho**2)
            value = math.sqrt((n + 1) / math.pi) * rho**k * jacobi
        else:
            x = 2 * np.cos(theta) - 1 if name == "hsh" else np.cos(theta)
            # The hemisphere's measure is half of the sphere's; scipy's functions carry the Condon-Shortley sign.
            area = 2 * math.pi if name == "hsh" else 4 * math.pi
            norm = math.sqrt(Fraction(2 * (2 * n + 1) * math.factorial(n - k), math.factorial(n + k)) / Fraction(area))
            value = norm * (-1) ** k * scipy.special.lpmv(k, n, x)
        azimuth = np.sqrt(0.5) if m == 0 else np.cos(m * phi) if m > 0 else np.sin(k * phi)
        functions.append(value * azimuth)
    return np.stack(functions, -1)


def circle_polynomial(n: int, m: int, rho: np.ndarray) -> np.ndarray:
    """Zernike's R_n^m(ρ) by the sum over factorials; for low orders (all digits are lost near n = 40)."""
    f = math.factorial
    terms = range((n - m) // 2 + 1)
    return sum(
        (-1) ** s * f(n - s) / (f(s) * f((n + m) // 2 - s) * f((n - m) // 2 - s)) * rho ** (n - 2 * s) for s in terms
    )


def _modes(name, order):
    return [(n, m) for n in range(order + 1) for m in range(-n, n + 1, 2 if name == "zernike" else 1)]


def _part(power, m):
    return power.imag if m < 0 else power.real * (np.sqrt(0.5) if m == 0 else 1)


def _hsh(order, x, y, z):
    """d^m P_l / dt^m = (l + m)! / (l! 2^m) P_{l-m}^{(m,m)}(t): a Jacobi polynomial, without a singular factor."""

    def norm(n, m):
        f = math.factorial
        return math.sqrt(Fraction((2 * n + 1) * f(n - m) * f(n + m), f(n) ** 2 * 4**m)) / math.sqrt(math.pi)

    modes = [(n, m) for n in range(order + 1) for m in range(n + 1)]
    radial = {(n, m): norm(n, m) * scipy.special.eval_jacobi(n - m, m, m, 2 * z - 1) for n, m in modes}
    return radial, 2 * np.sqrt(z / (1 + z)) * (x + 1j * y)


def _zernike(order, x, y, z):
    radial = {}
    for n in range(order + 1):
        for m in range(n % 2, n + 1, 2):
            k = (n - m) // 2
            radial[n, m] = math.sqrt((n + 1) / math.pi) * (-1) ** k * scipy.special.eval_jacobi(k, m, 0, 2 * z - 1)
    return radial, (x + 1j * y) / np.sqrt(1 + z)


def _shr(order, x, y, z):
    """Powers of z orthonormalised against (1 - z²)^m: the restricted harmonics of one m, by rising degree."""
    radial = {}
    with mpmath.workdps(DIGITS):
        exact = np.vectorize(mpmath.mpf, otypes=[object])(z)
        for m in range(order + 1):
            factor, solved = _moment_factor(order - m, m), []
            for j in range(order - m + 1):  # forward substitution: factor @ p = (1, z, z², ...)
                rest = exact**j - sum((factor[j, k] * p for k, p in enumerate(solved)), start=0 * exact)
                solved.append(rest / factor[j, j])
                radial[m + j, m] = np.asarray(solved[j], np.float64)
    return radial, x + 1j * y


@lru_cache
def _moment_factor(degree: int, m: int):
    """Cholesky factor of the matrix of π ∫_0^1 (1 - z²)^m z^j z^k dz, j, k <= degree."""
    with mpmath.workdps(DIGITS):
        moments = [mpmath.pi * mpmath.beta(mpmath.mpf(k + 1) / 2, m + 1) / 2 for k in range(2 * degree + 1)]
        size = range(degree + 1)
        return mpmath.cholesky(mpmath.matrix([[moments[j + k] for k in size] for j in size]))
