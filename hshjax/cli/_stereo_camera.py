"""The camera that options of `hshjax stereo` tell of."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from hshjax.camera import OrthographicCamera, PerspectiveCamera
from hshjax.cli._console import Misuse
from hshjax.lighting import PointLight
from hshjax.photographs import Photographs


def with_camera(photographs: Photographs, height: float | None, field_of_view: float | None) -> Photographs:
    """Photographs by a camera on +z that looks at the origin, at the mean depth of the object.

    - `height`: of the image there, in the unit of the scene. - `field_of_view`: vertical [degrees]; None: far away.

    **Raises:** Misuse for values out of range, lights nearby without a height, and a height that nothing asks for.
    """
    if height is not None and not (np.isfinite(height) and height > 0):
        raise Misuse(f"--image-height must be a finite number above 0, got {height}")
    if field_of_view is not None and not 0 < field_of_view < 180:
        raise Misuse(f"--field-of-view must be above 0 and below 180 degrees, got {field_of_view}")
    near = isinstance(photographs.lights, PointLight)
    if near and height is None:
        raise Misuse("lights nearby want --image-height, in the unit of their positions, to know where pixels are")
    if not near and field_of_view is None:
        if height is not None:
            raise Misuse("--image-height means nothing where lights and camera are far away")
        return photographs
    resolution = photographs.mask.shape
    height = float(resolution[0]) if height is None else height
    if field_of_view is None:
        towards, up = jnp.asarray([0.0, 0.0, 1.0]), jnp.asarray([0.0, 1.0, 0.0])
        camera = OrthographicCamera(towards, up, height=jnp.asarray(height), resolution=resolution)
    else:
        angle = np.radians(field_of_view)
        eye, up = jnp.asarray([0.0, 0.0, height / (2 * np.tan(angle / 2))]), jnp.asarray([0.0, 1.0, 0.0])
        camera = PerspectiveCamera(eye, jnp.zeros(3), up, field_of_view=jnp.asarray(angle), resolution=resolution)
    return dataclasses.replace(photographs, camera=camera)
