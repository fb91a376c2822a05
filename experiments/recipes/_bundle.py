"""What the joint recovery rests on: least squares in normals and lights at once, by Schur's complement. Host arrays.

Radiance of a pixel in image k depends on the pixel's slopes (p, q) = ∂z/∂(x, y) and on the five numbers of light k: its
direction (a, b, 1), and the logarithms of its irradiances. So the normal equations hold a 2 x 2 block for each pixel
and one of 5 x 5 for each light. Pixels are eliminated, lights are solved for, as points and cameras in bundle
adjustment (Triggs et al., Bundle Adjustment, 2000). Where the slopes are those of heights, the pixels' part is sparse.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.sparse import block_array, csr_array, diags_array, eye_array, kron, vstack
from scipy.sparse.linalg import splu

from hshjax import DirectionalLight, LinearBRDF, reflect
from hshjax.geometry import normalized

VIEW = (0.0, 0.0, 1.0)

Linear = csr_array | np.ndarray
"""From unknowns to slopes, all p and then all q: sparse, or dense for few unknowns."""


@dataclass(frozen=True)
class Equations:
    """½|r|² of all images, in standard deviations of the noise, and its normal equations.

    - `losses` (P,): of each pixel, in all images.
    - `pixels` (P, 2, 2), `lights` (K, 5, 5), `cross` (P, K, 2, 5): the blocks of JᵀJ.
    - `pull` (P, 2), `pull_lights` (K, 5): those of -Jᵀr.
    """

    losses: np.ndarray
    pixels: np.ndarray
    lights: np.ndarray
    cross: np.ndarray
    pull: np.ndarray
    pull_lights: np.ndarray

    @property
    def loss(self) -> float:
        return float(self.losses.sum())


def normals_of(slopes: jax.Array) -> jax.Array:
    """Unit normals of slopes (p, q)."""
    return normalized(jnp.concatenate([-slopes, jnp.ones_like(slopes[..., :1])], axis=-1))


@eqx.filter_jit
def radiance(brdf: LinearBRDF, slopes: jax.Array, light: jax.Array) -> jax.Array:
    """Of pixels `(P, 3)` under one light `(5,)`."""
    lamp = DirectionalLight(jnp.append(light[:2], jnp.ones((), light.dtype)), jnp.exp(light[2:]))
    return reflect(brdf, lamp, normals_of(slopes), jnp.asarray(VIEW, slopes.dtype))


@eqx.filter_jit
def _blocks(brdf: LinearBRDF, image: jax.Array, sigma: jax.Array, slopes: jax.Array, light: jax.Array) -> tuple:
    """The parts of `Equations` that belong to one image `(P, 3)`."""

    def predicted(slopes, direction):
        return radiance(brdf, slopes, jnp.append(direction, light[2:])) / sigma

    value, push = jax.linearize(predicted, slopes, light[:2])
    r = value - image / sigma
    still, fixed = jnp.zeros_like(slopes), jnp.zeros_like(light[:2])
    own = jnp.stack([push(still.at[:, i].set(1), fixed) for i in range(2)], axis=-1)
    lit = jnp.stack([push(still, fixed.at[i].set(1)) for i in range(2)], axis=-1)
    # By the logarithm of its irradiance a channel changes in proportion to itself.
    lit = jnp.concatenate([lit, value[:, :, None] * jnp.eye(3, dtype=value.dtype)[None]], axis=-1)
    return (
        jnp.sum(r * r, axis=1) / 2, jnp.einsum("pci,pcj->pij", own, own), jnp.einsum("pci,pcj->ij", lit, lit),
        jnp.einsum("pci,pcj->pij", own, lit), -jnp.einsum("pci,pc->pi", own, r), -jnp.einsum("pci,pc->i", lit, r),
    )  # fmt: skip


def equations(
    brdf: LinearBRDF, images: np.ndarray, sigma: np.ndarray, slopes: np.ndarray, lights: np.ndarray
) -> Equations:
    """The `Equations` of images `(K, P, 3)` with noise `sigma` `(K, P, 1)`, at slopes `(P, 2)` and lights `(K, 5)`."""
    parts = [
        _blocks(brdf, *map(jnp.asarray, (image, s, slopes, light)))
        for image, s, light in zip(images, sigma, lights, strict=True)
    ]
    losses, pixels, own, cross, pull, pull_lights = (np.stack(part) for part in zip(*parts, strict=True))
    return Equations(losses.sum(0), pixels.sum(0), own, np.swapaxes(cross, 0, 1), pull.sum(0), pull_lights)


def step(found: Equations, matrix: Linear, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """One of Levenberg and Marquardt, of x and of the lights `(K, 5)`; slopes, all p and then all q, are `matrix` x."""
    eliminate, cross, lights = _reduced(found, matrix, damping)
    pull = matrix.T @ found.pull.T.ravel()
    both = eliminate(np.column_stack([cross, pull]))
    by_lights, alone = both[:, :-1], both[:, -1]
    move = np.linalg.lstsq(lights - cross.T @ by_lights, found.pull_lights.ravel() - cross.T @ alone)[0]
    return alone - by_lights @ move, move.reshape(found.pull_lights.shape)


def _reduced(found: Equations, matrix: Linear, damping: float) -> tuple[Callable, np.ndarray, np.ndarray]:
    """Solver of the pixels' part, the part in both, and that of the lights `(5 K, 5 K)`."""
    (pp, pq), (_, qq) = np.moveaxis(found.pixels, 0, -1)
    weight = block_array([[diags_array(pp), diags_array(pq)], [diags_array(pq), diags_array(qq)]], format="csr")
    normal = matrix.T @ (weight @ matrix)
    diagonal = normal.diagonal()
    # What no light reaches stays where it is.
    added = damping * diagonal + 1e-9 * diagonal.mean()
    if isinstance(matrix, np.ndarray):
        eliminate = partial(cho_solve, cho_factor(normal + np.diag(added)))
    else:
        eliminate = splu((normal + diags_array(added)).tocsc(), permc_spec="MMD_AT_PLUS_A").solve
    cross = matrix.T @ np.transpose(found.cross, (2, 0, 1, 3)).reshape(matrix.shape[0], -1)
    lights = block_diag(*found.lights)
    lights[np.diag_indices_from(lights)] *= 1 + damping
    return eliminate, cross, lights


def descend(
    brdf: LinearBRDF,
    images: np.ndarray,
    sigma: np.ndarray,
    matrix: Linear,
    x: np.ndarray,
    lights: np.ndarray,
    *,
    steps: int,
    held: bool = False,
) -> tuple[np.ndarray, np.ndarray, Equations]:
    """Unknowns and lights of least loss from the given ones on, in at most `steps` steps; x stays where it is `held`.

    Steps are damped in proportion to the diagonal, less after each that helps; it ends when the loss stands still.
    """

    def at(x, lights):
        return equations(brdf, images, sigma, (matrix @ x).reshape(2, -1).T, lights)

    found, damping = at(x, lights), 1e-2
    for _ in range(steps):
        if held:
            blocks = found.lights * (1 + damping * np.eye(5))
            move, turn = 0.0, np.linalg.solve(blocks, found.pull_lights[..., None])[..., 0]
        else:
            move, turn = step(found, matrix, damping)
        trial = at(x + move, lights + turn)
        if trial.loss < found.loss:
            still = found.loss - trial.loss < 1e-6 * found.loss
            x, lights, found, damping = x + move, lights + turn, trial, max(damping / 6, 1e-8)
            if still:
                break
        else:
            damping *= 5
            if damping > 1e6:
                break
    return x, lights, found


def looked_up(
    brdf: LinearBRDF,
    images: np.ndarray,
    sigma: np.ndarray,
    slopes: np.ndarray,
    lights: np.ndarray,
    *,
    steepest: float,
    reach: float = np.inf,
) -> np.ndarray:
    """Slopes `(P, 2)` of each pixel by itself under known lights: the best of a grid, where that beats those given.

    `reach`: standard deviation about the given slopes; what the images do not tell apart is decided by it.
    """
    grid = np.linspace(-steepest, steepest, 81)
    tried = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    tried = tried[np.sum(tried**2, axis=1) <= steepest**2]

    def shown(slopes):
        return np.stack([np.asarray(radiance(brdf, jnp.asarray(slopes), jnp.asarray(light))) for light in lights])

    known, table = images / sigma, shown(tried)
    square = np.zeros((len(slopes), len(tried)))
    for image, s, entries in zip(known, sigma, table, strict=True):
        square += np.sum(entries**2, axis=1) / s**2 - 2 * (image / s) @ entries.T
    square += np.sum(known**2, axis=(0, 2))[:, None]
    square += np.sum((slopes[:, None] - tried) ** 2, axis=-1) / reach**2
    best = np.argmin(square, axis=1)
    better = square[np.arange(len(slopes)), best] < np.sum((shown(slopes) / sigma - known) ** 2, axis=(0, 2))
    return np.where(better[:, None], tried[best], slopes)


def uncertainty(
    found: Equations, matrix: csr_array, slopes: np.ndarray, chosen: np.ndarray, gauge: int
) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations to first order: of the normals of `chosen` pixels [rad], and of combinations of the lights'
    numbers, the largest first.

    The `gauge` combinations that are known the least are left out of the former.
    """
    eliminate, cross, lights = _reduced(found, matrix, 0.0)
    by_lights = eliminate(cross)
    value, vector = np.linalg.eigh(lights - cross.T @ by_lights)
    deviation = 1 / np.sqrt(np.maximum(value, np.finfo(float).tiny))
    rows = [matrix[chosen], matrix[chosen + len(slopes)]]
    by_x = [eliminate(row.T.toarray()) for row in rows]
    spread = [(row @ by_lights) @ vector[:, gauge:] * deviation[gauge:] for row in rows]

    def covariance(a, b):
        alone = np.asarray(rows[a].multiply(by_x[b].T).sum(axis=1)).ravel()
        return alone + np.sum(spread[a] * spread[b], axis=1)

    # |dn|² = (|ds|² (1 + s²) - (s·ds)²) / (1 + s²)² for slopes s.
    p, q = slopes[chosen].T
    square = 1 + p**2 + q**2
    pp, pq, qq = covariance(0, 0), covariance(0, 1), covariance(1, 1)
    along = p**2 * pp + 2 * p * q * pq + q**2 * qq
    return np.sqrt(np.maximum((pp + qq) * square - along, 0)) / square, deviation


# Shapes


def free_slopes(pixels: int) -> csr_array:
    """x are the slopes themselves: every normal by itself."""
    return csr_array(eye_array(2 * pixels))


def slopes_of_heights(size: int, spacing: float) -> csr_array:
    """x are heights on a square grid, row by row, without its outer ring, which is held at 0.

    The slopes are those of `hshjax.height_field`: rows run against y.
    """
    inner = np.zeros((size, size), bool)
    inner[1:-1, 1:-1] = True
    along = differences(size) / spacing
    whole = vstack([kron(eye_array(size), along), kron(-along, eye_array(size))])
    return csr_array(csr_array(whole)[:, np.flatnonzero(inner)])


def sines(size: int, order: int) -> np.ndarray:
    """Heights on the inner nodes `(nodes, order²)`: products of the first sines, which vanish along the border."""
    wave = np.sin(np.pi * np.outer(np.arange(1, size - 1) / (size - 1), np.arange(1, order + 1)))
    return np.kron(wave, wave)


def differences(size: int) -> csr_array:
    """The derivative at unit spacing: central differences, of second order at both ends."""
    matrix = np.zeros((size, size))
    i = np.arange(1, size - 1)
    matrix[i, i - 1], matrix[i, i + 1] = -0.5, 0.5
    matrix[0, :3], matrix[-1, -3:] = (-1.5, 2, -0.5), (0.5, -2, 1.5)
    return csr_array(matrix)
