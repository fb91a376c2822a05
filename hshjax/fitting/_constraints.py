"""What makes a series a BRDF that could exist, as inequalities that are linear in its coefficients.

- "non_negative": ρ(wi, wo) >= 0 for every pair.
- "energy": the directional albedo ∫ ρ z_i dω_i <= 1 for every wo.

Either is a family of inequalities, one for each point x of a box of angles: row(x) · c >= floor(x). Polar angles enter
as α with z = cos²(α/2): the basis functions are trigonometric polynomials in α up to smooth factors, up to the horizon
α = π, where functions of z may have infinite slope.

**The horizon.** The series g of a foreshortened target stands for (z_i z_o)^p ρ. Under both constraints at once,
0 <= ∫ g z_i^(1-p) dω_i <= z_o^p forces g to vanish at z_o = 0 for every wi; and not only like z_o^(1/2), as HSH of
m = 1 do, for these change their sign with φ. That is a set of linear equations for the coefficients; they are solved
beforehand (`horizon_equations`), and the rows are divided by z_o, so that they stay finite and of order 1.
"""

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.bases import AbstractProductBasis, IsotropicBasis, from_matrix
from hshjax.bases._base import matmul
from hshjax.fitting._blocks import series
from hshjax.quadrature import hemisphere_rule

CONSTRAINTS = ("non_negative", "energy")

NEAREST = {np.dtype(np.float64): 1e-3, np.dtype(np.float32): 1e-2}
"""Smallest cosine at which a quotient series / (z_i z_o) is looked at: its rounding grows like 1 / z²."""

Face = Literal["wraps", "mirrors", "passes", "ends"]
"""What rows do at a face of their box: begin again, run back as they came, pass the pole to other azimuths, or end."""

POLAR: tuple[Face, Face] = ("passes", "ends")
"""The faces of α. At the horizon many a basis holds √z = |cos(α/2)|: a kink, if it were to go on."""


def check_constraints(constraints: tuple[str, ...], rounds: int) -> None:
    """ValueError for an unknown name, or no round to meet the constraints in."""
    if isinstance(constraints, str) or not set(constraints) <= set(CONSTRAINTS):
        raise ValueError(f"constraints must be a tuple of names among {', '.join(CONSTRAINTS)}, got {constraints!r}")
    if rounds < 1:
        raise ValueError(f"rounds must be >= 1, got {rounds}")


@dataclass(frozen=True)
class NonNegative:
    """row(x) = B(wi, wo) / (z_i^depth_i z_o^depth_o), floor 0.

    x is (α_i, α_o, Δφ) for isotropic bases, (α_i, α_o, φ_i, φ_o) for others.
    """

    basis: AbstractProductBasis
    depth: tuple[int, int]
    edge: float

    @property
    def box(self) -> np.ndarray:
        """Lower and upper corner, `(2, d)`."""
        azimuths = [(0, np.pi)] if _bilateral(self.basis) else [(-np.pi, np.pi)] * (1 if self.basis.isotropic else 2)
        return np.array([(0, self.edge), (0, self.edge), *azimuths]).T

    @property
    def swaps(self) -> bool:
        """Whether the points with α_i <= α_o say everything."""
        return self.basis.reciprocal

    @property
    def faces(self) -> tuple[tuple[Face, Face], ...]:
        """Of every coordinate, the lower and the upper one."""
        turn: Face = "mirrors" if _bilateral(self.basis) else "wraps"
        return (POLAR,) * 2 + ((turn, turn),) * (self.box.shape[1] - 2)

    def degrees(self) -> tuple[int, ...]:
        """Trigonometric degree of the rows in every coordinate."""
        polar, azimuth = _degrees(self.basis)
        return (polar, polar, *(azimuth,) * (self.box.shape[1] - 2))

    def pairs(self, x: Float[Array, "n d"]) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """The directions of points of the box."""
        azimuth = x[:, 2:] if x.shape[1] == 4 else jnp.stack([jnp.zeros_like(x[:, 2]), x[:, 2]], axis=1)
        return _from_polar(x[:, 0], azimuth[:, 0]), _from_polar(x[:, 1], azimuth[:, 1])

    def scale(self, x: Float[Array, "n d"]) -> Float[Array, " n"]:
        """What the basis functions are divided by."""
        zi, zo = _cosine(x[:, 0]), _cosine(x[:, 1])
        return zi ** self.depth[0] * zo ** self.depth[1]

    def rows(self, x: Float[Array, "n d"]) -> Float[Array, "n modes"]:
        return self.basis(*self.pairs(x)) / self.scale(x)[:, None]

    def sums(self, coefficients: Float[Array, "modes channels"], x: Float[Array, "n d"]) -> Float[Array, "n channels"]:
        """rows(x) @ coefficients."""
        return series(self.basis, coefficients, *self.pairs(x)) / self.scale(x)[:, None]

    def floor(self, x: Float[Array, "n d"]) -> Float[Array, " n"]:
        return jnp.zeros_like(x[:, 0])

    def sensitivity(self, x: Float[Array, "n d"]) -> Float[Array, " n"]:
        """A bound of |row(x)|: of what coefficients that are off by a vector of length 1 can do."""
        return largest(self.basis) ** 2 / self.scale(x)


@dataclass(frozen=True)
class Energy:
    """row(x) = -∫ B(wi, wo) z_i^(1-p) dω_i / z_o^depth, floor -z_o^(p - depth), p the exponent of the target.

    x is (α_o,) for isotropic bases, (α_o, φ_o) for others.
    """

    basis: AbstractProductBasis
    exponent: float
    depth: float
    edge: float

    @property
    def box(self) -> np.ndarray:
        """Lower and upper corner, `(2, d)`."""
        return np.array([(0, self.edge), *([] if self.basis.isotropic else [(-np.pi, np.pi)])]).T

    @property
    def swaps(self) -> bool:
        """There is one direction only."""
        return False

    @property
    def faces(self) -> tuple[tuple[Face, Face], ...]:
        """Of every coordinate, the lower and the upper one."""
        around: tuple[Face, Face] = ("wraps", "wraps")
        return (POLAR, around)[: self.box.shape[1]]

    def degrees(self) -> tuple[int, ...]:
        """Trigonometric degree of the rows in every coordinate."""
        return _degrees(self.basis)[: self.box.shape[1]]

    def outgoing(self, x: Float[Array, "n d"]) -> Float[Array, "n 3"]:
        """The directions of points of the box."""
        return _from_polar(x[:, 0], x[:, 1] if x.shape[1] == 2 else jnp.zeros_like(x[:, 0]))

    def scale(self, x: Float[Array, "n d"]) -> Float[Array, " n"]:
        """What the integrals are divided by."""
        return _power(_cosine(x[:, 0]), self.depth)

    def rows(self, x: Float[Array, "n d"]) -> Float[Array, "n modes"]:
        moments = jnp.asarray(incident_moments(self.basis, 1 - self.exponent), x.dtype)
        return -matmul(self.basis.basis(self.outgoing(x)), moments.T) / self.scale(x)[:, None]

    def sums(self, coefficients: Float[Array, "modes channels"], x: Float[Array, "n d"]) -> Float[Array, "n channels"]:
        """rows(x) @ coefficients."""
        moments = jnp.asarray(incident_moments(self.basis, 1 - self.exponent), x.dtype)
        return -matmul(self.basis.basis(self.outgoing(x)), matmul(moments.T, coefficients)) / self.scale(x)[:, None]

    def floor(self, x: Float[Array, "n d"]) -> Float[Array, " n"]:
        return -_power(_cosine(x[:, 0]), self.exponent - self.depth)

    def sensitivity(self, x: Float[Array, "n d"]) -> Float[Array, " n"]:
        """A bound of |row(x)|: of what coefficients that are off by a vector of length 1 can do."""
        moments = incident_moments(self.basis, 1 - self.exponent)
        return largest(self.basis) * np.linalg.norm(moments, 2) / self.scale(x)


Family = NonNegative | Energy


def families(
    basis: AbstractProductBasis, exponent: float, constraints: tuple[str, ...], dtype: np.dtype
) -> tuple[Family, ...]:
    """The families of inequalities for a series that stands for (z_i z_o)^exponent ρ."""
    vanishing = vanishes(exponent, constraints)
    edge = last_polar(dtype) if vanishing else np.pi
    found: list[Family] = []
    if "non_negative" in constraints:
        found.append(NonNegative(basis, (int(vanishing and basis.reciprocal), int(vanishing)), edge))
    if "energy" in constraints:
        found.append(Energy(basis, exponent, exponent if vanishing else 0.0, edge))
    return tuple(found)


def last_polar(dtype: np.dtype) -> float:
    """α of the smallest cosine by which something is divided."""
    return float(2 * np.arccos(np.sqrt(NEAREST[dtype])))


def polar_angle(alpha: float) -> float:
    """θ of α: cos θ = cos²(α/2)."""
    return float(np.arccos(np.cos(alpha / 2) ** 2))


def vanishes(exponent: float, constraints: tuple[str, ...]) -> bool:
    """Whether the series is forced to vanish at the horizon."""
    return exponent > 0 and set(constraints) == set(CONSTRAINTS)


def horizon_equations(basis: AbstractProductBasis) -> np.ndarray:
    """L with L c = 0 where the series vanishes like z_o at the horizon, `(equations, modes)`. Host array.

    Of a series h(wi)ᵀ A h(wo) it asks for A u = 0 with u the values of the basis on the horizon, one u for each signed
    azimuthal order that vanishes more slowly than z.
    """
    single, near = basis.basis, 1e-16
    azimuths = np.linspace(0, 2 * np.pi, 4 * single.order + 4, endpoint=False) + 0.1
    horizon = np.stack([np.cos(azimuths), np.sin(azimuths), np.full(azimuths.size, near)], axis=1)
    with jax.enable_x64(True):
        values = np.asarray(single(jnp.asarray(horizon)))
    signed = np.array([m for _, m in single.modes])
    slow = []
    for m in np.unique(signed):
        part = np.where(signed == m, values, 0)
        largest = part[np.argmax(np.linalg.norm(part, axis=1))]
        length = np.linalg.norm(largest)
        if length > near**0.75:  # z^0 and z^(1/2) are above, z^1 and z^(3/2) below
            slow.append(largest / length)
    mode, a, b, value = basis.entries()
    equations = np.zeros((len(slow), single.count, basis.count))
    for equation, u in zip(equations, slow, strict=True):
        np.add.at(equation, (a, mode), value * u[b])
    return equations.reshape(-1, basis.count)


@lru_cache
def interior(basis: AbstractProductBasis, exponent: float, constraints: tuple[str, ...]) -> np.ndarray:
    """Coefficients `(modes,)` of a function that lies inside all inequalities: rows of `NonNegative` add up to 1.

    Under "energy" alone that is 0. Host array.
    """
    if "non_negative" not in constraints:
        return np.zeros(basis.count)
    single = basis.basis
    depth = int(vanishes(exponent, constraints))
    z = np.linspace(0, 1, 8 * single.order + 8)
    meridian = np.stack([np.sqrt(1 - z**2), 0 * z, z], axis=1)
    with jax.enable_x64(True):
        zonal = np.asarray(single(jnp.asarray(meridian))) * [m == 0 for _, m in single.modes]
        incident, outgoing = (np.linalg.lstsq(zonal, z**d)[0] for d in (depth * basis.reciprocal, depth))
        return np.asarray(from_matrix(basis, jnp.asarray(np.outer(incident, outgoing))))


@lru_cache
def incident_moments(basis: AbstractProductBasis, exponent: float) -> np.ndarray:
    """`(modes, K)`: ∫ B_k(wi, wo) z_i^exponent dω_i = Σ_b moments[k, b] h_b(wo). Host array."""
    single = basis.basis
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        # Exact for z^(1/2) times a polynomial in z, which the azimuthal order 0 of every basis is.
        rule = hemisphere_rule(2 * single.order + 4, sqrt=True, dtype=np.float64)
        values = np.asarray(single(rule.w))
        integrals = (np.asarray(rule.weight) * np.asarray(rule.w)[:, 2] ** exponent) @ values
    mode, a, b, value = basis.entries()
    moments = np.zeros((basis.count, single.count))
    np.add.at(moments, (mode, b), value * integrals[a])
    return moments


@lru_cache
def largest(basis: AbstractProductBasis) -> float:
    """The largest |h(w)| of the basis of single directions; so large as its square are the rows of the pair basis."""
    polar = np.linspace(0, np.pi / 2, 16 * basis.basis.order + 16)
    meridian = np.stack([np.sin(polar), 0 * polar, np.cos(polar)], axis=1)
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        return float(np.max(np.linalg.norm(np.asarray(basis.basis(jnp.asarray(meridian))), axis=1)))


@partial(jax.jit, static_argnums=0)
def family_rows(family: Family, x: Float[Array, "n d"]) -> Float[Array, "n modes"]:
    return family.rows(x)


@partial(jax.jit, static_argnums=0)
def family_gaps(
    family: Family,
    coefficients: Float[Array, "modes channels"],
    rounding: Float[Array, " channels"],
    x: Float[Array, "n d"],
) -> Float[Array, "n channels"]:
    """row(x) · c - floor(x) - rounding sensitivity(x) for every channel."""
    allowance = jnp.outer(family.sensitivity(x), rounding)
    return family.sums(coefficients, x) - family.floor(x)[:, None] - allowance


@partial(jax.jit, static_argnums=0)
def family_levels(family: Family, x: Float[Array, "n d"]) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Floor and sensitivity."""
    return family.floor(x), family.sensitivity(x)


def _cosine(alpha: Array) -> Array:
    return jnp.cos(alpha / 2) ** 2


def _power(z: Array, exponent: float) -> Array:
    return jnp.ones_like(z) if exponent == 0 else z ** (int(exponent) if exponent == 1 else exponent)


def _from_polar(alpha: Array, phi: Array) -> Array:
    z = _cosine(alpha)
    rim = jnp.sin(alpha / 2) * jnp.sqrt(1 + z)
    return jnp.stack([rim * jnp.cos(phi), rim * jnp.sin(phi), z], axis=-1)


def _bilateral(basis: AbstractProductBasis) -> bool:
    return isinstance(basis, IsotropicBasis) and basis.bilateral


def _degrees(basis: AbstractProductBasis) -> tuple[int, int]:
    """In α and in φ. Zernike functions are of half their order in α, but a grid that takes it so misses minima."""
    return max(1, basis.basis.order), max(1, basis.basis.order)
