"""The axes of a camera, on the host in float64 whatever jax's default is."""

import numpy as np

from hshjax._typing import Float
from hshjax.camera import AbstractCamera, OrthographicCamera, PerspectiveCamera


def camera_axes(camera: AbstractCamera | None) -> Float[np.ndarray, "3 3"]:
    """Right, up and towards the camera, as unit rows, in the world; None: of one far away on +z.

    **Raises:** ValueError for another kind of camera.
    """
    if camera is None:
        return np.eye(3)
    if isinstance(camera, PerspectiveCamera):
        towards = np.asarray(camera.eye, float) - np.asarray(camera.target, float)
    elif isinstance(camera, OrthographicCamera):
        towards = np.asarray(camera.towards, float)
    else:
        raise ValueError(f"the camera must be orthographic or perspective, got {type(camera).__name__}")
    back = towards / np.linalg.norm(towards)
    right = np.cross(np.asarray(camera.up, float), back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


def far_axes(camera: AbstractCamera | None) -> Float[np.ndarray, "3 3"]:
    """As `camera_axes`, of a camera far away.

    **Raises:** ValueError for one that is not.
    """
    if camera is not None and camera.needs_positions:
        raise ValueError("the camera must be far away, got one that sees points from different directions")
    return camera_axes(camera)
