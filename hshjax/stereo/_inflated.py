"""Shapes that bulge out of their outline: heights whose normals turn away from the camera all along it.

    z = b + sqrt(D) e^g,   ΔD = -4 in the mask, D = 0 on its outline

Of a disk sqrt(D) is the sphere of its radius. For any smooth g and b the slope is infinite on the outline and normals
point out of it, and multiplied by what is infinite they stay finite:

    n ~ (-∇D/2 - D ∇g - sqrt(D) e^-g ∇b, sqrt(D) e^-g)
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float, Int
from hshjax.geometry import normalized
from hshjax.photographs import numbers


class Bulge(eqx.Module):
    """The fields of a shape as sums of levels, coarse ones first, each a coarser grid over the same rectangle: steps of
    a gradient move the coarse ones as easily as the fine ones.

    - `growth`: levels of g. - `base`: levels of b, over the radius; none: b = 0.
    """

    growth: tuple[Float[Array, "..."], ...]
    base: tuple[Float[Array, "..."], ...]


class Inflated(eqx.Module):
    """What of a shape its outline tells. Lengths are in pixels, x to the right, y up, row 0 the upmost.

    - `dome` D `(pixels,)`, its `slope` `(pixels, 2)`. - `place` `(pixels,)`: numbers in the rectangle, row by row.
    - `radius`: of the disk of the same area. - `shape`: rows and columns.
    """

    dome: Float[Array, " pixels"]
    slope: Float[Array, "pixels 2"]
    place: Int[Array, " pixels"]
    radius: float = eqx.field(static=True)
    shape: tuple[int, int] = eqx.field(static=True)

    @classmethod
    def of(cls, mask: Bool[np.ndarray, "rows columns"], dtype) -> "Inflated":
        """Of an outline; pieces of a mask are inflated each by itself."""
        dome, slope = _dome(mask)
        radius = float(np.sqrt(np.sum(mask) / np.pi))
        place = np.flatnonzero(mask)
        return cls(jnp.asarray(dome, dtype), jnp.asarray(slope, dtype), jnp.asarray(place), radius, mask.shape)

    def flat(self, levels: int, base: int = 0, height: float = 1.0) -> Bulge:
        """The dome itself, `height` times as high, with so many levels of g and of b."""
        dtype = self.dome.dtype
        growth = [jnp.zeros(_size(self.shape, self.radius, level), dtype) for level in range(levels)]
        growth[0] = growth[0] + jnp.asarray(np.log(height), dtype)
        return Bulge(
            tuple(growth), tuple(jnp.zeros(_size(self.shape, self.radius, level), dtype) for level in range(base))
        )

    def levels(self) -> int:
        """How many levels there are until the finest one has a node every two pixels."""
        return 1 + max(0, round(np.log2(max(self.radius, 4) / 4))) + 1

    def fields(self, bulge: Bulge) -> "Fields":
        """g and b over the whole rectangle."""
        return Fields(*(_sum(levels, self.shape, self.dome.dtype) for levels in (bulge.growth, bulge.base)))

    def normals(self, bulge: Bulge) -> Float[Array, "pixels 3"]:
        """Unit normals of the pixels."""
        growth, base = self.fields(bulge)
        root = jnp.sqrt(self.dome) * jnp.exp(-growth.ravel()[self.place])
        lateral = self.slope / 2 + self.dome[:, None] * self._gradient(growth)
        lateral = lateral + root[:, None] * self.radius * self._gradient(base)
        return normalized(jnp.concatenate([-lateral, root[:, None]], axis=1))

    def heights(self, bulge: Bulge) -> Float[Array, " pixels"]:
        """z of the pixels [pixels]."""
        growth, base = (field.ravel()[self.place] for field in self.fields(bulge))
        return self.radius * base + jnp.sqrt(self.dome) * jnp.exp(growth)

    def _gradient(self, field: Float[Array, "rows columns"]) -> Float[Array, "pixels 2"]:
        down, right = jnp.gradient(field)
        return jnp.stack([right, -down], axis=-1).reshape(-1, 2)[self.place]


class Fields(NamedTuple):
    """g, and b over the radius, `(rows, columns)`."""

    growth: Float[Array, "rows columns"]
    base: Float[Array, "rows columns"]


def bending(
    field: Float[Array, "rows columns"],
) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """Second differences xx, yy and √2 xy inside the rectangle: the sum of squares does not change under a turn."""
    xx = field[:, 2:] - 2 * field[:, 1:-1] + field[:, :-2]
    yy = field[2:] - 2 * field[1:-1] + field[:-2]
    xy = field[1:, 1:] - field[1:, :-1] - field[:-1, 1:] + field[:-1, :-1]
    return xx, yy, jnp.sqrt(jnp.asarray(2, field.dtype)) * xy


def _size(shape: tuple[int, int], radius: float, level: int) -> tuple[int, int]:
    """Of a level's grid: nodes a radius apart at level 0, half of that at each further one."""
    rows, columns = (max(2, min(n, round(n / radius * 2**level) + 1)) for n in shape)
    return rows, columns


def _sum(levels: tuple[Array, ...], shape: tuple[int, int], dtype) -> Float[Array, "rows columns"]:
    total = jnp.zeros(shape, dtype)
    for level in levels:
        total = total + jax.image.resize(level, shape, "cubic")
    return total


def _dome(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """D and its slope at the pixels of a mask, whose outline lies half-way to the pixels outside. Finite differences
    with unequal distances, of second order in the slope. Source: Shortley & Weller, J. Appl. Phys. 9, 1938."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    wide = np.pad(mask, 1)
    number = numbers(wide)
    row, column = np.nonzero(wide)
    count = len(row)
    sides = {}
    for step in ((0, 1), (0, -1), (-1, 0), (1, 0)):
        there = wide[row + step[0], column + step[1]]
        other = np.where(there, number[row + step[0], column + step[1]], 0)
        sides[step] = other, there, np.where(there, 1.0, 0.5)
    rows, columns, values, diagonal = [], [], [], np.zeros(count)
    for step, back in (((0, 1), (0, -1)), ((0, -1), (0, 1)), ((-1, 0), (1, 0)), ((1, 0), (-1, 0))):
        other, there, near = sides[step]
        weight = 2 / (near * (near + sides[back][2]))
        diagonal += weight
        rows.append(np.flatnonzero(there))
        columns.append(other[there])
        values.append(-weight[there])
    every = np.arange(count)
    entries = np.concatenate([diagonal, *values])
    matrix = coo_array((entries, (np.concatenate([every, *rows]), np.concatenate([every, *columns]))), (count, count))
    dome = np.asarray(spsolve(matrix.tocsc(), np.full(count, 4.0)))
    slope = []
    for ahead, behind in (((0, 1), (0, -1)), ((-1, 0), (1, 0))):
        (a, there_a, h), (b, there_b, k) = sides[ahead], sides[behind]
        after, before = np.where(there_a, dome[a], 0), np.where(there_b, dome[b], 0)
        slope.append((k / h * after - h / k * before + (h / k - k / h) * dome) / (h + k))
    return dome, np.stack(slope, axis=1)
