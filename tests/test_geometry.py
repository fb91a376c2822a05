"""Directions, charts and frames."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.geometry import (
    angles,
    direction,
    dot,
    frame,
    half_vector,
    normalized,
    to_disk,
    to_local,
    to_sphere,
    to_world,
    upper,
)
from tests.helpers import DTYPE, X64, assert_close, directions


def array(values):
    return jnp.asarray(values, DTYPE)


def test_direction_of_named_angles():
    assert_close(direction(array(0.0), array(1.0)), [0, 0, 1])
    assert_close(direction(array(np.pi / 2), array(np.pi / 2)), [0, 1, 0])
    assert_close(direction(array(np.pi / 3), array(0.0)), [np.sqrt(0.75), 0, 0.5])
    assert direction(jnp.zeros((4, 1), DTYPE), jnp.zeros((1, 3), DTYPE)).shape == (4, 3, 3)


def test_angles_invert_directions():
    w = directions(0, 50)
    theta, phi = angles(w)
    assert_close(direction(theta, phi), w)
    assert bool(jnp.all((phi > -np.pi) & (phi <= np.pi)))


def test_angles_near_the_pole_keep_their_digits():
    """arccos(z) would round everything below sqrt(eps) to zero."""
    theta = array([1e-3, 1e-6, 1e-9])
    found = angles(direction(theta, jnp.full(3, 0.5, DTYPE)))
    assert_close(found[0] / theta, np.ones(3))
    assert_close(found[1], np.full(3, 0.5))


def test_normalized_and_half_vector():
    v = array([[3, 0, 4], [0, 0, 0]])
    assert_close(normalized(v), [[0.6, 0, 0.8], [0, 0, 0]])
    gradient = jax.vmap(jax.jacrev(normalized))(v)
    assert_close(gradient[1], np.zeros((3, 3)))
    assert_close(gradient[0], (np.eye(3) - np.outer([0.6, 0, 0.8], [0.6, 0, 0.8])) / 5)
    wi, wo = directions(1, 9), directions(2, 9)
    h = half_vector(wi, wo)
    assert_close(dot(h, h), np.ones(9))
    assert_close(dot(h, wi), dot(h, wo))
    assert_close(half_vector(wi, -wi), np.zeros((9, 3)))


def test_upper_takes_its_derivative_from_above():
    z = array([-0.5, 0.0, 0.5])
    assert_close(upper(z), [0, 0, 0.5])
    assert_close(jax.vmap(jax.grad(upper))(z), [0, 1, 1])


@pytest.mark.parametrize(("chart", "factor"), [(to_disk, 0.5), (to_sphere, 2.0)])
def test_charts_keep_area(chart, factor):
    """The Jacobian on the tangent plane has the same area everywhere: 2π becomes π (the disk), 4π (the sphere)."""
    w = directions(3, 20, min_z=0.01)
    tangents = frame(w)[:, :2].swapaxes(1, 2)
    jacobian = jax.vmap(jax.jacfwd(chart))(w) @ tangents
    area = jnp.sqrt(jnp.linalg.det(jacobian.swapaxes(1, 2) @ jacobian))
    assert_close(area, np.full(20, factor), tolerance=None if X64 else 1e-4)  # float32: entries of 1/sqrt(z), squared


def test_charts_map_to_the_disk_and_to_the_sphere():
    w = jnp.concatenate([directions(4, 20), array([[0, 0, 1], [1, 0, 0]])])
    assert_close(jnp.sum(to_disk(w) ** 2, -1), 1 - w[:, 2])
    assert_close(jnp.sum(to_sphere(w) ** 2, -1), np.ones(22))
    assert_close(to_sphere(w)[-2:], [[0, 0, 1], [0, 0, -1]])
    below = array([[0.6, -0.64, -0.48]])
    assert_close(to_disk(below), [[0.6, -0.64]])
    assert_close(to_sphere(below), [[0, 0, -1]])
    assert bool(jnp.all(jnp.isfinite(jax.vmap(jax.jacfwd(to_sphere))(w))))


def test_frame_is_a_rotation_that_takes_the_normal_to_z():
    normals = jnp.concatenate([directions(5, 20), -directions(6, 20), array([[0, 0, 1], [0, 0, -1], [1, 0, 0]])])
    rotation = frame(normals)
    assert_close(rotation @ rotation.swapaxes(1, 2), np.broadcast_to(np.eye(3), rotation.shape))
    assert_close(jnp.linalg.det(rotation), np.ones(len(normals)))
    assert_close(jnp.einsum("nij,nj->ni", rotation, normals), np.broadcast_to([0, 0, 1], normals.shape))
    assert_close(frame(array([0, 0, 1])), np.eye(3))
    assert bool(jnp.all(jnp.isfinite(jax.vmap(jax.jacfwd(frame))(normals))))


def test_dot_takes_all_components_there_are():
    """An array that indexes past its end would be clamped, not told."""
    a, b = np.random.default_rng(0).normal(size=(2, 5, 4))
    for length in (2, 3, 4):
        assert_close(
            dot(jnp.asarray(a[:, :length]), jnp.asarray(b[:, :length])),
            np.sum(a * b, axis=-1, where=np.arange(4) < length),
        )


def test_to_local_is_a_product_and_to_world_the_way_back():
    turn, w = frame(directions(0, 6)), directions(1, 6)
    assert_close(to_local(turn, w), np.einsum("nij,nj->ni", turn, w))
    assert_close(to_world(turn, to_local(turn, w)), w)
    many = to_local(turn[:, None], jnp.stack([w, w], axis=1))
    assert_close(many, np.einsum("nij,nej->nei", turn, np.stack([w, w], axis=1)))
