"""Lights or a camera nearby: from where light comes, how much, and from where a pixel is seen depends on its place."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float
from hshjax.bases._base import matmul
from hshjax.brdfs import AbstractBRDF
from hshjax.camera import OrthographicCamera, PerspectiveCamera
from hshjax.geometry import frame
from hshjax.lighting import Points
from hshjax.stereo._axes import camera_axes
from hshjax.stereo._chart import from_chart, to_chart
from hshjax.stereo._geometry import AbstractGeometry
from hshjax.stereo._near_shading import angle_shares, near_tables
from hshjax.stereo._places import on_plane, on_surface, spacing
from hshjax.stereo._shading import AbstractShadingTables
from hshjax.stereo._strength import Lights

SOME = 2000
"""Pixels that stand for all where angles of lights are counted."""


class Near(AbstractGeometry):
    """Pixels of a mask at their places: on a plane, or at `positions`.

    **Raises:** ValueError for a light without a finite position, or within the surface: nearer to a pixel than its
    neighbours are.
    """

    starts, again = 3, 1

    def __init__(
        self, lights: Lights, camera: OrthographicCamera | PerspectiveCamera, mask: Bool[np.ndarray, "rows columns"],
        positions: Float[np.ndarray, "pixels 3"] | None = None,
    ):  # fmt: skip
        self._lights, self._camera, self._mask = lights, camera, mask
        self._positions = on_plane(camera, mask) if positions is None else positions
        world = camera_axes(camera)
        # A pixel's view is that of its ray, wherever on it the surface is: frames stay as they are.
        view = -np.asarray(camera.rays()[1], float)[mask] @ world.T
        self._frames = np.asarray(matmul(frame(jnp.asarray(view, jnp.float32)), jnp.asarray(world, jnp.float32)))
        self._check_apart()

    @property
    def positions(self):
        return self._positions

    def towards(self, part):
        return _incident(self._lights, *self._places(part))[0]

    def irradiance(self, part):
        return np.asarray(_incident(self._lights, *self._places(part))[1])

    def tables(self, brdfs: Sequence[AbstractBRDF]) -> AbstractShadingTables:
        step = -(-len(self._positions) // SOME)
        return near_tables(brdfs, angle_shares(self.towards(slice(None, None, step))))

    def world(self, local, part):
        return np.einsum("nji,nj->ni", self._frames[part], local)

    def local(self, world, part):
        return np.einsum("nij,nj->ni", self._frames[part], world)

    def carried(self, pq, number, part):
        if not self._camera.needs_positions:
            return pq[number]  # one frame for all
        world = np.einsum("nkji,nkj->nki", self._frames[number], np.asarray(from_chart(jnp.asarray(pq[number]))))
        return np.asarray(to_chart(jnp.asarray(np.einsum("nij,nkj->nki", self._frames[part], world))))

    def moved(self, normals):
        return Near(self._lights, self._camera, self._mask, on_surface(self._camera, self._mask, normals))

    def _places(self, part) -> tuple[Array, Array]:
        return jnp.asarray(self._positions[part], jnp.float32), jnp.asarray(self._frames[part])

    def _check_apart(self) -> None:
        places = getattr(self._lights, "position", None)
        if places is None:
            return
        unknown = np.flatnonzero(~np.all(np.isfinite(places), axis=1))
        if len(unknown):
            raise ValueError(f"lights {(unknown + 1).tolist()} have no finite position")
        from scipy.spatial import KDTree

        distance, _ = KDTree(self._positions).query(np.asarray(places, float))
        inside = np.flatnonzero(distance <= spacing(self._camera))
        if len(inside):
            raise ValueError(
                f"lights {(inside + 1).tolist()} lie within the surface, nearer to a pixel than its neighbours are: "
                "give positions of lights and camera in one unit and one world"
            )


@eqx.filter_jit
def _incident(
    lights: Any, positions: Float[Array, "n 3"], frames: Float[Array, "n 3 3"]
) -> tuple[Float[Array, "n lights 3"], Float[Array, "n lights channels"]]:
    """Directions in the frames of pixels, and irradiance, as the lights themselves have them."""
    count = len(positions)
    points = Points(frames, positions, jnp.arange(count), (count,))

    def of(light):
        incident = light.incident(points)
        towards = jnp.broadcast_to(incident.direction[:, 0], (count, 3))
        irradiance = incident.irradiance[:, 0]
        return matmul(frames, towards[..., None])[..., 0], jnp.broadcast_to(irradiance, (count, irradiance.shape[1]))

    towards, irradiance = jax.vmap(of)(lights)
    return jnp.moveaxis(towards, 0, 1), jnp.moveaxis(irradiance, 0, 1)
