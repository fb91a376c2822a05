"""Cameras: which rays belong to which pixels, and where the eye is."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from hshjax.camera import OrthographicCamera, PerspectiveCamera
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close


def vector(*values):
    return jnp.asarray(values, DTYPE)


def cameras(rows=4, columns=6):
    """One of each kind, looking somewhere."""
    return {
        "orthographic": OrthographicCamera(
            vector(0.4, -1.0, 2.0),
            vector(0.1, 1.0, 0.3),
            centre=vector(1, 2, 3),
            height=1.5,
            resolution=(rows, columns),
        ),
        "perspective": PerspectiveCamera(
            vector(0.4, -1.0, 2.0),
            vector(1, 2, -3),
            vector(0.1, 1.0, 0.3),
            field_of_view=0.7,
            resolution=(rows, columns),
        ),
    }


KINDS = tuple(cameras())


def cross(a, b):
    return np.cross(np.asarray(a), np.asarray(b))


def test_pixels_of_an_orthographic_camera():
    camera = OrthographicCamera(vector(0, 0, 5), vector(0, 1, 0), resolution=(2, 4))
    origin, direction = camera.rays()
    assert_close(origin[..., 0], np.tile([-1.5, -0.5, 0.5, 1.5], (2, 1)))
    assert_close(origin[..., 1], np.repeat([[0.5], [-0.5]], 4, axis=1))
    assert_close(origin[..., 2], np.zeros((2, 4)))
    assert_close(direction, np.broadcast_to([0, 0, -1], (2, 4, 3)))


def test_pixels_of_a_perspective_camera():
    """The middle one looks at the target; the edge of the image is half a pixel beyond the centres of its rows."""
    camera = PerspectiveCamera(
        vector(0, 0, 3), vector(0, 0, 1), vector(0, 7, 7), field_of_view=np.pi / 2, resolution=(3, 5)
    )
    origin, direction = camera.rays()
    assert_close(origin, np.broadcast_to([0, 0, 3], (3, 5, 3)))
    assert_close(direction[1, 2], [0, 0, -1])
    slopes = np.asarray(direction[..., :2] / -direction[..., 2:])
    assert_close(slopes[0, 2], [0, 2 / 3])
    assert_close(slopes[1, 4], [4 / 3, 0])


@pytest.mark.parametrize("kind", KINDS)
def test_rows_run_down_and_columns_to_the_right(kind):
    camera = cameras()[kind]
    origin, direction = (np.asarray(array) for array in camera.rays())
    at = origin + direction
    right, up = at[0, 1] - at[0, 0], at[0, 0] - at[1, 0]
    assert up @ np.asarray(camera.up) > 0
    assert cross(right, up) @ direction[0, 0] < 0
    assert_close(np.linalg.norm(direction, axis=-1), np.ones((4, 6)))


@pytest.mark.parametrize("kind", KINDS)
def test_points_are_seen_from_where_their_rays_come(kind):
    camera = cameras()[kind]
    origin, direction = camera.rays()
    assert_close(camera.view(origin + 2.5 * direction), -direction)
    assert camera.view(jnp.ones((0, 3), DTYPE)).shape == (0, 3)


def test_the_view_of_an_orthographic_camera_needs_no_points():
    camera = cameras()["orthographic"]
    assert not camera.needs_positions
    assert_close(camera.view(None), -camera.rays()[1][0, 0])


def test_lengths_of_directions_do_not_count():
    camera = cameras()["orthographic"]
    longer = eqx.tree_at(lambda c: (c.towards, c.up), camera, replace_fn=lambda v: 3 * v)
    for ray, expected in zip(longer.rays(), camera.rays(), strict=True):
        assert_close(ray, expected)


def test_from_far_away_perspective_is_orthographic():
    distance, centre, towards = 1e5 if X64 else 1e3, vector(1, 2, 3), vector(2, 3, 6) / 7
    up = vector(0, 1, 0)
    flat = OrthographicCamera(towards, up, centre=centre, height=2.0, resolution=(5, 4))
    eye = centre + distance * towards
    far = PerspectiveCamera(eye, centre, up, field_of_view=2 * np.arctan(1 / distance), resolution=(5, 4))
    origin, direction = far.rays()
    assert far.needs_positions
    at = origin - distance * direction / jnp.sum(direction * towards[None, None], -1, keepdims=True)
    assert_close(at, flat.rays()[0], tolerance=1e-9 if X64 else 1e-3)


def test_numbers_of_any_kind_are_differentiable():
    camera = OrthographicCamera((0, 0, 1), [0, 1, 0], height=2, resolution=np.asarray([3, 4]))
    assert all(eqx.is_inexact_array(leaf) for leaf in jax.tree.leaves(camera))
    assert camera.resolution == (3, 4)
    half = OrthographicCamera(jnp.asarray([0, 0, 1], jnp.float16), [0, 1, 0], resolution=(3, 4))
    assert half.rays()[0].dtype == jnp.float16
    assert half.view(jnp.ones((2, 3), DTYPE)).dtype == DTYPE


@pytest.mark.skipif(not X64, reason="differences in float64")
@pytest.mark.parametrize("kind", KINDS)
def test_gradients_against_differences(kind):
    arrays, static = eqx.partition(cameras(2, 3)[kind], eqx.is_inexact_array)

    def look(arrays):
        camera = eqx.combine(jax.tree.map(jnp.asarray, arrays), static)  # differences are taken in numpy
        origin, direction = camera.rays()
        return origin, direction, camera.view(origin + 2 * direction)

    check_grads(jax.jit(look), (arrays,), order=1, modes=("fwd", "rev"), rtol=1e-6, atol=1e-6)


def test_many_cameras_are_one_vmapped_one():
    eyes = jnp.asarray([[0, 0, 3.0], [1, 2, 3]], DTYPE)

    def make(eye):
        return PerspectiveCamera(eye, jnp.zeros(3, DTYPE), vector(0, 1, 0), field_of_view=0.5, resolution=(2, 3))

    many = jax.jit(jax.vmap(lambda eye: make(eye).rays()[1]))(eyes)
    assert_close(many, jnp.stack([make(eye).rays()[1] for eye in eyes]), tolerance=TOLERANCE)


REFUSED = {
    "an up along the view": (
        lambda: OrthographicCamera([1.0, 2, 3], [2.0, 4, 6], resolution=(2, 2)),
        "up must not lie along the direction of view",
    ),
    "no direction": (lambda: OrthographicCamera(jnp.zeros(3), [0, 1, 0], resolution=(2, 2)), "must not lie along"),
    "no pixels": (
        lambda: OrthographicCamera([0, 0, 1], [0, 1, 0], resolution=(0, 2)),
        r"\(rows, columns\), got \(0, 2\)",
    ),
    "half a pixel": (lambda: OrthographicCamera([0, 0, 1], [0, 1, 0], resolution=(1.5, 2)), r"got \(1.5, 2\)"),
    "one size": (lambda: OrthographicCamera([0, 0, 1], [0, 1, 0], resolution=4), "got 4"),
    "a height upside down": (
        lambda: OrthographicCamera([0, 0, 1], [0, 1, 0], height=-2.0, resolution=(2, 2)),
        r"height in \(0, inf\), got -2.0",
    ),
    "degrees": (
        lambda: PerspectiveCamera([0, 0, 3], [0, 0, 0], [0, 1, 0], field_of_view=40.0, resolution=(2, 2)),
        r"field_of_view in \(0, 3.1416\) \[radians\], got 40.0",
    ),
    "two heights": (
        lambda: OrthographicCamera([0, 0, 1], [0, 1, 0], height=[1.0, 2.0], resolution=(2, 2)),
        r"height of shape \(\), got \(2,\)",
    ),
    "a direction in two dimensions": (
        lambda: OrthographicCamera([0, 1], [0, 1, 0], resolution=(2, 2)),
        r"towards of shape \(3,\), got \(2,\)",
    ),
    "an eye in the target": (
        lambda: PerspectiveCamera([1, 2, 3], [1, 2, 3], [0, 1, 0], field_of_view=1.0, resolution=(2, 2)),
        "eye and target must differ",
    ),
    "an up along the line of sight": (
        lambda: PerspectiveCamera([0, 5, 0], [0, 0, 0], [0, 1, 0], field_of_view=1.0, resolution=(2, 2)),
        "up must not lie along",
    ),
    "a view of nothing": (lambda: cameras()["perspective"].view(None), "give their positions"),
    "a view of two dimensions": (lambda: cameras()["perspective"].view(jnp.ones((4, 2))), r"got \(4, 2\)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case, unchecked):
    make, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        make()
