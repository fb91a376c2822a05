"""Light from everywhere around, as a series in spherical harmonics."""

from math import isqrt

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._fields import floating
from hshjax._typing import Array, Float, PairFunction, Real
from hshjax.bases import SphericalHarmonics
from hshjax.bases._base import matmul
from hshjax.bases._rotation import rotated
from hshjax.brdfs import Lambert
from hshjax.brdfs._base import in_dtype
from hshjax.geometry import to_world
from hshjax.lighting._base import AbstractLighting, Incident, Points
from hshjax.lighting._environment import EnvironmentMap
from hshjax.lighting._order import visible_order
from hshjax.quadrature import hemisphere_rule


def _degree(degree: int | None) -> int | None:
    if degree is not None and degree < 0:
        raise ValueError(f"degree must be >= 0, got {degree}")
    return degree


class HarmonicLight(AbstractLighting):
    """Distant light of radiance L(w) = Σ_k c_k Y_k(w) [W m^-2 sr^-1], real spherical harmonics in the world.

    `coefficients` `(modes, channels)`, (order + 1)² modes as in `SphericalHarmonics`: orthonormal, without
    Condon-Shortley sign, n rising, then m from -n to n.

    In the reflectance equation it is summed over a rule on the hemisphere of each point (z = v², as HSH ask for), exact
    to `degree`: the higher, the sharper the lobes of the BRDF may be. None: in closed form under a BRDF that is linear
    in a basis, see `reflect`; else a degree of 48, or twice the order where that is more.

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
    def closed(self) -> bool:
        """Whether the reflectance equation may take it in closed form: nobody has asked for a rule."""
        return self.degree is None

    @property
    def emitters(self) -> int:
        return self._rule(None).weight.size

    def _rule(self, dtype):
        degree = max(48, 2 * self.order) if self.degree is None else self.degree
        return hemisphere_rule(degree, sqrt=True, dtype=dtype)

    def incident(self, points: Points) -> Incident:
        light, rule = in_dtype(self, points.frame.dtype), self._rule(points.frame.dtype)
        # Rows of a frame are the local axes: its transpose takes local directions to the world.
        w = to_world(points.frame[:, None], rule.w[None])
        return Incident(w, light(w) * rule.weight[None, :, None])

    def __call__(self, w: Float[Array, "*batch 3"]) -> Real:
        """The radiance from directions `(*batch, 3)`, `(*batch, channels)`."""
        return self.basis.evaluate(self.coefficients, w)

    def rotated(self, turn: Float[Array, "3 3"]) -> "HarmonicLight":
        """The light turned with the world by a proper rotation: L'(w) = L(turnᵀ w).

        **Raises:** ValueError for another matrix, a reflection for one.
        """
        return HarmonicLight(rotated(self.order, self.coefficients, jnp.asarray(turn)), degree=self.degree)

    @classmethod
    def from_environment(
        cls,
        environment: EnvironmentMap,
        order: int | None = None,
        *,
        brdf: PairFunction | None = None,
        tolerance: float = 0.01,
        degree: int | None = None,
    ) -> "HarmonicLight":
        """The light nearest to an environment map: least squares over its pixels, weighted by their solid angles.

        `order` None: the smallest one at which radiance differs by less than `tolerance` from that under the map, for
        surfaces of `brdf` (None: Lambert), relative and in the root mean square over orientations and views.

        A map of n rows determines orders below n / 2, one of fewer columns than rows those below half its columns.

        **Raises:** ValueError for an order that the map does not determine, and where none is enough.
        """
        if not isinstance(environment, EnvironmentMap):
            raise ValueError(f"a series comes of an EnvironmentMap(image, up=...), got a {type(environment).__name__}")
        if order is None:
            order = visible_order(Lambert(jnp.ones(1)) if brdf is None else brdf, environment, tolerance)
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
