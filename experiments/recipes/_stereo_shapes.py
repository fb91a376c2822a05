"""The shapes of synthetic photometric stereo, `SHAPES`: name -> shape of a seed. Those without chance ignore it."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import hshjax
from experiments.config import local_path
from experiments.recipes._stereo_meshes import HALF_WIDTH, Shape, planes, radial, relief, revolved


def sphere(seed: int) -> Shape:
    """The unit sphere, convex; its triangles, an inscribed polyhedron, are there for other renderers."""
    return radial(lambda w: jnp.ones((), w.dtype))._replace(convex=True, analytic=hshjax.sphere)


def blob(seed: int) -> Shape:
    """A closed body: a ball with round bumps and dents, and with creases along the nodes of three waves."""
    rng = np.random.default_rng(seed)
    centres, waves = _directions(rng, 9), 3.2 * _directions(rng, 3)
    height, width, phase = rng.uniform(-0.15, 0.3, 9), rng.uniform(0.25, 0.6, 9), rng.uniform(0, 2 * np.pi, 3)

    def radius(w):
        bumps = jnp.sum(height * jnp.exp((jnp.asarray(centres) @ w - 1) / width**2))
        creases = jnp.sum(_folded(jnp.sin(jnp.asarray(waves) @ w + phase), 0.02))
        return 1 + bumps + 0.06 * creases

    shape = radial(radius)
    return shape._replace(vertices=0.95 / np.abs(shape.vertices[:, :2]).max() * shape.vertices)


def vase(seed: int) -> Shape:
    """An open vase that leans towards the eye, which sees its outside and a part of its inside."""
    t = np.linspace(0, 1, 129)
    wall, level, thick = 0.42 + 0.16 * np.sin(2.2 * np.pi * t + 0.3) + 0.1 * t, 1.5 * t - 0.75, 0.03
    turn = np.linspace(0, np.pi, 17)[1:-1]
    inside = np.stack([wall - 2 * thick, level], 1)[8:]
    lip = np.stack([wall[-1] - thick - thick * np.cos(turn), level[-1] + thick * np.sin(turn)], 1)
    floor, base = (np.stack([r * t[::8], np.full(17, z)], 1) for r, z in (inside[0], (wall[0], level[0])))
    curve = np.concatenate([floor[:-1], inside, lip, np.stack([wall, level], 1)[::-1], base[-2::-1]])
    along = np.gradient(curve, axis=0)
    upright = revolved(curve, np.stack([-along[:, 1], along[:, 0]], 1))
    cosine, sine = np.cos(np.radians(50)), np.sin(np.radians(50))
    turned = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])  # its axis, z, to 50 degrees above the view
    return upright._replace(vertices=1.15 * upright.vertices @ turned, normals=upright.normals @ turned)


def bowl(seed: int) -> Shape:
    """A plate with a deep round bowl, whose rim is rounded, seen from straight above."""
    turn, rim, deep, rounded = np.linspace(0, np.pi / 2, 97), np.linspace(0, np.pi / 2, 17)[1:], 0.75, 0.08
    down, out = np.stack([np.sin(turn), -np.cos(turn)], 1), np.stack([-np.cos(rim), np.sin(rim)], 1)
    curve = np.concatenate([deep * down, rounded * out + [deep + rounded, 0], [[2.0, rounded]]])
    return revolved(curve - [0, rounded], np.concatenate([-down, out, [[0, 1]]]))


def grooves(seed: int) -> Shape:
    """Flat strips that make sharp V-shaped grooves of 64 degrees along y, which reach far beyond what is seen."""
    x, z = np.linspace(-HALF_WIDTH, HALF_WIDTH, 11), 0.4 * (np.arange(11) % 2)
    y = 8 * HALF_WIDTH
    return planes(
        [[[x[k], -y, z[k]], [x[k + 1], -y, z[k + 1]], [x[k + 1], y, z[k + 1]], [x[k], y, z[k]]] for k in range(10)]
    )


def corner(seed: int) -> Shape:
    """Three walls that meet at right angles, seen along the diagonal; where they meet lies deepest."""
    turn = np.radians([90, 210, 330])
    edge = np.stack([np.sqrt(2 / 3) * np.cos(turn), np.sqrt(2 / 3) * np.sin(turn), np.full(3, np.sqrt(1 / 3))], 1)
    following, none = np.roll(edge, -1, 0), np.zeros((3, 3))
    return planes(1.15 * np.stack([none, edge, edge + following, following], 1))


def folds(seed: int) -> Shape:
    """A relief of bent ridges with deep, narrow valleys."""
    rng = np.random.default_rng(seed)
    wave = rng.normal(size=(2, 2)) * [[2.5], [4.0]]
    phase = rng.uniform(0, 2 * np.pi, 4)

    def height(p):
        across = 5.5 * p[0] + 2 * p[1] + jnp.sum(jnp.sin(jnp.asarray(wave) @ p + phase[:2]))
        hills = 0.1 * jnp.sin(3 * p[1] - 2 * p[0] + phase[2])
        return 0.42 * _folded(jnp.sin(across + phase[3]), 0.12) + hills

    return relief(height)


def pillars(seed: int) -> Shape:
    """A plate with nine steep round pillars, which cast long shadows."""
    rng = np.random.default_rng(seed)
    centres = np.stack(np.meshgrid(*2 * [[-0.6, 0.0, 0.6]]), -1).reshape(9, 2) + rng.uniform(-0.12, 0.12, (9, 2))
    tall, radius = rng.uniform(0.2, 0.5, 9), rng.uniform(0.08, 0.16, 9)

    def height(p):
        distance = jnp.sqrt(jnp.sum((p[None] - centres) ** 2, axis=-1) + 1e-8)
        return jnp.sum(tall * jax.nn.sigmoid((radius - distance) / 0.015))

    return relief(height)


def head(seed: int) -> Shape:
    """The face of a scanned head. Credit: Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0.

    **Raises:** ValueError where HSHJAX_DATA is not set, or the file is missing.
    """
    with np.load(local_path("$HSHJAX_DATA/face/LeePerrySmith_decoded.npz")) as scan:
        points, normals, faces = (scan[key] for key in ("points", "normals", "faces"))
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return Shape((points - [-0.05, 1.55, 0.0]) / 2.5, faces, normals)


SHAPES: dict[str, Callable[[int], Shape]] = {
    shape.__name__: shape for shape in (sphere, blob, vase, bowl, grooves, corner, folds, pillars, head)
}


def _directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Uniform on the sphere, `(count, 3)`."""
    w = rng.normal(size=(count, 3))
    return w / np.linalg.norm(w, axis=1, keepdims=True)


def _folded(x, width: float):
    """|x|, rounded over `width`: a crease with a finite curvature."""
    return jnp.sqrt(x * x + width * width)
