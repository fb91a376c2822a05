"""Eq. 1 for an eye far away: the radiance as a series in the normal.

Under a distant light and seen from a distance, points of one isotropic material differ by their normals only: R(n) is
the reflectance map (Horn). Where the light is a series of order N and the BRDF one of order K, the map is a series too,

    R(n) = [E(n) + u(z) O(n)] / z^p,   z = n·v

with E from the BRDF's functions of even azimuthal order and O from those of odd order, u(z) the factor of the latter
that is no polynomial (2 √(z / (1 + z)) for HSH). E and O live in the frame of the eye: polynomials in z up to degree
N + K, times trigonometric ones in azimuth up to order N. So an image costs as much as a series of that size, whose
derivatives by the normal are those of polynomials, at the eye's own direction as anywhere.

Its coefficients are linear in the light, in the BRDF, and diagonal in the azimuthal order about the eye. They are found
on Gauss-Legendre nodes in z, which is exact.
"""

from functools import lru_cache, partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._special import RadialTables, jacobi_matrix, radial_tables
from hshjax._typing import Array, Float
from hshjax.bases import AbstractBasis, SphericalHarmonics, to_matrix
from hshjax.bases._base import Chart, matmul
from hshjax.bases._rotation import EXACT, azimuthal, partners, quarter_turn, rotated
from hshjax.brdfs import LinearBRDF
from hshjax.geometry import frame, upper
from hshjax.lighting import HarmonicLight
from hshjax.quadrature import polar_nodes
from hshjax.reflectance._harmonic_tables import Problem, restriction
from hshjax.reflectance._parts import products


class NormalSeries(AbstractBasis):
    """The functions of the normal that E and O are series in, |m| <= order, and polynomials of degree <= `degree` in z.

        P_j(z) Re|Im(q^m) for even m,   P_j(z) Re|Im(q^{m-1} (x + iy)) for odd m,   q = (x + iy) / √(1 + z)

    with the polynomials of Zernike, (1 - z)^{m/2} being what both start with. `modes` holds (j + |m|, m).
    """

    order: int = eqx.field(static=True)
    degree: int = eqx.field(static=True)

    @property
    def modes(self) -> tuple[tuple[int, int], ...]:
        counts = self.radial_counts()
        return tuple((j + abs(m), m) for m in range(-self.order, self.order + 1) for j in range(counts[abs(m)]))

    def radial_counts(self) -> tuple[int, ...]:
        return tuple(self.degree + 1 - (m + 1) // 2 for m in range(self.order + 1))

    def radial_index(self, n: int, m: int) -> int:
        return n - abs(m)

    def tables(self) -> RadialTables:
        return _radial_tables(self)

    def chart(self, w: Float[Array, "points 3"]) -> Chart:
        x, y, z = w[:, 0], w[:, 1], upper(w[:, 2])
        scale = 1 / (1 + z)
        return Chart(1 - 2 * z, (scale * (x * x - y * y), scale * 2 * x * y), (x, y))

    def __hash__(self) -> int:
        return hash((type(self), self.order, self.degree))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, NormalSeries) and (self.order, self.degree) == (other.order, other.degree)


@lru_cache
def _radial_tables(basis: NormalSeries) -> RadialTables:
    def first_norm(m):
        return np.sqrt((m + 1) / (2 * np.pi if m == 0 else np.pi))

    return radial_tables(basis.radial_counts(), first_norm, lambda m, n: jacobi_matrix(0, m, n))


@eqx.filter_jit
def map_radiance(
    brdf: LinearBRDF, light: HarmonicLight, normal: Float[Array, "n 3"], view: Float[Array, " 3"]
) -> Float[Array, "n channels"]:
    """Radiance `(n, channels)` of an isotropic material towards one `view`; black where the normal is zero."""
    problem = Problem.of(brdf, light.order)
    turn = frame(view)
    local = matmul(normal, turn.T)
    above = ~(local[:, 2:] <= 0)  # NaN is not below: it stays NaN
    local = jnp.where(above, local, jnp.asarray([[0, 0, 1]], local.dtype))
    matrix = to_matrix(products(brdf), brdf.coefficients).astype(normal.dtype)
    coefficients = rotated(light.order, light.coefficients.astype(normal.dtype), turn)
    channels = jnp.broadcast_shapes(coefficients.shape[1:], matrix.shape[2:])
    coefficients = jnp.broadcast_to(coefficients, coefficients.shape[:1] + channels)
    series = _coefficients(problem, coefficients, jnp.broadcast_to(matrix, matrix.shape[:2] + channels))
    value = _basis(problem).evaluate(series, local)
    radiance = value[:, 0] + _odd_factor(problem.basis, local[:, 2])[:, None] * value[:, 1]
    if problem.exponent:
        radiance /= local[:, 2:] ** problem.exponent
    return jnp.where(above, radiance, 0)


def _basis(problem: Problem) -> NormalSeries:
    return NormalSeries(problem.order, problem.order + problem.basis.order)


def _odd_factor(basis: AbstractBasis, z: Float[Array, " points"]) -> Float[Array, " points"]:
    """u: what the odd powers of a basis's azimuthal variable hold besides x + iy."""
    return basis.chart(jnp.stack([jnp.ones_like(z), jnp.zeros_like(z), z], axis=-1)).odd[0]


class Nodes(NamedTuple):
    """What the coefficients are found with, on nodes i of z. Host arrays.

    - `light` (cosine | sine, i, l, m, M): Wigner's d between the eye's frame (order M) and the normal's (order m).
    - `brdf` (i, even | odd, b, m): functions of wo, cosines only, of the order m; odd ones without u.
    - `series` (M, j, i): from values on the nodes to the radial coefficients.
    """

    light: np.ndarray
    brdf: np.ndarray
    series: np.ndarray


@lru_cache
def _nodes(problem: Problem, dtype: np.dtype) -> Nodes:
    """`dtype`: the widest float that is switched on."""
    order, result = problem.order, _basis(problem)
    z, weight = polar_nodes(2 * result.degree)
    rim, none = np.sqrt((1 - z) * (1 + z)), np.zeros_like(z)
    with jax.ensure_compile_time_eval():
        # Seen from the normal, whose tangent points away from the eye, the eye is at azimuth π.
        rows = np.asarray(problem.basis(jnp.asarray(np.stack([-rim, none, z], -1), dtype)), np.float64)
        odd = np.asarray(_odd_factor(problem.basis, jnp.asarray(z, dtype)), np.float64)
        values = np.asarray(result(jnp.asarray(np.stack([rim, none, z], -1), dtype)), np.float64)

    m_b, _ = azimuthal(problem.basis)
    of_order = m_b[:, None] == np.arange(order + 1)  # no sines: they vanish at azimuth π
    brdf = np.stack([rows[:, :, None] * (of_order & (m_b[:, None] % 2 == parity)) for parity in (0, 1)], axis=1)
    brdf[:, 1] /= odd[:, None, None]

    series = np.zeros((order + 1, result.degree + 1, z.size))
    for column, (n, m) in enumerate(result.modes):
        if m >= 0:
            norm = np.pi * (2 if m == 0 else 1) / (1 + z if m % 2 else 1)
            series[m, n - m] = norm * weight * values[:, column]
    return Nodes(_wigner(order, z + 1j * rim), brdf, series)


def _wigner(order: int, turn: np.ndarray) -> np.ndarray:
    """d (cosine | sine, i, l, m, M) of turns about y by the angles of unit complex numbers. Host array."""
    d = np.zeros((2, turn.size, order + 1, order + 1, order + 1))
    for degree in range(order + 1):
        block = slice(degree**2, (degree + 1) ** 2)
        quarter, m = quarter_turn(order)[block, block], np.arange(-degree, degree + 1)
        power = turn[:, None] ** np.abs(m)
        about = (
            np.eye(m.size) * np.real(power)[:, :, None]
            + np.eye(m.size)[::-1] * (np.sign(m) * np.imag(power))[:, :, None]
        )
        whole = quarter.T @ about @ quarter
        d[0, :, degree, : degree + 1, : degree + 1] = whole[:, degree:, degree:]
        d[1, :, degree, : degree + 1, : degree + 1] = whole[:, degree::-1, degree::-1]
    return d


def _coefficients(problem: Problem, light: Array, matrix: Array) -> Float[Array, "modes parities channels"]:
    """Of E and O, from those of the light in the eye's frame and the BRDF's matrix."""
    product = partial(jnp.einsum, precision=EXACT)
    wide, dtype = jnp.result_type(float), matrix.dtype
    d, brdf, series = (jnp.asarray(array, dtype) for array in _nodes(problem, wide))
    restricted = jnp.asarray(restriction(problem.order, problem.basis, problem.exponent, wide), dtype)
    material = product("ja,abc->jbc", restricted, matrix)
    m_b, _ = azimuthal(problem.basis)
    every_m = np.arange(problem.order + 1)

    def on_nodes(kind, sign, light):
        """Values (i, parity, M, channels) from the cosines (kind 0) or sines (1) about the normal."""
        row, there = _rows(problem.order, np.abs(m_b), 1 - 2 * kind)
        local = product("ipbm,lbc->iplmc", brdf, jnp.where(there, material[row, np.arange(m_b.size)], 0))
        row, there = _rows(problem.order, every_m, sign)
        return product("ilmM,iplmc,lMc->ipMc", d[kind], local, jnp.where(there, light[row], 0))

    radial = []
    for sign in (1, -1):  # cosines and sines about the eye
        value = on_nodes(0, sign, light)
        if problem.symmetry == "isotropic":
            value += on_nodes(1, sign, partners(SphericalHarmonics(problem.order), light))
        radial.append(product("Mji,ipMc->Mjpc", series, value))
    n, m = np.array(_basis(problem).modes).T
    return jnp.stack(radial)[(m < 0).astype(int), np.abs(m), n - np.abs(m)]


def _rows(order: int, m: np.ndarray, sign: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns (l, ±m) of spherical harmonics, `(order + 1, len(m))`, and where there are such. Host arrays."""
    degree = np.arange(order + 1)[:, None]
    there = m <= degree
    return np.where(there, degree * (degree + 1) + sign * m, 0), there[:, :, None]
