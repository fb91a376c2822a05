"""Cameras: where the rays of an image's pixels come from, and from where points are seen.

Rows of an image run down and columns to the right, as the eye sees it, whose `up` is up. Pixels are square.
"""

import abc
import operator
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hshjax._fields import bounded, floating
from hshjax._typing import Array, Float
from hshjax.brdfs._base import in_dtype
from hshjax.geometry import common_dtype, normalized


def _resolution(value: Any) -> tuple[int, int]:
    try:
        rows, columns = (operator.index(size) for size in value)
    except (TypeError, ValueError):
        rows = columns = 0
    if min(rows, columns) < 1:
        raise ValueError(f"resolution must be two positive integers (rows, columns), got {value!r}")
    return rows, columns


class AbstractCamera(eqx.Module):
    """Makes a ray for each pixel of an image; says from points of the world where the eye is.

    Every leaf is differentiable. Lengths are in the unit of the scene. A camera computes in the dtype of its first
    field, in that of the points where it is given some.
    """

    resolution: eqx.AbstractVar[tuple[int, int]]

    @property
    @abc.abstractmethod
    def needs_positions(self) -> bool:
        """Whether the view depends on where a point is. If not, the eye is infinitely far away: rays are whole lines,
        and what lies behind their origins is seen as well."""

    @abc.abstractmethod
    def rays(self) -> tuple[Float[Array, "rows columns 3"], Float[Array, "rows columns 3"]]:
        """Origin and unit direction, away from the eye, of the rays through the centres of the pixels."""

    @abc.abstractmethod
    def view(self, positions: Float[Array, "*batch 3"] | None) -> Float[Array, "*batch 3"]:
        """Unit directions from points `(*batch, 3)` TOWARDS the eye, in the world."""


class OrthographicCamera(AbstractCamera):
    """Parallel rays.

    - `towards` `(3,)`: from the scene TOWARDS the eye, of any length. - `up` `(3,)`: up in the image, of any length and
      not necessarily at a right angle.
    - `centre` `(3,)`: what is seen in the middle of the image; rays start in the plane through it.
    - `height`: vertical extent of the image, in the world. - `resolution`: (rows, columns).

    `view(None)` is the one direction towards the eye, `(3,)`.

    **Raises:** ValueError for other shapes, a height that is not positive, and an `up` along `towards`.
    """

    towards: Float[Array, " 3"] = eqx.field(converter=floating)
    up: Float[Array, " 3"] = eqx.field(converter=floating)
    centre: Float[Array, " 3"] = eqx.field(converter=floating, default=(0.0, 0.0, 0.0), kw_only=True)
    height: Float[Array, ""] = bounded(0.0, float("inf"), default=2.0, kw_only=True)
    resolution: tuple[int, int] = eqx.field(static=True, converter=_resolution, kw_only=True)

    def __check_init__(self):
        _check_shapes(self, ("towards", "up", "centre"), "height")
        _check_range(self, "height", float("inf"))
        _check_up(self.up, self.towards)

    @property
    def needs_positions(self) -> bool:
        return False

    @eqx.filter_jit
    def rays(self) -> tuple[Float[Array, "rows columns 3"], Float[Array, "rows columns 3"]]:
        camera = in_dtype(self, self.towards.dtype)
        axes = _axes(camera.towards, camera.up)
        origin = camera.centre[None, None] + camera.height * _image_plane(camera, axes)
        return origin, jnp.broadcast_to(-axes[2], origin.shape)

    def view(self, positions: Float[Array, "*batch 3"] | None) -> Float[Array, "*batch 3"]:
        if positions is None:
            return normalized(self.towards)
        positions = _points(positions)
        return jnp.broadcast_to(normalized(self.towards.astype(positions.dtype)), positions.shape)


class PerspectiveCamera(AbstractCamera):
    """Rays from one point: a pinhole.

    - `eye`, `target` `(3,)`: where it is, and what it sees in the middle of the image. - `up` `(3,)`: up in the image,
      of any length and not necessarily at a right angle.
    - `field_of_view`: vertical, from edge to edge of the image [radians]. - `resolution`: (rows, columns).

    **Raises:** ValueError for other shapes, a field of view outside (0, π), a target in the eye, and an `up` along the
    line between them.
    """

    eye: Float[Array, " 3"] = eqx.field(converter=floating)
    target: Float[Array, " 3"] = eqx.field(converter=floating)
    up: Float[Array, " 3"] = eqx.field(converter=floating)
    field_of_view: Float[Array, ""] = bounded(0.0, float(np.pi), kw_only=True)
    resolution: tuple[int, int] = eqx.field(static=True, converter=_resolution, kw_only=True)

    def __check_init__(self):
        _check_shapes(self, ("eye", "target", "up"), "field_of_view")
        _check_range(self, "field_of_view", float(np.pi), " [radians]")
        if isinstance(self.eye, Tracer) or isinstance(self.target, Tracer):
            return
        eye, target = np.asarray(self.eye), np.asarray(self.target)
        if np.array_equal(eye, target):
            raise ValueError(f"eye and target must differ, got {eye.tolist()} twice")
        _check_up(self.up, eye - target)

    @property
    def needs_positions(self) -> bool:
        return True

    @eqx.filter_jit
    def rays(self) -> tuple[Float[Array, "rows columns 3"], Float[Array, "rows columns 3"]]:
        camera = in_dtype(self, self.eye.dtype)
        axes = _axes(camera.eye - camera.target, camera.up)
        height = 2 * jnp.tan(camera.field_of_view / 2)  # of the image at distance 1
        direction = normalized(height * _image_plane(camera, axes) - axes[2][None, None])
        return jnp.broadcast_to(camera.eye, direction.shape), direction

    def view(self, positions: Float[Array, "*batch 3"] | None) -> Float[Array, "*batch 3"]:
        if positions is None:
            raise ValueError("a PerspectiveCamera sees each point from another direction: give their positions")
        positions = _points(positions)
        return normalized(jnp.broadcast_to(self.eye.astype(positions.dtype), positions.shape) - positions)


def _axes(towards: Float[Array, " 3"], up: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """Right, up and towards the eye, as unit rows."""
    back = normalized(towards)
    right = normalized(jnp.cross(up, back))
    return jnp.stack([right, jnp.cross(back, right), back])


def _image_plane(camera: AbstractCamera, axes: Float[Array, "3 3"]) -> Float[Array, "rows columns 3"]:
    """Centres of the pixels of an image of height 1 around the origin."""
    rows, columns = camera.resolution
    x = jnp.asarray((np.arange(columns) + 0.5 - columns / 2) / rows, axes.dtype)
    y = jnp.asarray((rows / 2 - 0.5 - np.arange(rows)) / rows, axes.dtype)
    return x[None, :, None] * axes[0][None, None] + y[:, None, None] * axes[1][None, None]


def _points(positions: Array) -> Array:
    if jnp.ndim(positions) < 1 or jnp.shape(positions)[-1] != 3:
        raise ValueError(f"positions must have shape (*batch, 3), got {jnp.shape(positions)}")
    return common_dtype(positions)[0]


def _check_shapes(camera: AbstractCamera, vectors: tuple[str, ...], scalar: str) -> None:
    for field, expected in {**dict.fromkeys(vectors, (3,)), scalar: ()}.items():
        shape = getattr(camera, field).shape
        if shape != expected:
            raise ValueError(f"{type(camera).__name__} needs {field} of shape {expected}, got {shape}")


def _check_range(camera: AbstractCamera, field: str, end: float, unit: str = "") -> None:
    """ValueError outside (0, end); values inside a compiled program cannot be seen."""
    value = getattr(camera, field)
    if not isinstance(value, Tracer) and not 0 < value < end:
        raise ValueError(f"{type(camera).__name__} needs {field} in (0, {end:.5g}){unit}, got {value}")


def _check_up(up: Any, towards: Any) -> None:
    """ValueError where the two span no plane, up to rounding; values inside a compiled program cannot be seen."""
    if isinstance(up, Tracer) or isinstance(towards, Tracer):
        return
    up, towards = np.asarray(up), np.asarray(towards)
    lengths = np.linalg.norm(up) * np.linalg.norm(towards)
    if not np.linalg.norm(np.cross(up, towards)) > 8 * np.finfo(up.dtype).eps * lengths:
        raise ValueError(f"up must not lie along the direction of view, got up {up} and direction {towards}")
