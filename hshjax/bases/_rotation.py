"""Rotations of series in real spherical harmonics."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hshjax._special import powers
from hshjax._typing import Array, Float
from hshjax.bases._base import AbstractBasis, matmul
from hshjax.bases._spherical import SphericalHarmonics
from hshjax.geometry import azimuth, dot, meridian_frame

EXACT = jax.lax.Precision.HIGHEST
"""Matrix products at full precision on every device."""

OBLIQUE = np.array([0.7, 1.1, 0.4])
"""A turn [radians, about this axis] that takes the poles to where nobody's directions lie.

The angles of a direction have no derivatives at the poles, and derivatives through them lose digits in proportion to
1 / distance nearby. What is computed has neither flaw, so that it may be computed in a world that is turned: who asks
for a derivative at the north pole, or along an axis, gets it exact, and only directions within some 1e-3 of this point
and its antipode get it to fewer digits.
"""


def turn_by(omega: np.ndarray) -> np.ndarray:
    """The matrix exp(ω×) of a turn by |ω| [radians] about ω. Host array, float64."""
    x, y, z = omega
    cross, angle = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.linalg.norm(omega)
    return np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross


@lru_cache
def series_turned_by(order: int, omega: tuple[float, float, float]) -> np.ndarray:
    """Matrix `(K, K)` to the coefficients of f(exp(ω×) w). Host array, float64."""
    blocks, angle = [], np.linalg.norm(omega)
    for n in range(order + 1):
        # The eigenvalues are known to be integers times the angle: no rounding grows with the degree.
        values, vectors = np.linalg.eigh(-1j * np.einsum("a,aij->ij", omega, _generators_of_degree(n)) / angle)
        blocks.append(np.real(vectors * np.exp(1j * angle * np.round(values)) @ vectors.conj().T))
    return _block_diagonal(blocks)


def quarter_turn(order: int) -> np.ndarray:
    """J: coefficients of f(Q w), Q the turn about x that takes z to y. Jᵀ Z(θ) J is a turn by θ about y, Z about z."""
    return series_turned_by(order, (-np.pi / 2, 0.0, 0.0))


def azimuthal(basis: AbstractBasis) -> tuple[np.ndarray, np.ndarray]:
    """m of every column (negative: sine), and the column of its partner, cosine for sine. Host arrays."""
    column = {mode: k for k, mode in enumerate(basis.modes)}
    return np.array([m for _, m in basis.modes]), np.array([column[n, -m] for n, m in basis.modes])


def partners(basis: AbstractBasis, values: Array) -> Array:
    """What a turn about z mixes a series with: sines for its cosines, minus cosines for its sines. Columns lead.

    Coefficients of f(φ + β) are cos mβ times those of f plus sin mβ times these.
    """
    m, partner = azimuthal(basis)
    return values[partner] * jnp.asarray(np.sign(m), values.dtype).reshape(-1, *(1,) * (values.ndim - 1))


def powers_of(re: Float[Array, " points"], im: Float[Array, " points"], orders: int) -> Float[Array, "2 orders points"]:
    """(Re, Im) of (re + i im)^m for m < orders."""
    return powers((re * re - im * im, 2 * re * im), (re, im), orders)


def spin(turn: Float[Array, "*batch 3 3"]) -> tuple[Float[Array, " *batch"], Float[Array, " *batch"]]:
    """(cos β, sin β) of the turn about the normal that a frame differs by from the meridian's."""
    tangent = meridian_frame(turn[..., 2, :])[..., 0, :]
    return dot(turn[..., 0, :], tangent), -dot(turn[..., 1, :], tangent)


def rotated(order: int, coefficients: Float[Array, "modes channels"], turn: Float[Array, "3 3"]) -> Array:
    """Coefficients of f(turnᵀ w): the series as it looks in the frame whose rows `turn` holds.

    **Raises:** ValueError for anything but a proper rotation, where its values can be seen.
    """
    if turn.shape != (3, 3):
        raise ValueError(f"a rotation is a matrix (3, 3), got {turn.shape}")
    if not isinstance(turn, Tracer):
        square, sign = np.asarray(turn @ turn.T, np.float64), np.linalg.det(np.asarray(turn, np.float64))
        if not (np.allclose(square, np.eye(3), atol=1e3 * float(jnp.finfo(turn.dtype).eps)) and sign > 0):
            raise ValueError(f"a rotation has orthonormal rows and determinant 1, got {np.asarray(turn).tolist()}")
    sphere, dtype = SphericalHarmonics(order), coefficients.dtype
    m = np.abs(azimuthal(sphere)[0])

    def about_z(series, cos, sin):
        re, im = powers_of(cos[None], sin[None], order + 1)
        return series * re[m] + partners(sphere, series) * im[m]

    quarter = jnp.asarray(quarter_turn(order), dtype)
    series = matmul(jnp.asarray(series_turned_by(order, tuple(OBLIQUE)), dtype), coefficients)
    turn = matmul(turn, jnp.asarray(turn_by(OBLIQUE), dtype))
    normal = turn[2]
    series = matmul(quarter, about_z(series, *azimuth(normal)))
    series = matmul(quarter.T, about_z(series, normal[2], jnp.hypot(normal[0], normal[1])))
    return about_z(series, *spin(turn))


def _generators_of_degree(n: int) -> np.ndarray:
    """L_x, L_y, L_z `(3, 2n + 1, 2n + 1)`, by ladder operators between complex harmonics.

    Coefficients of (ω × w) · ∇f are Σ ω_a L_a c, and so those of f(exp(ω×) w) are exp(Σ ω_a L_a) c.
    """
    m = np.arange(-n, n + 1)
    up = np.diag(np.sqrt((n - m[:-1]) * (n + m[:-1] + 1.0)), -1)
    operators = np.stack([0.5j * (up + up.T), 0.5 * (up - up.T), 1j * np.diag(m)])
    real = np.zeros((2 * n + 1, 2 * n + 1), complex)  # real harmonics in complex ones with Condon-Shortley sign
    real[n, n] = 1
    for k in range(1, n + 1):
        sign = (-1.0) ** k
        real[n + k, [n + k, n - k]] = sign / np.sqrt(2), 1 / np.sqrt(2)
        real[n - k, [n + k, n - k]] = -1j * sign / np.sqrt(2), 1j / np.sqrt(2)
    return (real.conj() @ operators @ real.T).real


def _block_diagonal(blocks: list[np.ndarray]) -> np.ndarray:
    ends = np.cumsum([len(block) for block in blocks])
    whole = np.zeros((ends[-1], ends[-1]))
    for end, block in zip(ends, blocks, strict=True):
        whole[end - len(block) : end, end - len(block) : end] = block
    return whole
