"""A sphere, in closed form."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax.core import Tracer

from hshjax._fields import floating
from hshjax._typing import Array, Float
from hshjax.camera import AbstractCamera
from hshjax.geometry import dot
from hshjax.surface._surface import Surface


def sphere(camera: AbstractCamera, centre: Any = (0.0, 0.0, 0.0), radius: Any = 1.0) -> Surface:
    """A sphere as a camera sees it, exactly; from within, its inner side.

    `centre` `(3,)` and `radius` are differentiable, as the camera is. Towards the silhouette derivatives grow without
    bound, as the slope of the sphere does; no pixel's is infinite. The position of a pixel beside the sphere is the
    point of its ray's line nearest to the centre.

    **Raises:** ValueError for other shapes, and for a radius that is not positive.
    """
    centre, radius = floating(centre), floating(radius)
    if centre.shape != (3,) or radius.shape != ():
        raise ValueError(f"a sphere has a centre (3,) and a radius (), got {centre.shape} and {radius.shape}")
    if not isinstance(radius, Tracer) and not radius > 0:
        raise ValueError(f"radius must be positive, got {radius}")
    return _sphere(camera, centre, radius)


@eqx.filter_jit
def _sphere(camera: AbstractCamera, centre: Float[Array, " 3"], radius: Float[Array, ""]) -> Surface:
    origin, direction = camera.rays()
    centre, radius = centre.astype(origin.dtype), radius.astype(origin.dtype)
    away = origin - centre[None, None]
    along = dot(away, direction)[..., None]
    foot = away - along * direction  # from the centre to the line; differences of squares would lose half the digits
    square = radius**2 - dot(foot, foot)[..., None]
    meets = square > 0
    root = jnp.where(meets, jnp.sqrt(jnp.where(meets, square, 1)), 0)
    outside = jnp.broadcast_to(not camera.needs_positions, along.shape) | (along + root < 0)
    # Seen from the first of both points if that lies before the eye, from within from the second.
    seen = meets & (outside | (along - root < 0))
    side = jnp.where(outside, 1, -1).astype(origin.dtype)
    spoke = foot - side * root * direction
    return Surface(jnp.where(seen, side * spoke / radius, 0), centre[None, None] + spoke)
