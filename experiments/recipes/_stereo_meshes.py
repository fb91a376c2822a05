"""Triangles with exact normals for synthetic photometric stereo: how they are made, what is seen of them, what is lit.

World: x right, y up, z towards the camera, which sees [-1, 1]² of x and y: from far away, or by a pinhole at z = 0.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import hshjax
from hshjax import OrthographicCamera, PerspectiveCamera, Surface
from hshjax.camera import AbstractCamera

LEAST_COSINE = 0.05
"""Of a normal with the view: silhouettes that are seen more slantingly are no part of a mask."""

OFFSET = 1e-4
"""How far from the surface rays to the lights start: well above what float32 errs."""

HALF_WIDTH = 1.25
"""Of reliefs in x and y: what is not seen casts shadows and light on what is."""


class Shape(NamedTuple):
    """Triangles with unit normals at their vertices, in the world.

    - `vertices`, `normals` `(vertices, 3)`. - `faces` `(faces, 3)`: anticlockwise as seen from outside.
    - `convex`: no point hides a light from another. - `analytic`: what a camera sees in closed form; None: triangles.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    convex: bool = False
    analytic: Callable[[AbstractCamera], Surface] | None = None


def camera(size: int) -> OrthographicCamera:
    """Far away on +z; `size` x `size` pixels of [-1, 1]²."""
    return OrthographicCamera(jnp.asarray([0.0, 0.0, 1.0]), jnp.asarray([0.0, 1.0, 0.0]), resolution=(size, size))


def pinhole(size: int, distance: float) -> PerspectiveCamera:
    """The same square in the plane z = 0, seen from `distance` above it."""
    eye, target, up = jnp.asarray([0.0, 0.0, distance]), jnp.zeros(3), jnp.asarray([0.0, 1.0, 0.0])
    return PerspectiveCamera(eye, target, up, field_of_view=2 * np.arctan(1 / distance), resolution=(size, size))


def aimed(eye: OrthographicCamera | PerspectiveCamera, position: np.ndarray, off: float = 0.0) -> Any:
    """The same camera, on +z, that tells the mean depth of what it sees at `position` `(pixels, 3)`: heights, or
    logarithms of depths. `off`: how much farther away it says that to be."""
    if isinstance(eye, OrthographicCamera):
        return replace(eye, centre=jnp.asarray([0.0, 0.0, position[:, 2].mean() - off]))
    height = float(eye.eye[2])
    return replace(eye, target=jnp.asarray([0.0, 0.0, height - np.exp(np.log(height - position[:, 2]).mean()) - off]))


def seen(shape: Shape, size: int, eye: AbstractCamera | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mask `(size, size)`, and unit normals and positions at the centres of its pixels, `(pixels, 3)` each.

    `eye`: None for `camera(size)`.

    **Raises:** ValueError where no pixel sees the shape.
    """
    eye = camera(size) if eye is None else eye
    if shape.analytic is None:
        surface = hshjax.mesh(eye, shape.vertices, shape.faces, normals=shape.normals)
    else:
        surface = shape.analytic(eye)
    mask = -np.sum(np.asarray(surface.normal) * np.asarray(eye.rays()[1]), axis=-1) > LEAST_COSINE
    if not mask.any():
        raise ValueError(f"none of {size} x {size} pixels sees the shape")
    return mask, np.asarray(surface.normal)[mask], np.asarray(surface.position)[mask]


def visible(shape: Shape, normal: np.ndarray, position: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Which points `(n, 3)` of a shape see light from directions `(lights, 3)`, or `(n, lights, 3)` to lights nearby
    outside of its convex hull: `(n, lights)`, bool.

    False in attached shadows too. Rays are cast in float32.
    """
    towards = np.broadcast_to(towards, (len(normal), *towards.shape[-2:]))
    lit = np.einsum("ni,nji->nj", normal, towards) > 0
    if shape.convex:
        return lit
    from embreex import mesh_construction, rtcore_scene

    scene = rtcore_scene.EmbreeScene(robust=True)
    mesh_construction.TriangleMesh(scene, shape.vertices.astype(np.float32), shape.faces.astype(np.int32))
    point, light = np.nonzero(lit)
    origin = (position + OFFSET * normal)[point]
    hidden = scene.run(origin.astype(np.float32), towards[point, light].astype(np.float32)) >= 0
    lit[point[hidden], light[hidden]] = False
    return lit


def radial(radius: Callable[[Any], Any], steps: int = 96) -> Shape:
    """The body |p| = radius(p / |p|), of one direction `(3,)`: a cube of 6 x `steps`² squares, blown up."""
    # Nodes as integers, in which those that two sides share are equal: no light shall pass between.
    u = 2 * np.arange(steps + 1) - steps
    side = np.stack([*np.meshgrid(u, u, indexing="ij"), np.full((steps + 1, steps + 1), steps)], -1).reshape(-1, 3)
    opposite = -side[:, ::-1]  # a rotation of it: triangles stay anticlockwise
    cube = np.concatenate([np.roll(one, k, axis=1) for k in range(3) for one in (side, opposite)])
    nodes, place = np.unique(cube, axis=0, return_inverse=True)
    faces = place.reshape(-1)[np.concatenate([_quads(steps + 1, steps + 1) + k * len(side) for k in range(6)])]
    w = np.tan(np.pi / 4 / steps * nodes)
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    slope = jax.grad(lambda p: jnp.linalg.norm(p) - radius(p / jnp.linalg.norm(p)))

    @jax.jit
    @jax.vmap
    def grown(w):
        p = radius(w) * w
        return p, slope(p)

    return _shape(*grown(jnp.asarray(w)), faces)


def relief(height: Callable[[Any], Any], steps: int = 257) -> Shape:
    """The surface z = height(p), of one point `(2,)` of the plane: `steps`² squares over `HALF_WIDTH` either way."""
    x = np.linspace(-HALF_WIDTH, HALF_WIDTH, steps + 1)
    plane = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)

    @jax.jit
    @jax.vmap
    def risen(p):
        z, slope = jax.value_and_grad(height)(p)
        return jnp.append(p, z), jnp.append(-slope, 1)

    return _shape(*risen(jnp.asarray(plane)), _quads(steps + 1, steps + 1))


def revolved(curve: np.ndarray, normal: np.ndarray, steps: int = 192) -> Shape:
    """A curve (radius, z) `(k, 2)` turned about z; its normals `(k, 2)`, of any length, lie on its left."""
    turn = 2 * np.pi * np.arange(steps) / steps

    def around(values):
        r, z = values[:, :1], np.broadcast_to(values[:, 1:], (len(values), steps))
        return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1).reshape(-1, 3)

    faces = _quads(len(curve), steps + 1)
    row, column = np.divmod(faces, steps + 1)
    return _shape(around(curve), around(normal), row * steps + column % steps)


def planes(corners: Any) -> Shape:
    """Flat squares `(squares, 4, 3)`, anticlockwise, each with vertices of its own: edges are exactly sharp."""
    corners = np.asarray(corners, float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    first = 4 * np.arange(len(corners))[:, None, None]
    faces = first + np.array([[0, 1, 2], [0, 2, 3]])
    return _shape(corners.reshape(-1, 3), np.repeat(normal, 4, 0), faces.reshape(-1, 3))


def _shape(vertices: Any, normals: Any, faces: np.ndarray) -> Shape:
    vertices, normals = np.asarray(vertices, float), np.asarray(normals, float)
    return Shape(vertices, faces, normals / np.linalg.norm(normals, axis=1, keepdims=True))


def _quads(rows: int, columns: int) -> np.ndarray:
    """Two triangles for each cell of a grid of vertices, anticlockwise where rows x columns points outwards."""
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    b, c, d = a + columns, a + columns + 1, a + 1
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
