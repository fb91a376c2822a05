"""Shading tables: the view is fixed, so that what a light makes of an isotropic BRDF depends on the normal alone.

Tabulated over the chart of normals, every BRDF costs the same a pixel: four rows of a table.
"""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.bases._base import matmul
from hshjax.brdfs import AbstractBRDF
from hshjax.lighting import DirectionalLight
from hshjax.reflectance import reflect
from hshjax.stereo._chart import coarse_nodes, grid
from hshjax.stereo._weights import non_negative_weights

SIZE = 129
"""Nodes of a table along an axis: two degrees apart at most."""

TOGETHER = 512
"""Pixels that are looked at together: their normal equations at all coarse nodes stay in the cache."""


class AbstractShading(eqx.Module):
    """Radiance of unit irradiance, BRDF times max(n·l, 0) [sr^-1], of each column of a BRDF under each light: of some
    pixels at their normals, in the chart about their view."""

    @property
    @abc.abstractmethod
    def columns(self) -> int:
        """Number of columns."""

    @abc.abstractmethod
    def at(self, pq: Float[Array, "n 2"]) -> Float[Array, "n columns lights"]:
        """At normals of the pixels."""

    @abc.abstractmethod
    def with_slope(
        self, pq: Float[Array, "n 2"]
    ) -> tuple[Float[Array, "n columns lights"], Float[Array, "n 2 columns lights"]]:
        """The same, and its derivative in p and q."""


class AbstractShadingTables(eqx.Module):
    """Such shading at nodes, of which the tables of pixels are made."""

    @property
    @abc.abstractmethod
    def dtype(self) -> Any:
        """Of values."""

    @property
    @abc.abstractmethod
    def columns(self) -> int:
        """Number of columns."""

    @abc.abstractmethod
    def mixed(self, coefficients: Float[Array, "materials columns"]) -> "AbstractShadingTables":
        """Of linear combinations of the columns."""

    @abc.abstractmethod
    def rows(self) -> Float[Array, "columns samples"]:
        """Of each column, so that sums of products are those over nodes and lights, up to a factor."""

    @abc.abstractmethod
    def of(self, towards: Float[Array, "... lights 3"]) -> "AbstractShadingTable":
        """The table of some pixels. `towards`: unit vectors to the lights, in the frame of each pixel's view."""


class AbstractShadingTable(AbstractShadingTables, AbstractShading):
    """Shading of some pixels, or of all where it is the same for all: linear between nodes."""

    @abc.abstractmethod
    def mixed(self, coefficients: Float[Array, "materials columns"]) -> "AbstractShadingTable":
        """Of linear combinations of the columns."""

    @abc.abstractmethod
    def best_node(self, values: Float[Array, "n lights"], trust: Float[Array, "n lights"]) -> Float[Array, "n 2"]:
        """The normal of each pixel, of those of `coarse_nodes`, that leaves the least weighted squares of its values,
        with the best weights >= 0 of the columns."""


class FarTable(AbstractShadingTable):
    """Shading under lights and view that all pixels share.

    - `values` `(size², columns, lights)`: at the nodes of `grid(size)`.
    """

    values: Float[Array, "nodes columns lights"]
    size: int = eqx.field(static=True)

    @property
    def dtype(self) -> Any:
        return self.values.dtype

    @property
    def columns(self) -> int:
        return self.values.shape[1]

    def of(self, towards: Float[Array, "... lights 3"]) -> "FarTable":
        return self

    def rows(self) -> Float[Array, "columns samples"]:
        return jnp.moveaxis(self.values, 1, 0).reshape(self.columns, -1)

    def at(self, pq: Float[Array, "n 2"]) -> Float[Array, "n columns lights"]:
        corners, u, v = self._cell(pq)
        return bilinear(corners, u, v)

    def with_slope(
        self, pq: Float[Array, "n 2"]
    ) -> tuple[Float[Array, "n columns lights"], Float[Array, "n 2 columns lights"]]:
        corners, u, v = self._cell(pq)
        slopes = jnp.stack(bilinear_slopes(corners, u, v), axis=1) * ((self.size - 1) / 2)
        return bilinear(corners, u, v), slopes

    def mixed(self, coefficients: Float[Array, "materials columns"]) -> "FarTable":
        values = matmul(coefficients, self.rows()).reshape(coefficients.shape[0], self.values.shape[0], -1)
        return FarTable(jnp.moveaxis(values, 0, 1), self.size)

    @eqx.filter_jit
    def best_node(self, values: Float[Array, "n lights"], trust: Float[Array, "n lights"]) -> Float[Array, "n 2"]:
        chosen, pq = coarse_nodes(self.size)
        rows = self.values[chosen]
        nodes, materials, lights = rows.shape
        products = (rows[:, :, None] * rows[:, None]).reshape(-1, lights).T
        flat = rows.reshape(-1, lights).T

        def best(pixel):
            values, trust = pixel
            gram = matmul(trust[None], products).reshape(nodes, materials, materials)
            moment = matmul((trust * values)[None], flat).reshape(nodes, materials)
            return jnp.argmax(non_negative_weights(gram, moment)[1])

        return jnp.asarray(pq, values.dtype)[jax.lax.map(best, (values, trust), batch_size=TOGETHER)]

    def _cell(self, pq: Array) -> tuple[list[Array], Array, Array]:
        """Rows at the corners (0, 0), (0, 1), (1, 0), (1, 1) of the cells that points lie in, and where in them."""
        place = (pq + 1) * ((self.size - 1) / 2)
        corner = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, self.size - 2)
        inside = place - corner.astype(place.dtype)
        first = corner[:, 0] * self.size + corner[:, 1]
        flat = self.values.reshape(self.values.shape[0], -1)  # one long row a node is copied six times as fast
        steps = (0, 1, self.size, self.size + 1)
        rows = [flat[first + step].reshape(-1, *self.values.shape[1:]) for step in steps]
        return rows, inside[:, :1, None], inside[:, 1:, None]


def lerp(a: Array, b: Array, share: Array) -> Array:
    """a where the share is 0, b where it is 1."""
    return a + share * (b - a)


def bilinear(corners: list[Array], u: Array, v: Array) -> Array:
    """Between the corners (0, 0), (0, 1), (1, 0), (1, 1) of a cell, at (u, v) in it."""
    return lerp(lerp(corners[0], corners[1], v), lerp(corners[2], corners[3], v), u)


def bilinear_slopes(corners: list[Array], u: Array, v: Array) -> tuple[Array, Array]:
    """The derivatives of `bilinear` in u and v."""
    along_u = lerp(corners[2], corners[3], v) - lerp(corners[0], corners[1], v)
    return along_u, lerp(corners[1] - corners[0], corners[3] - corners[2], u)


def shading_table(brdfs: Sequence[AbstractBRDF], directions: Float[Array, "lights 3"], size: int = SIZE) -> FarTable:
    """The table of all channels of some isotropic BRDFs, one after the other, for a view along +z.

    `directions`: towards the lights, in the world of the camera. In their dtype.
    """
    # Normals are an argument: as a constant the compiler evaluates what is done to them alone, for seconds.
    return FarTable(_under_each(tuple(brdfs), directions, jnp.asarray(grid(size)[0], directions.dtype)), size)


@eqx.filter_jit
def _under_each(brdfs, directions, normals) -> Float[Array, "nodes columns lights"]:
    view = jnp.asarray([0, 0, 1], directions.dtype)

    def under(direction):
        light = DirectionalLight(direction, jnp.ones((), directions.dtype))
        return jnp.concatenate([reflect(brdf, light, normals, view) for brdf in brdfs], axis=1)

    return jnp.moveaxis(jax.lax.map(under, directions), 0, 2)
