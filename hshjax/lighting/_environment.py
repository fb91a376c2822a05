"""Light from everywhere around, as an image of it."""

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._fields import floating
from hshjax._typing import Array, Float, Real
from hshjax.brdfs._base import in_dtype
from hshjax.geometry import as_directions
from hshjax.lighting._base import AbstractLighting, Incident, Points

Up = Literal["y", "z"]

UPS: tuple[Up, ...] = ("y", "z")


def _known(up: str) -> Up:
    if up not in UPS:
        raise ValueError(f"up must be one of {', '.join(UPS)}, got {up!r}")
    return up


class EnvironmentMap(AbstractLighting):
    """Distant light, in an equirectangular image of its radiance `(height, width, channels)` [W m^-2 sr^-1].

    Rows run from straight up to straight down in equal steps of the polar angle. Columns run once around, as seen from
    within, to the right: with `up="y"` (renderers) from -z over +x; with `up="z"` (the frame of this library) from +y
    over +x. `EnvironmentMap(hshjax.io.read_exr(path), up="y")` takes the maps that are sold for renderers.

    In the reflectance equation every pixel is an emitter in the direction of its centre, with the pixel's exact solid
    angle. Called with directions it gives the radiance that comes from there, bilinear between centres.

    **Raises:** ValueError for other shapes, or another axis.
    """

    radiance: Float[Array, "height width channels"] = eqx.field(converter=floating)
    up: Up = eqx.field(static=True, converter=_known, kw_only=True)

    def __check_init__(self):
        if self.radiance.ndim != 3 or 0 in self.radiance.shape:
            raise ValueError(f"radiance must have shape (height, width, channels), got {self.radiance.shape}")

    @property
    def emitters(self) -> int:
        return self.radiance.shape[0] * self.radiance.shape[1]

    @property
    def direction(self) -> np.ndarray:
        """Directions of the pixels' centres, `(height, width, 3)`. Host array, float64."""
        height, width, _ = self.radiance.shape
        theta = np.pi * (np.arange(height) + 0.5) / height
        turn = 2 * np.pi * (np.arange(width) + 0.5) / width
        return self.towards(theta[:, None], turn[None, :])

    def towards(self, theta: Any, turn: Any) -> Any:
        """Directions `(*batch, 3)` at polar angles and turns to the right from the left edge of the image [radians]."""
        xp = np if isinstance(theta, np.ndarray) else jnp
        right, ahead = xp.sin(theta) * xp.sin(turn), xp.sin(theta) * xp.cos(turn)
        above = xp.broadcast_to(xp.cos(theta), right.shape)
        return xp.stack([right, ahead, above] if self.up == "z" else [right, above, -ahead], axis=-1)

    def polar(self, w: Float[Array, "*batch 3"]) -> tuple[Float[Array, " *batch"], Float[Array, " *batch"]]:
        """Polar angles and turns in [0, 2π] of directions: the inverse of `towards`.

        Straight up and down the derivative, which does not exist, is 0.
        """
        right, ahead, above = (
            (w[..., 0], w[..., 1], w[..., 2]) if self.up == "z" else (w[..., 0], -w[..., 2], w[..., 1])
        )
        tilted = (right != 0) | (ahead != 0)
        right, ahead = jnp.where(tilted, right, 0), jnp.where(tilted, ahead, 1)
        rim = jnp.where(tilted, jnp.hypot(right, ahead), 0)
        return jnp.arctan2(rim, above), jnp.mod(jnp.arctan2(right, ahead), 2 * np.pi)

    @property
    def solid_angle(self) -> np.ndarray:
        """Solid angle of the pixels of a row [sr], `(height,)`; all together 4π. Host array, float64."""
        height, width, _ = self.radiance.shape
        edges = np.cos(np.pi * np.arange(height + 1) / height)
        return 2 * np.pi / width * (edges[:-1] - edges[1:])

    def incident(self, points: Points) -> Incident:
        radiance = in_dtype(self, points.frame.dtype).radiance
        direction = jnp.asarray(self.direction.reshape(1, -1, 3), radiance.dtype)
        power = radiance * jnp.asarray(self.solid_angle, radiance.dtype)[:, None, None]
        return Incident(direction, power.reshape(1, -1, radiance.shape[2]))

    def __call__(self, w: Float[Array, "*batch 3"]) -> Real:
        """The radiance from directions `(*batch, 3)`, `(*batch, channels)`."""
        (w,) = as_directions(w)
        height, width, _ = self.radiance.shape
        radiance = self.radiance.astype(w.dtype)
        theta, turn = self.polar(w)
        row = jnp.clip(theta / np.pi * height - 0.5, 0, height - 1)
        column = jnp.mod(turn / (2 * np.pi) * width - 0.5, width)
        top, left = jnp.floor(row), jnp.floor(column)
        down, over = (row - top)[..., None], (column - left)[..., None]
        i, j = top.astype(int), left.astype(int) % width

        def along(row):
            return (1 - over) * radiance[row, j] + over * radiance[row, (j + 1) % width]

        return (1 - down) * along(i) + down * along(jnp.minimum(i + 1, height - 1))
