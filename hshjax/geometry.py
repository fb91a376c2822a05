"""Directions, angles, charts and frames.

Local frame: the normal is +z. Directions are unit vectors that point away from the surface, `(*batch, 3)`; angles
appear only at the edges (readers, plots), in radians, θ from the normal and φ from +x towards +y.
"""

from functools import reduce
from operator import add

import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float, Real


def common_dtype(*arrays: Array) -> tuple[Array, ...]:
    """The arrays in their common floating dtype, explicitly, so that strict promotion has nothing to object to."""
    arrays = tuple(jnp.asarray(a) for a in arrays)
    with jax.numpy_dtype_promotion("standard"):
        dtype = jnp.result_type(*arrays)
    if not jnp.issubdtype(dtype, jnp.inexact):
        dtype = jnp.result_type(float)  # a pole typed as [0, 0, 1]
    return tuple(a.astype(dtype) for a in arrays)


def as_directions(*w: Array) -> tuple[Float[Array, "... 3"], ...]:
    """Arguments that should be directions, in their common floating dtype.

    **Raises:** ValueError for anything but three components (an array that indexes past its end is clamped, not told).
    """
    for array in w:
        if jnp.ndim(array) < 1 or jnp.shape(array)[-1] != 3:
            raise ValueError(f"directions are unit vectors (*batch, 3), got shape {jnp.shape(array)}")
    return common_dtype(*w)


def direction(theta: Real, phi: Real) -> Float[Array, "*batch 3"]:
    """The unit vector at polar angle θ and azimuth φ [radians]; θ and φ broadcast."""
    theta, phi = jnp.broadcast_arrays(theta, phi)
    sin = jnp.sin(theta)
    return jnp.stack([sin * jnp.cos(phi), sin * jnp.sin(phi), jnp.cos(theta)], axis=-1)


def angles(w: Float[Array, "*batch 3"]) -> tuple[Float[Array, " *batch"], Float[Array, " *batch"]]:
    """(θ, φ) of a unit vector [radians], φ in (-π, π]; accurate near the pole, where arccos is not."""
    rim = jnp.hypot(w[..., 0], w[..., 1])
    return jnp.arctan2(rim, w[..., 2]), jnp.arctan2(w[..., 1], w[..., 0])


def normalized(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """v / |v|; the zero vector stays zero, with zero gradient."""
    square = dot(v, v)[..., None]
    nonzero = square != 0  # NaN stays NaN
    return jnp.where(nonzero, v / jnp.sqrt(jnp.where(nonzero, square, 1)), 0)


def half_vector(wi: Float[Array, "*batch 3"], wo: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """h = (wi + wo) / |wi + wo|."""
    return normalized(wi + wo)


def from_half_difference(theta_h: Real, theta_d: Real, phi_d: Real) -> tuple[Real, Real]:
    """(wi, wo), `(*batch, 3)` each, of half angle θ_h and difference direction (θ_d, φ_d) [radians], with φ_h = 0.

    They may lie below the horizon. Source: Rusinkiewicz, A New Change of Variables for Efficient BRDF Representation,
    EGWR 1998.
    """
    theta_h, theta_d, phi_d = jnp.broadcast_arrays(theta_h, theta_d, phi_d)
    cos, sin = jnp.cos(theta_h), jnp.sin(theta_h)

    def lifted(d):
        return jnp.stack(tilted(cos, sin, d[..., 0], d[..., 1], d[..., 2]), axis=-1)

    return lifted(direction(theta_d, phi_d)), lifted(direction(theta_d, phi_d + jnp.pi))


def tilted(cos, sin, x, y, z):
    """Components of (x, y, z) after a turn about y that takes the normal to a half vector at φ_h = 0, of cos θ_h and
    sin θ_h: from the frame of the half vector to the local one. Arrays of numpy, or of jax, that broadcast.
    """
    return cos * x + sin * z, y, cos * z - sin * x


def dot(a: Float[Array, "... components"], b: Float[Array, "... components"]) -> Float[Array, " *batch"]:
    """Scalar product along the last axis; the others broadcast."""
    # Written out: XLA's compiler for processors makes a loop without vectors of a sum over a short axis, of 16 times
    # the time, and no longer fuses what comes before it.
    of_a, of_b = jnp.unstack(a, axis=-1), jnp.unstack(b, axis=-1)
    return reduce(add, [x * y for x, y in zip(of_a, of_b, strict=True)])


def dot_xy(a: Float[Array, "... 3"], b: Float[Array, "... 3"]) -> Float[Array, " *batch"]:
    """a_x b_x + a_y b_y: sin θ_a sin θ_b cos Δφ of directions, without the cancellation of a·b - a_z b_z."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def upper(z: Real) -> Real:
    """z on the closed hemisphere, 0 below it. The derivative at z = 0 is that from above, 1; `maximum` says 1/2."""
    return jnp.where(z < 0, 0, z)  # NaN stays NaN


def to_disk(w: Float[Array, "*batch 3"]) -> Float[Array, "*batch 2"]:
    """Equal-area chart of the hemisphere onto the unit disk, (x, y) / sqrt(1 + z): the disk that `Zernike` lives on."""
    return w[..., :2] / jnp.sqrt(1 + upper(w[..., 2:]))


def to_sphere(w: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Equal-area chart (up to the factor 2) of the hemisphere onto the sphere, the one that `HSH` stretches along."""
    z = upper(w[..., 2:])
    above = z > 0
    root = jnp.where(above, jnp.sqrt(jnp.where(above, 4 * z / (1 + z), 1)), 0)
    return jnp.concatenate([root * w[..., :2], 2 * z - 1], axis=-1)


def frame(normal: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """A rotation R with R @ normal = (0, 0, 1): rows are tangent, bitangent, normal.

    Finite with finite derivatives for every normal; the tangent jumps where the normal crosses the plane z = 0, which
    an isotropic BRDF does not notice. Source: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6(1), 2017.
    """
    x, y, z = normal[..., 0], normal[..., 1], normal[..., 2]
    sign = jnp.where(z >= 0, 1, -1).astype(normal.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    tangent = jnp.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    bitangent = jnp.stack([b, sign + y * y * a, -y], axis=-1)
    return jnp.stack([tangent, bitangent, normal], axis=-2)


def to_local(frame: Float[Array, "... 3 3"], w: Float[Array, "... 3"]) -> Float[Array, "*batch 3"]:
    """`frame` @ w; matrices and vectors broadcast. Written out as `dot` is: small products cost 20 times as much."""
    return frame[..., 0] * w[..., :1] + frame[..., 1] * w[..., 1:2] + frame[..., 2] * w[..., 2:]


def to_world(frame: Float[Array, "... 3 3"], w: Float[Array, "... 3"]) -> Float[Array, "*batch 3"]:
    """`frame`ᵀ @ w, the way back."""
    return frame[..., 0, :] * w[..., :1] + frame[..., 1, :] * w[..., 1:2] + frame[..., 2, :] * w[..., 2:]


def azimuth(w: Float[Array, "*batch 3"]) -> tuple[Float[Array, " *batch"], Float[Array, " *batch"]]:
    """(cos φ, sin φ); at the poles φ = 0."""
    rim = jnp.hypot(w[..., 0], w[..., 1])
    tilted = rim > 0
    safe = jnp.where(tilted, rim, 1)
    return jnp.where(tilted, w[..., 0] / safe, 1), jnp.where(tilted, w[..., 1] / safe, 0)


def meridian_frame(normal: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """A rotation as of `frame`, whose tangent points along the meridian, away from +z. No derivative at the poles."""
    (cos, sin), z, rim = azimuth(normal), normal[..., 2], jnp.hypot(normal[..., 0], normal[..., 1])
    tangent = jnp.stack([z * cos, z * sin, -rim], axis=-1)
    bitangent = jnp.stack([-sin, cos, jnp.zeros_like(z)], axis=-1)
    return jnp.stack([tangent, bitangent, normal], axis=-2)
