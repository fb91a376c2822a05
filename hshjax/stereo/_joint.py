"""Unknowns of a joint refinement, in coordinates that make a gradient's steps good ones, and what is asked of them.

What pixels share (BRDF, lights) and what each has of its own (its normal) move at once, by `hshjax.fit`. Weights of
materials are no unknowns: the best ones for everything else are found in closed form, pixel by pixel (variable
projection), and by the envelope theorem the gradient is exact with them held. Eq. 1 is `hshjax.reflect`.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from hshjax._typing import Array, Float
from hshjax.bases._base import matmul
from hshjax.brdfs import AbstractBRDF
from hshjax.fitting import AbstractTerm
from hshjax.fitting._bounds import Box, declared
from hshjax.stereo._chart import grid, to_chart
from hshjax.stereo._refine import normal_equations, weigh
from hshjax.stereo._rendered import Rendered

RIDGE = 1e-5
"""Of coordinates, relative to their largest: combinations that photographs hardly tell of move no farther."""

WALL = 10.0
"""Of bounds: a number that is outside by a tenth of what photographs leave open counts as much as noise."""

LEAST = 400.0
"""Added to Hessians by normals where they are inverted, and nowhere else: steps of what photographs say nothing of are
those of a normal that is known to a twentieth of the chart's radius."""


class Unknowns(eqx.Module):
    """Free numbers of order 1, 0 at the start; see `Coordinates`.

    - `normals` `(n, 2)`. - `brdf` `(numbers,)`. - `lights` `(lights, 3)`: two turns and the gain of each.
    """

    normals: Float[Array, "n 2"]
    brdf: Float[Array, " numbers"]
    lights: Float[Array, "lights 3"]


class Material(eqx.Module):
    """A BRDF as the numbers y of its parameters that move, one after the other, and what bounds them."""

    moving: Any
    held: Any
    boxes: tuple[Box, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, brdf: AbstractBRDF, chosen: Any) -> "Material":
        """`chosen`: the tree of the BRDF with True where a number moves; False: none does."""
        moving, held = eqx.partition(brdf, chosen)
        return cls(moving, held, tuple(declared(moving)))

    @property
    def start(self) -> Float[Array, " numbers"]:
        """The numbers of the BRDF as it is."""
        leaves = jax.tree.leaves(self.moving)
        return ravel_pytree(leaves)[0] if leaves else jnp.zeros(0)

    @property
    def bounds(self) -> tuple[Float[Array, " numbers"], Float[Array, " numbers"]]:
        """Least and largest values that numbers may have, infinite where they are free."""
        leaves = jax.tree.leaves(self.moving)
        ends = zip(*((box.low, box.high) for box in self.boxes), strict=True) if leaves else ((), ())
        return tuple(  # type: ignore[return-value]
            jnp.concatenate([jnp.zeros(0, self.start.dtype), *map(jnp.ravel, map(jnp.full_like, leaves, end))])
            for end in ends
        )

    def at(self, y: Float[Array, " numbers"]) -> AbstractBRDF:
        """The BRDF of some numbers."""
        leaves, structure = jax.tree.flatten(self.moving)
        moved = ravel_pytree(leaves)[1](y) if leaves else []
        return eqx.combine(jax.tree.unflatten(structure, moved), self.held)


class Coordinates(eqx.Module):
    """What the free numbers u, v, l of `Unknowns` stand for, such that the data's Hessian is near the identity.

        y = y0 + C v,   (p, q) = (p, q)0 + A u - B C v
        direction = d + s_1 l_1 t_1 + s_2 l_2 t_2,   gain = e^(s_3 l_3)

    B is how normals answer to the BRDF to first order: without it the two would pull against each other at every step.

    - `pq` `(n, 2)`, `own` A `(n, 2, 2)`, `response` B `(n, 2, numbers)`. - `y` `(numbers,)`, `mix` C.
    - `directions` `(lights, 3)`, `across` `(lights, 2, 3)` their tangents, `scale` s `(lights, 3)`.
    """

    material: Material
    y: Float[Array, " numbers"]
    mix: Float[Array, "numbers numbers"]
    pq: Float[Array, "n 2"]
    own: Float[Array, "n 2 2"]
    response: Float[Array, "n 2 numbers"]
    directions: Float[Array, "lights 3"]
    across: Float[Array, "lights 2 3"]
    gains: Float[Array, " lights"]
    scale: Float[Array, "lights 3"]

    def numbers(self, unknowns: Unknowns) -> Float[Array, " numbers"]:
        """Those of the BRDF, y."""
        return self.y + matmul(self.mix, unknowns.brdf)

    def normals(self, unknowns: Unknowns) -> Float[Array, "n 2"]:
        """Normals in the chart."""
        moved = jnp.einsum("nij,nj->ni", self.own, unknowns.normals)
        answer = jnp.einsum("nim,m->ni", self.response, matmul(self.mix, unknowns.brdf))
        return self.pq + moved - answer

    def turns(self, unknowns: Unknowns) -> Float[Array, "lights 3"]:
        """Two turns [radians] and the logarithm of the gain of each light, since the start of this round."""
        return self.scale * unknowns.lights

    def shading(self, unknowns: Unknowns) -> Rendered:
        """Eq. 1 with all that is shared."""
        turns = self.turns(unknowns)
        directions = self.directions + jnp.einsum("lk,lka->la", turns[:, :2], self.across)
        gains = jnp.exp(self.gains + turns[:, 2])
        return Rendered(self.material.at(self.numbers(unknowns)), directions, gains)


class Photometric(AbstractTerm):
    """sqrt(trust) (values - Σ_k w_k shading_k), with the w >= 0 that make its square least. Its gradient is that with w
    held; derivatives of higher order are not right.

    - `values`, `trust` `(n, lights)`: relative to brightness; trust over the variance of the noise.
    """

    values: Float[Array, "n lights"]
    trust: Float[Array, "n lights"]
    coordinates: Coordinates

    def __call__(self, model: Unknowns):
        shading = self.coordinates.shading(model).at(self.coordinates.normals(model))
        held = jax.lax.stop_gradient(shading)
        weights, _ = weigh(held, self.values, self.trust)
        return jnp.sqrt(self.trust) * (self.values - jnp.sum(weights[..., None] * shading, axis=1))


class NearMaterial(AbstractTerm):
    """Shading of materials less that of the start, over normals of a grid: as a prior on values, not on parameters.

    - `pq` `(nodes, 2)`. - `start` `(nodes, materials, lights)`, under lights of these `directions`. - `strength`
      `(materials,)`: for the sum of squares.
    """

    pq: Float[Array, "nodes 2"]
    start: Float[Array, "nodes materials lights"]
    strength: Float[Array, " materials"]
    directions: Float[Array, "lights 3"]
    coordinates: Coordinates

    def __call__(self, model: Unknowns):
        return self.of(self.coordinates.material.at(self.coordinates.numbers(model)))

    def of(self, brdf: AbstractBRDF) -> Float[Array, "nodes materials lights"]:
        """The residual of a BRDF."""
        change = Rendered(brdf, self.directions, jnp.ones_like(self.directions[:, 0])).at(self.pq) - self.start
        return jnp.sqrt(self.strength)[None, :, None] * change


class InBounds(AbstractTerm):
    """How far numbers of the BRDF are outside of their bounds, over a part of how far they move: a bound that gives way
    a little while a fit goes on. Charts that never leave a box have no slope on its sides, where many numbers are."""

    coordinates: Coordinates

    def __call__(self, model: Unknowns):
        low, high = self.coordinates.material.bounds
        y = self.coordinates.numbers(model)
        size = jnp.sqrt(jnp.sum(self.coordinates.mix**2, axis=1))
        return WALL * (jnp.minimum(y - low, 0) + jnp.maximum(y - high, 0)) / size


class NearNormals(AbstractTerm):
    """Moves of normals since the start `pq` over what the data alone would leave open: root (n, 2, 2) of the data's
    Hessian times a stiffness (`root_of`)."""

    pq: Float[Array, "n 2"]
    root: Float[Array, "n 2 2"]
    coordinates: Coordinates

    def __call__(self, model: Unknowns):
        return jnp.einsum("nji,nj->ni", self.root, self.coordinates.normals(model) - self.pq)


class NearLights(AbstractTerm):
    """Turns and logarithms of gains since the start.

    - `before` `(lights, 3)`: in earlier rounds. - `strength` `(3,)`: for the sum of squares.
    """

    before: Float[Array, "lights 3"]
    strength: Float[Array, " 3"]
    coordinates: Coordinates

    def __call__(self, model: Unknowns):
        return jnp.sqrt(self.strength)[None] * (self.before + self.coordinates.turns(model))


def nodes(size: int) -> Float[np.ndarray, "nodes 2"]:
    """The chart's nodes of a grid that see the camera."""
    normals, inside = grid(size)
    return np.asarray(to_chart(jnp.asarray(normals[inside])), np.float32)


class Slopes(eqx.Module):
    """First derivatives of what is predicted of some pixels, and the weights that are held for them.

    - `shading` `(n, materials, lights)`, `turned` `(n, 2, materials, lights)`: by the normal. - `weights`.
    - `numbers` `(n, numbers, lights)`: by the free numbers of the BRDF.
    """

    shading: Float[Array, "n materials lights"]
    turned: Float[Array, "n 2 materials lights"]
    weights: Float[Array, "n materials"]
    numbers: Float[Array, "n numbers lights"]


@eqx.filter_jit
def slopes_at(
    material: Material, y: Array, rendered: Rendered, pq: Float[Array, "n 2"], values: Array, trust: Array
) -> Slopes:
    """Of a material of numbers y, whose BRDF `rendered` holds; weights are the best ones."""
    shading, turned = rendered.with_slope(pq)
    weights, _ = weigh(shading, values, trust)

    def predicted(y):
        changed = Rendered(material.at(y), rendered.directions, rendered.gains)
        return jnp.sum(weights[..., None] * changed.at(pq), axis=1)

    def along(axis):
        return jax.jvp(predicted, (y,), (axis,))[1]

    by_number = jax.lax.map(along, jnp.eye(y.size, dtype=y.dtype)) if y.size else jnp.zeros((0, *values.shape), y.dtype)
    return Slopes(shading, turned, weights, jnp.moveaxis(by_number, 0, 1))


@eqx.filter_jit
def of_normals(slopes: Slopes, trust: Float[Array, "n lights"]) -> Float[Array, "n 2 2"]:
    """The data's Hessian by the normals, weights projected out: of what photographs say nothing of, singular."""
    nothing = jnp.zeros_like(trust)
    return normal_equations(slopes.shading, slopes.turned, slopes.weights, nothing, trust)[0]


@eqx.filter_jit
def root_of(hessian: Float[Array, "n 2 2"]) -> Float[Array, "n 2 2"]:
    """A root R of a Hessian that may be singular: R Rᵀ is the Hessian."""
    values, vectors = jnp.linalg.eigh(hessian)
    return vectors * jnp.sqrt(jnp.maximum(values, 0))[:, None]  # below 0 by rounding alone


@eqx.filter_jit
def whitening(hessian: Float[Array, "n 2 2"]) -> Float[Array, "n 2 2"]:
    """A of `Coordinates`: A Aᵀ is the inverse of the Hessian, with `LEAST` added."""
    factor = jnp.linalg.cholesky(hessian + LEAST * jnp.eye(2, dtype=hessian.dtype)[None])
    return jnp.swapaxes(jnp.linalg.inv(factor), 1, 2)


@eqx.filter_jit
def of_numbers(
    slopes: Slopes,
    trust: Float[Array, "n lights"],
    normals: Float[Array, "n 2 2"] | None,
    prior: Float[Array, "numbers numbers"],
) -> tuple[Float[Array, "numbers numbers"], Float[Array, "n 2 numbers"]]:
    """C and B of `Coordinates`: the inverse root of the Hessian by the numbers of the BRDF, all that pixels have of
    their own projected out, and how normals answer. `normals`: the root of what holds them; None: they do not move."""
    turned = jnp.sum(slopes.weights[:, None, :, None] * slopes.turned, axis=2)
    own = jnp.concatenate([slopes.shading, turned], axis=1)
    active = jnp.concatenate([slopes.weights > 0, jnp.full((len(turned), 2), normals is not None)], axis=1)
    weighted = trust[:, None] * own
    unit = jnp.eye(own.shape[1], dtype=trust.dtype)[None]
    gram = jnp.where(active[:, :, None] & active[:, None], matmul(weighted, jnp.swapaxes(own, 1, 2)), unit)
    if normals is not None:
        held = matmul(normals, jnp.swapaxes(normals, 1, 2)) + LEAST * jnp.eye(2, dtype=trust.dtype)[None]
        gram = gram.at[:, -2:, -2:].add(held)
    gram = gram + (1e-4 * jnp.diagonal(gram, axis1=1, axis2=2)[..., None] + 1e-6) * unit
    coupling = matmul(weighted, jnp.swapaxes(slopes.numbers, 1, 2))
    coupling = jnp.where(active[..., None], coupling, 0)
    response = jnp.linalg.solve(gram, coupling)
    hessian = jnp.einsum("ngl,nhl->gh", trust[:, None] * slopes.numbers, slopes.numbers)
    hessian = hessian - jnp.einsum("nag,nah->gh", coupling, response) + prior
    if not len(hessian):
        return hessian, response[:, -2:]
    scale = 1 / jnp.sqrt(jnp.maximum(jnp.diagonal(hessian), jnp.finfo(trust.dtype).tiny))
    # Scaled, so that the ridge means the same for all; rounding may leave tiny negative eigenvalues.
    values, vectors = jnp.linalg.eigh(scale[:, None] * hessian * scale[None])
    root = 1 / jnp.sqrt(jnp.maximum(values, 0) + RIDGE * values[-1])
    return scale[:, None] * vectors * root[None], response[:, -2:]


@eqx.filter_jit
def of_prior(
    material: Material, y: Float[Array, " numbers"], rendered: Rendered, pq: Float[Array, "nodes 2"],
    strength: Float[Array, " materials"],
) -> Float[Array, "numbers numbers"]:  # fmt: skip
    """The Hessian of `NearMaterial` by the numbers of the BRDF."""

    def shading(y):
        at = Rendered(material.at(y), rendered.directions, rendered.gains).at(pq)
        return jnp.sqrt(strength)[None, :, None] * at

    if not y.size:
        return jnp.zeros((0, 0), y.dtype)
    rows = jax.lax.map(lambda axis: jax.jvp(shading, (y,), (axis,))[1].ravel(), jnp.eye(y.size, dtype=y.dtype))
    return matmul(rows, rows.T)


@eqx.filter_jit
def of_lights(
    slopes: Slopes, trust: Float[Array, "n lights"], rendered: Rendered, pq: Float[Array, "n 2"],
    across: Float[Array, "lights 2 3"], strength: Float[Array, " 3"],
) -> Float[Array, "lights 3"]:  # fmt: skip
    """The scales s of `Coordinates`: roots of the inverse of the Hessian's diagonal."""

    def predicted(directions):
        changed = Rendered(rendered.brdf, directions, rendered.gains)
        return jnp.sum(slopes.weights[..., None] * changed.at(pq), axis=1)

    turned = [jax.jvp(predicted, (rendered.directions,), (across[:, k],))[1] for k in range(2)]
    brighter = jnp.sum(slopes.weights[..., None] * slopes.shading, axis=1)
    told = jnp.stack([jnp.sum(trust * slope**2, axis=0) for slope in (*turned, brighter)], axis=1)
    return 1 / jnp.sqrt(told + strength[None])
