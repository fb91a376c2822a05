"""Surfaces against closed forms, each other and differences."""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy import ndimage

from hshjax.brdfs import Lambert
from hshjax.camera import OrthographicCamera, PerspectiveCamera
from hshjax.lighting import PointLight
from hshjax.reflectance import reflect
from hshjax.surface import Surface, height_field, mesh, sphere
from tests.helpers import DTYPE, X64, assert_close


def vector(*values):
    return jnp.asarray(values, DTYPE)


def front(rows=32, columns=40, height=2.4, **kwargs):
    return OrthographicCamera(vector(0, 0, 1), vector(0, 1, 0), height=height, resolution=(rows, columns), **kwargs)


def aside(rows=32, columns=40):
    return PerspectiveCamera(
        vector(2, 1, 4), vector(0.1, 0, 0), vector(0, 1, 0.2), field_of_view=0.5, resolution=(rows, columns)
    )


CAMERAS = {"orthographic": front, "perspective": aside}


# --- spheres ----------------------------------------------------------------------------------------------------------


def test_a_unit_sphere_from_the_front():
    camera = front(height=2.0)
    surface = sphere(camera)
    x, y = np.asarray(camera.rays()[0])[..., :2].transpose(2, 0, 1)
    inside = x**2 + y**2 < 1
    expected = np.stack([x, y, np.sqrt(np.where(inside, 1 - x**2 - y**2, 0))], -1)
    assert np.array_equal(surface.mask, inside)
    assert_close(surface.normal, np.where(inside[..., None], expected, 0))
    assert_close(surface.position, expected)


@pytest.mark.parametrize("kind", CAMERAS)
def test_points_lie_on_the_sphere_and_on_their_rays(kind):
    camera, centre = CAMERAS[kind](), vector(0.2, -0.1, 0.3)
    surface = sphere(camera, centre, 0.8)
    position, normal = surface.position[surface.mask], surface.normal[surface.mask]
    assert 200 < len(position) < 1000
    assert_close(jnp.linalg.norm(normal, axis=-1), np.ones(len(normal)))
    assert_close(position, centre[None] + 0.8 * normal)
    assert jnp.all(jnp.sum(normal * camera.view(position), -1) >= 0)
    origin, direction = camera.rays()
    assert_close(jnp.cross(surface.position - origin, direction)[surface.mask], np.zeros((len(position), 3)))
    assert np.all(np.isfinite(surface.position))


def test_a_sphere_behind_the_origins_of_parallel_rays_is_seen():
    assert_close(sphere(front(), vector(0, 0, 9)).normal, sphere(front()).normal)


def test_a_sphere_behind_an_eye_is_not_seen():
    camera = PerspectiveCamera(vector(0, 0, 4), vector(0, 0, 5), vector(0, 1, 0), field_of_view=1.0, resolution=(8, 8))
    assert not jnp.any(sphere(camera).mask)


def test_within_a_sphere_its_inside_is_seen():
    camera = PerspectiveCamera(
        vector(0, 0, 0.5), vector(0, 0, 9), vector(0, 1, 0), field_of_view=2.0, resolution=(5, 5)
    )
    surface = sphere(camera)
    assert jnp.all(surface.mask)
    assert_close(surface.normal, -surface.position)
    assert_close(surface.position[2, 2], [0, 0, 1])


def test_no_derivative_is_nan_on_a_silhouette():
    """Four pixels of a sphere whose silhouette goes through two centres."""
    camera = front(2, 2, height=2.0)

    def total(camera, centre, radius):
        surface = sphere(camera, centre, radius)
        return jnp.sum(surface.normal) + jnp.sum(surface.position)

    gradient = jax.grad(total, argnums=(0, 1, 2))(camera, vector(0, 0.5, 0), jnp.asarray(0.5, DTYPE))
    assert not jnp.any(sphere(camera, vector(0, 0.5, 0), 0.5).mask)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))


@pytest.mark.skipif(not X64, reason="differences in float64")
def test_gradients_of_a_sphere_against_differences():
    arrays, static = eqx.partition(aside(3, 3), eqx.is_inexact_array)

    def look(arrays, centre, radius):
        surface = sphere(eqx.combine(jax.tree.map(jnp.asarray, arrays), static), jnp.asarray(centre), radius)
        return surface.normal, surface.position

    given = (arrays, vector(0.1, 0, 0.1), jnp.asarray(0.9))
    check_grads(jax.jit(look), given, order=1, modes=("fwd", "rev"), rtol=1e-6, atol=1e-6)


# --- heights ----------------------------------------------------------------------------------------------------------


def grid(rows, columns, spacing):
    x = spacing * (np.arange(columns) - (columns - 1) / 2)
    y = spacing * ((rows - 1) / 2 - np.arange(rows))
    return np.meshgrid(x, y)


def test_normals_of_a_paraboloid_are_exact():
    """Differences of second order are, up to the border."""
    x, y = grid(7, 9, 0.25)
    surface = height_field(jnp.asarray(0.3 * x**2 - 0.2 * y**2 + 0.5 * x * y + x - 2 * y, DTYPE), spacing=0.25)
    slopes = np.stack([-(0.6 * x + 0.5 * y + 1), -(-0.4 * y + 0.5 * x - 2), np.ones_like(x)], -1)
    assert_close(surface.normal, slopes / np.linalg.norm(slopes, axis=-1, keepdims=True))
    assert jnp.all(surface.mask)


def test_differences_are_of_second_order():
    def error(n):
        x, y = grid(n, n, 2 / n)
        z, slopes = np.sin(2 * x + y), np.stack([-2 * np.cos(2 * x + y), -np.cos(2 * x + y), np.ones_like(x)], -1)
        normal = height_field(jnp.asarray(z, DTYPE), spacing=2 / n).normal
        return np.abs(normal - slopes / np.linalg.norm(slopes, axis=-1, keepdims=True)).max()

    assert error(32) < error(16) / 3


def test_nodes_are_the_pixels_of_a_camera_above():
    heights = jnp.asarray(np.random.default_rng(0).normal(size=(4, 6)), DTYPE)
    surface = height_field(heights, spacing=0.5)
    origin, _ = front(4, 6, height=4 * 0.5).rays()
    assert_close(surface.position[..., :2], origin[..., :2])
    assert_close(surface.position[..., 2], heights)


def test_a_mask_takes_away_normals_only():
    heights = jnp.asarray(np.random.default_rng(0).normal(size=(4, 6)), DTYPE)
    mask = np.arange(24).reshape(4, 6) % 5 > 0
    whole, part = height_field(heights), height_field(heights, mask=mask)
    assert np.array_equal(part.mask, mask)
    assert_close(part.normal, np.where(mask[..., None], whole.normal, 0))
    assert_close(part.position, whole.position)


@pytest.mark.skipif(not X64, reason="differences in float64")
def test_gradients_of_heights_against_differences():
    heights = np.random.default_rng(0).normal(size=(4, 5))

    def look(heights, spacing):
        surface = height_field(jnp.asarray(heights), spacing=spacing, mask=np.eye(4, 5))
        return surface.normal, surface.position

    check_grads(jax.jit(look), (heights, 0.7), order=1, modes=("fwd", "rev"), rtol=1e-6, atol=1e-6)


# --- meshes -----------------------------------------------------------------------------------------------------------


def icosphere(splits):
    """A sphere of 20 · 4^splits triangles, vertices on it, wound outwards."""
    golden = (1 + np.sqrt(5)) / 2
    points = [[0, a, b * golden] for a in (-1, 1) for b in (-1, 1)]
    points = np.array([np.roll(p, k) for k in range(3) for p in points]) / np.hypot(1, golden)
    near = np.linalg.norm(points[:, None] - points[None], axis=-1) < 1.1
    faces = [(i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] & near[j, k] & near[i, k]]
    corners = points[np.array(faces)]
    for _ in range(splits):
        a, b, c = (corners[:, k] for k in range(3))
        ab, bc, ca = ((p + q) / np.linalg.norm(p + q, axis=-1, keepdims=True) for p, q in ((a, b), (b, c), (c, a)))
        corners = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    outwards = np.einsum(
        "ni,ni->n", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]
    )
    corners = np.where(outwards[:, None, None] > 0, corners, corners[:, ::-1])
    vertices, faces = np.unique(corners.reshape(-1, 3).round(12), axis=0, return_inverse=True)
    return jnp.asarray(vertices, DTYPE), faces.reshape(-1, 3)


@pytest.mark.parametrize("kind", CAMERAS)
@pytest.mark.parametrize("given", [True, False])
def test_an_icosphere_is_a_sphere(kind, given):
    """A triangle with edges of length l lies up to l² / 6 below its arc, and more along rays that meet it aslant."""
    vertices, faces = icosphere(4)
    camera = CAMERAS[kind]()
    found = mesh(camera, vertices, faces, normals=vertices if given else None)
    exact = sphere(camera)
    chord = float(
        np.max(np.linalg.norm(np.asarray(vertices)[faces] - np.roll(np.asarray(vertices)[faces], 1, 1), axis=-1))
    )
    assert np.sum(found.mask != exact.mask) <= 8
    assert not np.any(found.mask & ~exact.mask)
    steep = (jnp.sum(exact.normal * camera.view(exact.position), -1) > 0.3) & found.mask
    assert_close(found.position[steep], exact.position[steep], tolerance=chord**2 / 6 / 0.3)
    assert_close(found.normal[steep], exact.normal[steep], tolerance=2 * chord**2)
    assert_close(jnp.linalg.norm(found.normal, axis=-1), np.where(found.mask, 1, 0))
    assert_close(found.position[~found.mask], camera.rays()[0][~found.mask])


def test_both_sides_and_all_copies_of_a_vertex_are_one():
    vertices, faces = icosphere(2)
    camera = front()
    expected = mesh(camera, vertices, faces)
    apart = mesh(camera, vertices[faces.reshape(-1)], np.arange(faces.size).reshape(-1, 3))
    for other in (mesh(camera, vertices, faces[:, ::-1]), apart):
        assert_close(other.normal, expected.normal)
        assert_close(other.position, expected.position)


def test_faces_back_to_back_are_flat():
    vertices = vector([-1, -1, 0], [1, -1, 0], [0, 1, 0.5])
    surface = mesh(front(), vertices, [[0, 1, 2], [2, 1, 0]])
    assert_close(surface.normal[16, 20], np.array([0, -0.5, 2]) / np.hypot(0.5, 2))


def test_the_nearest_face_before_the_eye_is_seen():
    vertices, faces = icosphere(1)
    layers = jnp.concatenate([vertices, vertices + vector(0, 0, 5)[None], vertices - vector(0, 0, 5)[None]])
    faces = np.concatenate([faces, faces + len(vertices), faces + 2 * len(vertices)])
    eye = PerspectiveCamera(vector(0, 0, 2.5), vector(0, 0, 0), vector(0, 1, 0), field_of_view=0.1, resolution=(3, 3))
    assert_close(mesh(eye, layers, faces).position[1, 1, 2], 1, tolerance=0.1)
    assert_close(mesh(front(3, 3, height=0.3), layers, faces).position[1, 1, 2], 6, tolerance=0.1)


def test_a_mesh_far_from_the_origin():
    """1000 times its size; float32 holds its vertices to 1e-4 there."""
    vertices, faces = icosphere(2)
    far = vector(1000, -1000, 1000)
    near = mesh(front(), vertices, faces)
    found = mesh(front(centre=far), vertices + far[None], faces)
    same = near.mask & found.mask
    assert jnp.sum(near.mask != found.mask) <= 2
    error = np.abs(near.normal - found.normal)[same].max(axis=-1)
    assert np.quantile(error, 0.98) < (1e-9 if X64 else 2e-2)  # some pixels lie on edges


def test_meshes_pass_transforms():
    vertices, faces = icosphere(1)

    def depth(vertices):
        return mesh(front(6, 6), vertices, faces).position[..., 2]

    many = jnp.stack([vertices, 1.1 * vertices])
    expected = jnp.stack([depth(v) for v in many])
    assert_close(jax.jit(jax.vmap(depth))(many), expected)
    gradient = jax.jit(jax.grad(lambda v: jnp.sum(depth(v))))(vertices)
    assert_close(jnp.sum(gradient[:, 2]), jnp.sum(expected[0] != 0))  # every pixel moves along with the mesh


@pytest.mark.skipif(not X64, reason="differences in float64")
def test_gradients_of_a_mesh_against_differences():
    """Of an octahedron, whose edges do not pass under the four pixels."""
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    faces = [(x, y, z) for x in (0, 3) for y in (1, 4) for z in (2, 5)]
    faces = np.array([f if np.linalg.det(vertices[list(f)]) > 0 else f[::-1] for f in faces])
    arrays, static = eqx.partition(front(2, 2, height=1.0), eqx.is_inexact_array)

    def look(arrays, vertices):
        camera = eqx.combine(jax.tree.map(jnp.asarray, arrays), static)
        surface = mesh(camera, jnp.asarray(vertices), faces)
        return surface.normal, surface.position

    check_grads(jax.jit(look), (arrays, vertices), order=1, modes=("fwd", "rev"), rtol=1e-6, atol=1e-6)


def test_without_embreex(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex", None)
    with pytest.raises(ImportError, match=r'pip install "hshjax\[mesh\]"'):
        mesh(front(), *icosphere(0))


def test_a_face_is_complete_upright_and_seen_from_the_front(data):
    scan = np.load(data / "face" / "LeePerrySmith_decoded.npz")
    camera = front(256, 256, height=9.0)
    for normals in (scan["normals"], None):
        surface = mesh(camera, scan["points"], scan["faces"], normals=normals)
        mask = np.asarray(surface.mask)
        assert ndimage.label(mask)[1] == ndimage.label(~mask)[1] == 1
        assert mask[:100].sum() < mask[180:].sum(), "shoulders are below the head"
        nose = np.unravel_index(np.argmax(np.where(mask, surface.position[..., 2], -9)), mask.shape)
        assert 85 < nose[0] < 110
        assert 115 < nose[1] < 141
        assert np.mean(surface.normal[mask][:, 2] < 0) < 2e-3


# --- all --------------------------------------------------------------------------------------------------------------


def test_a_surface_is_lit():
    camera = aside()
    surface = sphere(camera)
    bulb = PointLight(vector(3, 3, 3), 10.0)
    view = camera.view(surface.position)
    image = reflect(Lambert(0.5), bulb, surface.normal, view, positions=surface.position)[..., 0]
    away = vector(3, 3, 3) - surface.position[16, 20]
    square = jnp.sum(away**2)
    assert_close(image[16, 20], 5 / np.pi * jnp.sum(away * surface.normal[16, 20]) / square**1.5)
    assert np.array_equal(image > 0, surface.mask & (jnp.sum(surface.normal, -1) * 3 > 1))


ONE = (jnp.eye(3), [[0, 1, 2]])

REFUSED = {
    "other positions": (lambda: Surface(jnp.ones((2, 3)), jnp.ones((3, 3))), r"got \(2, 3\) and \(3, 3\)"),
    "two radii": (lambda: sphere(front(), radius=jnp.ones(2)), r"a radius \(\), got \(3,\) and \(2,\)"),
    "no radius": (lambda: sphere(front(), radius=0), "radius must be positive, got 0.0"),
    "two rows": (lambda: height_field(jnp.ones((2, 5))), r"at least 3 of each, got \(2, 5\)"),
    "a hole": (lambda: height_field(jnp.ones((3, 5)).at[1, 1].set(jnp.nan)), "finite, 1 are not: fill in what"),
    "no spacing": (lambda: height_field(jnp.ones((3, 5)), spacing=0), "spacing must be positive, got 0.0"),
    "two spacings": (
        lambda: height_field(jnp.ones((3, 5)), spacing=[1.0, 1.0]),
        r"spacing must be a scalar, got shape \(2,\)",
    ),
    "another mask": (lambda: height_field(jnp.ones((3, 5)), mask=np.ones((5, 3))), r"\(3, 5\), got \(5, 3\)"),
    "flat vertices": (lambda: mesh(front(), jnp.ones((3, 2)), [[0, 1, 2]]), r"\(vertices, 3\), got \(3, 2\)"),
    "other normals": (lambda: mesh(front(), *ONE, normals=jnp.ones((4, 3))), r"\(3, 3\), got \(4, 3\)"),
    "faces with four corners": (lambda: mesh(front(), jnp.eye(3), [[0, 1, 2, 0]]), r"int64 \(1, 4\)"),
    "fractions of vertices": (lambda: mesh(front(), jnp.eye(3), [[0.0, 1, 2]]), "integers of shape .* got float64"),
    "no faces": (lambda: mesh(front(), jnp.eye(3), np.zeros((0, 3), int)), r"at least one, got int64 \(0, 3\)"),
    "a vertex too many": (lambda: mesh(front(), jnp.eye(3), [[0, 1, 3]]), "name vertices 0 to 2, got 0 to 3"),
    "a vertex before the first": (lambda: mesh(front(), jnp.eye(3), [[0, 1, -1]]), "got -1 to 1"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case, unchecked):
    make, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        make()
