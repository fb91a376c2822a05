"""Shading where each pixel has light and view from directions of its own: one table over the light's angle to the view.

About the view an isotropic BRDF is the same all round: with the normal turned until the light lies in the plane q = 0,
shading depends on the normal and on that one angle. Every light of every pixel reads the same table.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, Int
from hshjax.bases._base import matmul
from hshjax.brdfs import AbstractBRDF
from hshjax.geometry import angles, azimuth
from hshjax.stereo._chart import coarse_nodes
from hshjax.stereo._refine import weigh
from hshjax.stereo._shading import (
    SIZE,
    AbstractShadingTable,
    AbstractShadingTables,
    bilinear,
    bilinear_slopes,
    lerp,
    shading_table,
)

ANGLES = 64
"""Nodes over [0, π], 2.9 degrees apart: a highlight moves by half of that, as between nodes of the chart."""


class NearTables(AbstractShadingTables):
    """Shading under a light at any angle to the view.

    - `values` `(angles, size², columns)`: at nodes of the angle, evenly over [0, π], and of `grid(size)`, the light in
      the plane q = 0, at p >= 0.
    - `share` `(angles,)`: how many of the lights of all pixels are near each node; their sum is 1.
    """

    values: Float[Array, "angles nodes columns"]
    share: Float[Array, " angles"]
    size: int = eqx.field(static=True)

    @property
    def dtype(self) -> Any:
        return self.values.dtype

    @property
    def columns(self) -> int:
        return self.values.shape[2]

    def mixed(self, coefficients: Float[Array, "materials columns"]) -> "NearTables":
        return NearTables(matmul(self.values, coefficients.T), self.share, self.size)

    def rows(self) -> Float[Array, "columns samples"]:
        # Sums of products are those over the lights that there are; their number is that of samples, as if each angle
        # were met as often.
        weighted = jnp.sqrt(self.share * self.share.size)[:, None, None] * self.values
        return jnp.moveaxis(weighted, 2, 0).reshape(self.columns, -1)

    def of(self, towards: Float[Array, "n lights 3"]) -> "NearTable":
        node, above = _angle_place(towards, len(self.share))
        return NearTable(self, node, above, jnp.stack(azimuth(towards), axis=-1))


class NearTable(AbstractShadingTable):
    """Shading of some pixels, each under lights of its own.

    - `node` and `above` `(n, lights)`: the node below the light's angle, and how far above it, in steps.
    - `turn` `(n, lights, 2)`: cosine and sine of the light's azimuth about the view.
    """

    tables: NearTables
    node: Int[Array, "n lights"]
    above: Float[Array, "n lights"]
    turn: Float[Array, "n lights 2"]

    @property
    def dtype(self) -> Any:
        return self.tables.dtype

    @property
    def columns(self) -> int:
        return self.tables.columns

    def mixed(self, coefficients: Float[Array, "materials columns"]) -> "NearTable":
        return NearTable(self.tables.mixed(coefficients), self.node, self.above, self.turn)

    def rows(self) -> Float[Array, "columns samples"]:
        return self.tables.rows()

    def of(self, towards: Float[Array, "n lights 3"]) -> "NearTable":
        return self.tables.of(towards)

    def at(self, pq: Float[Array, "n 2"]) -> Float[Array, "n columns lights"]:
        corners, u, v = self._cell(pq)
        return _last(bilinear(corners, u, v))

    def with_slope(
        self, pq: Float[Array, "n 2"]
    ) -> tuple[Float[Array, "n columns lights"], Float[Array, "n 2 columns lights"]]:
        corners, u, v = self._cell(pq)
        cells = (self.tables.size - 1) / 2
        along, across = (slope * cells for slope in bilinear_slopes(corners, u, v))
        cos, sin = self.turn[..., :1], self.turn[..., 1:]
        slopes = [_last(cos * along - sin * across), _last(sin * along + cos * across)]
        return _last(bilinear(corners, u, v)), jnp.stack(slopes, axis=1)

    @eqx.filter_jit
    def best_node(self, values: Float[Array, "n lights"], trust: Float[Array, "n lights"]) -> Float[Array, "n 2"]:
        # Every pixel has shading of its own: node by node.
        def look(best, node):
            at = jnp.broadcast_to(node, best[1].shape)
            _, cost = weigh(self.at(at), values, trust)
            better = cost < best[0]
            return (jnp.where(better, cost, best[0]), jnp.where(better[:, None], at, best[1])), None

        nodes = jnp.asarray(coarse_nodes(self.tables.size)[1], values.dtype)
        begin = jnp.full_like(values[:, 0], jnp.inf), jnp.zeros((len(values), 2), values.dtype)
        return jax.lax.scan(look, begin, nodes)[0][1]

    def _cell(self, pq: Array) -> tuple[list[Array], Array, Array]:
        """Values `(n, lights, columns)` at the corners (0, 0), (0, 1), (1, 0), (1, 1) of cells, and where in them."""
        size, (cos, sin) = self.tables.size, jnp.moveaxis(self.turn, -1, 0)
        along, across = cos * pq[:, :1] + sin * pq[:, 1:], cos * pq[:, 1:] - sin * pq[:, :1]
        place = (jnp.stack([along, across]) + 1) * ((size - 1) / 2)
        corner = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, size - 2)
        u, v = (place - corner.astype(place.dtype))[..., None]
        first = (self.node * size + corner[0]) * size + corner[1]
        flat = self.tables.values.reshape(-1, self.columns)
        layers = [[flat[first + above + step] for above in (0, size * size)] for step in (0, 1, size, size + 1)]
        return [lerp(low, high, self.above[..., None]) for low, high in layers], u, v


def near_tables(brdfs: Sequence[AbstractBRDF], share: Float[Array, " angles"], size: int = SIZE) -> NearTables:
    """The tables of all channels of some isotropic BRDFs, one after the other, in the dtype of `share`."""
    theta = np.linspace(0, np.pi, len(share))
    lights = jnp.asarray(np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=1), share.dtype)
    return NearTables(jnp.transpose(shading_table(brdfs, lights, size).values, (2, 0, 1)), share, size)


def angle_shares(towards: Float[Array, "n lights 3"]) -> Float[Array, " angles"]:
    """How many of some lights are near each of `ANGLES` nodes, as linear interpolation reads them; their sum is 1."""
    node, above = _angle_place(towards, ANGLES)
    count = jnp.zeros(ANGLES, towards.dtype).at[node].add(1 - above).at[node + 1].add(above)
    return count / jnp.sum(count)


@eqx.filter_jit
def _angle_place(towards: Array, count: int) -> tuple[Array, Array]:
    place = angles(towards)[0] * ((count - 1) / np.pi)
    node = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, count - 2)
    return node, place - node.astype(place.dtype)


def _last(values: Float[Array, "n lights columns"]) -> Float[Array, "n columns lights"]:
    return jnp.swapaxes(values, 1, 2)
