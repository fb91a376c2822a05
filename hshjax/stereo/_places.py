"""Where the pixels of a camera see a surface: on a plane to begin with, then where its normals say.

Normals tell no mean depth. It is that of the plane through what the camera sees in the middle of the image, at right
angles to its view: through `target` or `centre`.
"""

import numpy as np

from hshjax._typing import Bool, Float
from hshjax.camera import OrthographicCamera, PerspectiveCamera
from hshjax.photographs import placed
from hshjax.stereo._axes import camera_axes
from hshjax.stereo._height import depth_from_normals, height_from_normals


def spacing(camera: OrthographicCamera | PerspectiveCamera) -> float:
    """Between neighbouring pixels on the plane, in the unit of the scene."""
    if isinstance(camera, PerspectiveCamera):
        height = 2 * np.tan(float(camera.field_of_view) / 2) * _distance(camera)
    else:
        height = float(camera.height)
    return height / camera.resolution[0]


def on_plane(
    camera: OrthographicCamera | PerspectiveCamera, mask: Bool[np.ndarray, "rows columns"]
) -> Float[np.ndarray, "pixels 3"]:
    """Positions of the pixels of a mask on the plane."""
    return _at(camera, mask, np.full(mask.sum(), _distance(camera) if isinstance(camera, PerspectiveCamera) else 0.0))


def on_surface(
    camera: OrthographicCamera | PerspectiveCamera,
    mask: Bool[np.ndarray, "rows columns"],
    normals: Float[np.ndarray, "pixels 3"],
) -> Float[np.ndarray, "pixels 3"]:
    """Positions on the surface of these normals, in the world. Each connected piece has the plane's mean depth.

    Where normals tell no depth, at the horizon, it is that of the nearest pixel where they do.

    **Raises:** ValueError where no normal tells any; RuntimeError where depths do not converge.
    """
    image = placed(normals, mask)
    if isinstance(camera, PerspectiveCamera):
        depth = depth_from_normals(image, camera, mask, distance=_distance(camera))
    else:
        depth = height_from_normals(image, mask, camera=camera, spacing=spacing(camera))
    return _at(camera, mask, _filled(depth)[mask])


def _distance(camera: PerspectiveCamera) -> float:
    """Of the plane from the eye."""
    return float(np.linalg.norm(np.asarray(camera.eye, float) - np.asarray(camera.target, float)))


def _at(camera, mask, depth: Float[np.ndarray, " pixels"]) -> Float[np.ndarray, "pixels 3"]:
    """Depths from the eye of a pinhole along its axis, or heights above the plane."""
    origin, ray = (np.asarray(array, float)[mask] for array in camera.rays())
    towards = camera_axes(camera)[2]
    if isinstance(camera, PerspectiveCamera):
        return origin + depth[:, None] * ray / -(ray @ towards)[:, None]
    return origin + depth[:, None] * towards


def _filled(image: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
    """NaN replaced by what is nearest."""
    from scipy import ndimage

    index = ndimage.distance_transform_edt(np.isnan(image), return_distances=False, return_indices=True)
    return image[tuple(np.asarray(index))]
