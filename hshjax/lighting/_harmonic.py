"""Light from everywhere around, as a series in spherical harmonics."""

from math import isqrt

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float, Real
from hshjax.bases import SphericalHarmonics
from hshjax.bases._base import matmul
from hshjax.brdfs._base import floating, in_dtype
from hshjax.lighting._base import AbstractLighting, Incident, Points
from hshjax.lighting._environment import EnvironmentMap
from hshjax.quadrature import hemisphere_rule


def _degree(degree: int | None) -> int | None:
    if degree is not None and degree < 0:
        raise ValueError(f"degree must be >= 0, got {degree}")
    return degree


class HarmonicLight(AbstractLighting):
    """Distant light of radiance L(w) = Σ_k c_k Y_k(w) [W m^-2 sr^-1], real spherical harmonics in the world.

    `coefficients` `(modes, channels)`, (order + 1)² modes as in `SphericalHarmonics`: orthonormal, without
    Condon-Shortley sign, n rising, then m from -n to n.

    In the reflectance equation it is summed over a rule on the hemisphere of each point, exact to `degree` (None: 64,
    or twice the order where that is more); a higher one is worth its cost where the BRDF has sharp lobes.

    **Raises:** ValueError for a number of modes that is not a square, or other shapes.
    """

    coefficients: Float[Array, "modes channels"] = eqx.field(converter=floating)
    degree: int | None = eqx.field(static=True, default=None, converter=_degree, kw_only=True)

    def __check_init__(self):
        shape = self.coefficients.shape
        if len(shape) != 2 or shape[0] == 0 or isqrt(shape[0]) ** 2 != shape[0]:
            raise ValueError(f"coefficients must have shape ((order + 1)², channels), got {shape}")

    @property
    def order(self) -> int:
        """Largest n."""
        return isqrt(self.coefficients.shape[0]) - 1

    @property
    def basis(self) -> SphericalHarmonics:
        """The functions that the coefficients belong to."""
        return SphericalHarmonics(self.order)

    @property
    def emitters(self) -> int:
        return self._rule(None).weight.size

    def _rule(self, dtype):
        degree = max(64, 2 * self.order) if self.degree is None else self.degree
        return hemisphere_rule(degree, dtype=dtype)

    def incident(self, points: Points) -> Incident:
        light, rule = in_dtype(self, points.frame.dtype), self._rule(points.frame.dtype)
        # Rows of a frame are the local axes: its transpose takes local directions to the world.
        w = jnp.einsum("qi,nij->nqj", rule.w, points.frame, precision=jax.lax.Precision.HIGHEST)
        return Incident(w, light(w) * rule.weight[None, :, None])

    def __call__(self, w: Float[Array, "*batch 3"]) -> Real:
        """The radiance from directions `(*batch, 3)`, `(*batch, channels)`."""
        return self.basis.evaluate(self.coefficients, w)

    @classmethod
    def from_environment(cls, environment: EnvironmentMap, order: int, *, degree: int | None = None) -> "HarmonicLight":
        """The light nearest to an environment map: least squares over its pixels, weighted by their solid angles.

        For maps of fewer pixels than the order resolves the problem has no unique solution; `order` < height / 2 does.

        **Raises:** ValueError for an order that the map does not determine.
        """
        height, width, _ = environment.radiance.shape
        if 2 * order >= min(height, width):
            raise ValueError(f"a map of {height} x {width} pixels determines orders below {min(height, width) / 2:g}")
        basis, radiance = SphericalHarmonics(order), environment.radiance
        direction = jnp.asarray(environment.direction, radiance.dtype)
        weight = jnp.asarray(environment.solid_angle, radiance.dtype)

        def add(sums, row):
            w, value, omega = row
            rows = basis(w)
            return (sums[0] + omega * matmul(rows.T, rows), sums[1] + omega * matmul(rows.T, value)), None

        zero = (
            jnp.zeros((basis.count, basis.count), radiance.dtype),
            jnp.zeros((basis.count, radiance.shape[2]), radiance.dtype),
        )
        (gram, moments), _ = jax.lax.scan(add, zero, (direction, radiance, weight))
        return cls(jnp.linalg.solve(gram, moments), degree=degree)
