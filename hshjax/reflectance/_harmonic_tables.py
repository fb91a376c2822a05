"""The constant matrices of Eq. 1 in closed form; what they are for is said in `hshjax/reflectance/_harmonic.py`."""

from functools import lru_cache
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.bases import AbstractBasis, IsotropicBasis, SphericalHarmonics
from hshjax.bases._rotation import EXACT, azimuthal, partners, quarter_turn
from hshjax.brdfs import LinearBRDF
from hshjax.brdfs._linear import EXPONENTS
from hshjax.quadrature import polar_nodes
from hshjax.reflectance._parts import products


class Problem(NamedTuple):
    """What is known before any number is: static under jit."""

    order: int  # of the light
    basis: AbstractBasis  # of one direction of the BRDF
    symmetry: Literal["bilateral", "isotropic", "none"]
    exponent: float  # of the cosines that the BRDF's series holds

    @classmethod
    def of(cls, brdf: LinearBRDF, order: int) -> "Problem":
        """The problem of a BRDF under a light of some order."""
        symmetry = "none"
        if isinstance(brdf.basis, IsotropicBasis):
            symmetry = "bilateral" if brdf.basis.bilateral else "isotropic"
        return cls(order, products(brdf).basis, symmetry, EXPONENTS[brdf.target])


class Layout(NamedTuple):
    """Entries (n, k), 0 <= k <= n, of a series in spherical harmonics, those of even n + k first. Host arrays.

    Each stands for two columns, the cosine and the sine of kφ: `first` is the cosine where n is even and the sine where
    it is odd, `second` the other one. -1 stands for the sine of k = 0, which there is not.
    """

    k: np.ndarray
    first: np.ndarray
    second: np.ndarray
    sense: np.ndarray  # (-1)^n: the sense in which a turn about z takes (first, second)
    half: int  # number of entries of even n + k


@lru_cache
def layout(order: int) -> Layout:
    """The entries of a light of some order."""
    n, k = np.tril_indices(order + 1)
    odd = (n + k) % 2
    rank = np.argsort(odd, kind="stable")
    n, k = n[rank], k[rank]
    cosine, sine = n * n + n + k, np.where(k > 0, n * n + n - k, -1)
    even = n % 2 == 0
    return Layout(k, np.where(even, cosine, sine), np.where(even, sine, cosine), 1 - 2 * (n % 2), int(np.sum(odd == 0)))


def light_matrices(order: int, coefficients: Float[Array, "modes channels"]) -> tuple[Array, Array]:
    """Step 1, (channels, entries, powers of exp(iφ), real and imaginary): of even powers, and of odd ones."""
    sphere, entries = SphericalHarmonics(order), layout(order)
    parts = jnp.stack([coefficients, partners(sphere, coefficients)])  # with cos mφ, with sin mφ
    matrices = []
    for parity, rows in enumerate((entries.first, entries.second)):
        # A quarter turn keeps degrees apart: of each power it takes two harmonics, m and -m, to an entry.
        power, n = np.arange(parity, order + 1, 2)[None, :], np.sqrt(np.maximum(rows, 0)).astype(int)[:, None]
        there = (rows[:, None] >= 0) & (power <= n)
        table = 0
        for sign in (1, -1):
            column = np.where(there, n * n + n + sign * power, 0)
            counts = there & ((power > 0) | (sign > 0))
            turn = np.where(counts, quarter_turn(order)[np.maximum(rows, 0)[:, None], column], 0)
            table += jnp.asarray(turn, coefficients.dtype)[None, :, :, None] * parts[:, column]
        table = jnp.transpose(table, (3, 1, 0, 2))
        matrices.append(table.reshape(*table.shape[:2], -1))
    return matrices[0], matrices[1]


CLASSES = ((False, 0), (False, 1), (True, 1), (True, 0))
"""(sine, parity of m) of the functions that each of the four groups of entries leads to."""


@lru_cache
def classes(basis: AbstractBasis) -> tuple[np.ndarray, ...]:
    """Columns of a basis in each of the four classes. Host arrays."""
    return tuple(
        np.array([k for k, (_, m) in enumerate(basis.modes) if (m < 0, m % 2) == kind], np.int32) for kind in CLASSES
    )


def grouped(entries: Layout, first, second) -> tuple:
    """Rows of the four groups, in the order of `CLASSES`: each is even or odd as a whole in each of x, y and z."""
    half = entries.half
    return first[..., :half, :], second[..., :half, :], second[..., half:, :], first[..., half:, :]


@lru_cache
def restriction(order: int, basis: AbstractBasis, exponent: float, dtype: np.dtype) -> np.ndarray:
    """M_ja = ∫ Y_j h_a z^(1-p) dω over the hemisphere, `(modes of the light, modes of the BRDF)`. Host array.

    By Gauss-Legendre in v, z = v²: the factors √z of HSH and of the exponent are polynomials there, and what is left,
    √(1 + z), converges by a factor of 20 a node. `dtype`: the widest float that is switched on.
    """
    z, weight = polar_nodes(order + basis.order + 16, sqrt=True)
    w = np.stack([np.sqrt((1 - z) * (1 + z)), 0 * z, z], axis=-1)
    bases = (SphericalHarmonics(order), basis)
    with jax.ensure_compile_time_eval():
        rows = [np.asarray(functions(jnp.asarray(w, dtype)), np.float64) for functions in bases]
    (m, partner), (m_h, partner_h) = (azimuthal(functions) for functions in bases)
    # At φ = 0 a cosine is its radial part, which is that of the sine as well.
    y = rows[0][:, np.where(m < 0, partner, np.arange(m.size))]
    h = rows[1][:, np.where(m_h < 0, partner_h, np.arange(m_h.size))]
    radial = (y * (weight * z ** (1 - exponent))[:, None]).T @ h
    return np.where(m[:, None] == m_h, radial * np.pi * np.where(m_h == 0, 2, 1), 0)


@lru_cache
def _restrictions(problem: Problem, dtype: np.dtype) -> tuple[np.ndarray, ...]:
    m = restriction(problem.order, problem.basis, problem.exponent, dtype)
    entries, turned = layout(problem.order), quarter_turn(problem.order) @ m
    rows = (np.where(rows[:, None] >= 0, turned[rows], 0) for rows in (entries.first, entries.second))
    return tuple(g[:, columns].T for g, columns in zip(grouped(entries, *rows), classes(problem.basis), strict=True))


def restrictions(problem: Problem, dtype) -> list[Array]:
    """Step 3 without A: Mᵀ Jᵀ from each group to its class, (functions, entries)."""
    return [jnp.asarray(r, dtype) for r in _restrictions(problem, jnp.result_type(float))]


SOURCES = {"bilateral": ((0,), (1,), (2,), (3,)), "isotropic": ((0, 3), (1, 2), (2, 1), (3, 0))}
"""Groups that each class of functions of wo takes its light from, by symmetry.

Cosines of mΔφ stay within a class; sines, absent under bilateral symmetry, come from its twin.
"""


def materials(problem: Problem, matrix: Float[Array, "k k channels"]) -> Any:
    """Step 3 of an isotropic BRDF: for each class and each of its sources (channels, functions, entries).

    Without symmetry A waits until the points' own azimuth has come in: itself.
    """
    if problem.symmetry == "none":
        return matrix
    columns, down = classes(problem.basis), restrictions(problem, matrix.dtype)

    def material(source, target):
        block = matrix[columns[source]][:, columns[target]]
        return jnp.einsum("abc,ai->cbi", block, down[source], precision=EXACT)

    return [[material(s, target) for s in sources] for target, sources in enumerate(SOURCES[problem.symmetry])]
