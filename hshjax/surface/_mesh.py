"""A mesh of triangles, seen by casting rays. Needs embreex (the extra `mesh`)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._fields import floating
from hshjax._typing import Array, Float, Int
from hshjax.camera import AbstractCamera
from hshjax.geometry import common_dtype, dot, normalized
from hshjax.surface._surface import Surface


def mesh(
    camera: AbstractCamera,
    vertices: Float[Array | np.ndarray, "vertices 3"],
    faces: Any,
    *,
    normals: Float[Array | np.ndarray, "vertices 3"] | None = None,
) -> Surface:
    """The triangles that a camera sees first, shaded smoothly: normals are interpolated between vertices.

    - `vertices` `(vertices, 3)`: in the world. - `faces` `(faces, 3)`: three vertices each, as integers that are known
      when a program is compiled.
    - `normals` `(vertices, 3)`: at the vertices, unit. None: means over the faces around each, weighted by their angle
      there. Vertices in one place count as one (seams of a texture leave no trace); faces must be wound alike.

    Both sides of a face can be seen: its normals are turned to the side that the eye is on. Towards a silhouette, an
    interpolated normal may point away from the eye although the face does not: `reflect` leaves such a pixel black. The
    position of a pixel without a surface is the origin of its ray.

    Which face a pixel sees is found in float32, relative to the size of the mesh, and counts as constant: derivatives
    by vertices, normals and camera are those of the face that is seen, without the motion of silhouettes.

    Sources: Wald et al., Embree, SIGGRAPH 2014; Möller & Trumbore, Fast, Minimum Storage Ray/Triangle Intersection, JGT
    2(1), 1997; Thürmer & Wüthrich, Computing Vertex Normals from Polygonal Facets, JGT 3(1), 1998.

    **Raises:** ImportError without embreex; ValueError for other shapes, and for faces of vertices that do not exist.
    """
    _embree()
    faces = np.asarray(faces)
    _check(vertices, faces, normals)
    origin, direction, vertices = common_dtype(*camera.rays(), floating(vertices))
    seen = _first_faces(camera, vertices, faces, origin, direction)
    if normals is None:
        normals = _vertex_normals(vertices, faces)
    corners = jnp.asarray(faces)[seen]
    hit = (seen >= 0)[..., None]
    return Surface(*_at(origin, direction, vertices[corners], floating(normals).astype(vertices.dtype)[corners], hit))


def _embree() -> tuple[Any, Any]:
    try:
        from embreex import mesh_construction, rtcore_scene
    except ImportError as error:
        raise ImportError('mesh needs embreex: pip install "hshjax[mesh]"') from error
    return mesh_construction, rtcore_scene


def _check(vertices: Any, faces: np.ndarray, normals: Any) -> None:
    shape = jnp.shape(vertices)
    if len(shape) != 2 or shape[1] != 3:
        raise ValueError(f"vertices must have shape (vertices, 3), got {shape}")
    if normals is not None and jnp.shape(normals) != shape:
        raise ValueError(f"normals must have the shape of the vertices, {shape}, got {jnp.shape(normals)}")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.size == 0 or not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(f"faces must be integers of shape (faces, 3), at least one, got {faces.dtype} {faces.shape}")
    if faces.min() < 0 or faces.max() >= shape[0]:
        raise ValueError(f"faces name vertices 0 to {shape[0] - 1}, got {faces.min()} to {faces.max()}")


def _first_faces(
    camera: AbstractCamera, vertices: Array, faces: np.ndarray, origin: Array, direction: Array
) -> Int[Array, "rows columns"]:
    """Index of the face that each ray meets first, -1 for none."""
    from_infinity = not camera.needs_positions

    def cast(vertices, origin, direction):
        vertices, origin, direction = (np.asarray(a, np.float64) for a in (vertices, origin, direction))
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        # Embree computes in float32: around the middle of the mesh, so that it keeps its digits wherever the mesh is.
        origin = (origin - (low + high) / 2).reshape(-1, 3)
        direction = direction.reshape(-1, 3)
        if from_infinity:
            along = np.sum(origin * direction, axis=-1, keepdims=True)
            origin = origin - (along + np.linalg.norm(high - low)) * direction
        construction, rtcore = _embree()
        scene = rtcore.EmbreeScene(robust=True)
        construction.TriangleMesh(scene, (vertices - (low + high) / 2).astype(np.float32), faces.astype(np.int32))
        return scene.run(origin.astype(np.float32), direction.astype(np.float32)).reshape(camera.resolution)

    given = jax.lax.stop_gradient((vertices, origin, direction))
    shape = jax.ShapeDtypeStruct(camera.resolution, jnp.int32)
    return jax.pure_callback(cast, shape, *given, vmap_method="sequential")


def _vertex_normals(vertices: Float[Array, "vertices 3"], faces: np.ndarray) -> Float[Array, "vertices 3"]:
    """Sums over the corners at a vertex of the normal of the face times its angle there; not normalised."""

    def first_of_place(vertices):
        _, first, place = np.unique(np.asarray(vertices), axis=0, return_index=True, return_inverse=True)
        return first[place].reshape(-1).astype(np.int32)

    shape = jax.ShapeDtypeStruct(vertices.shape[:1], jnp.int32)
    same = jax.pure_callback(first_of_place, shape, jax.lax.stop_gradient(vertices), vmap_method="sequential")
    corners = same[jnp.asarray(faces)]
    at = vertices[corners]
    a, b = jnp.roll(at, -1, axis=1) - at, jnp.roll(at, 1, axis=1) - at
    facet = jnp.cross(a, b)
    square = dot(facet, facet)
    proper = square > 0
    sine = jnp.sqrt(jnp.where(proper, square, 1))
    share = jnp.where(proper, jnp.arctan2(sine, dot(a, b)) / sine, 0)[..., None] * facet
    return jnp.zeros_like(vertices).at[corners].add(share)[same]


@jax.jit
def _at(
    origin: Float[Array, "*pixels 3"],
    direction: Float[Array, "*pixels 3"],
    corners: Float[Array, "*pixels 3 3"],
    normals: Float[Array, "*pixels 3 3"],
    hit: Array,
) -> tuple[Float[Array, "*pixels 3"], Float[Array, "*pixels 3"]]:
    """Normal and position where rays meet the planes of triangles."""
    a, b, c = (corners[..., k, :] for k in range(3))
    facet = jnp.cross(b - a, c - a)
    slant = dot(facet, direction)[..., None]
    # With s from a corner to the origin: u = d·(s × ac) / (d·facet), v = d·(ab × s) / (d·facet).
    safe = jnp.where(hit & (slant != 0), slant, 1)
    s = origin - a
    u = dot(direction, jnp.cross(s, c - a))[..., None] / safe
    v = dot(direction, jnp.cross(b - a, s))[..., None] / safe
    weights = jnp.concatenate([1 - u - v, u, v], axis=-1)[..., None]
    facet = normalized(jnp.where(slant > 0, -facet, facet))
    normal = normalized(jnp.sum(weights * normals, axis=-2))
    normal = jnp.where(dot(normal, facet)[..., None] < 0, -normal, normal)
    normal = jnp.where(jnp.any(normal != 0, axis=-1, keepdims=True), normal, facet)  # faces back to back cancel
    position = jnp.sum(weights * corners, axis=-2)
    return jnp.where(hit, normal, 0), jnp.where(hit, position, origin)
