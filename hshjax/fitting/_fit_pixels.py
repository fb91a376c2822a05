"""The pixels of a tile: those that all lights are known in by one matrix, the others by a factorisation each."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jax.sharding import Mesh

from hshjax._typing import Array, Bool, Float
from hshjax.fitting._light_design import LightDesign
from hshjax.fitting._mesh import ALIKE, SHARES, put

TOGETHER, NUMBERS = 512, 2**24
"""Pixels, on every device, that one call of the compiled program factorises at most, and numbers of their matrices: the
last call is filled up to as many."""


class TileFit(NamedTuple):
    """What was found in the pixels of a tile, on the host.

    - `coefficients` `(pixels, functions, channels)`, NaN in pixels that their lights do not determine.
    - `sums` `(2, channels)`: Σ w |L - L̂|² and Σ w |L|² over the lights that are known, of the other pixels.
    - `conditions` `(pixels,)`: condition numbers, an upper bound of those of pixels that lack a light; infinite where
      there are no coefficients. - `partial`: how many pixels lack a light.
    """

    coefficients: np.ndarray
    sums: Float[np.ndarray, "2 channels"]
    conditions: Float[np.ndarray, " pixels"]
    partial: int

    @property
    def undetermined(self) -> int:
        """How many pixels have no coefficients."""
        return int(np.sum(np.isinf(self.conditions)))


def fit_pixels(
    design: LightDesign,
    values: Float[np.ndarray, "pixels lights channels"],
    known: Bool[np.ndarray, "pixels lights"],
    mesh: Mesh | None,
) -> TileFit:
    """Every pixel by least squares over the lights that are `known` in it, in the dtype of the values, which may be
    anything elsewhere. With a flat mesh, every device takes its share of the pixels."""
    coefficients, sums = _by_all_lights(design, values, mesh)
    lacking = np.flatnonzero(~(known | (design.weight == 0)).all(axis=1))
    conditions = np.full(len(values), design.condition)
    lights, functions = design.rows.shape
    each = (lights + functions) * (functions + values.shape[2])
    step = max(1, min(TOGETHER, NUMBERS // each)) * (1 if mesh is None else mesh.size)
    for start in range(0, len(lacking), step):
        which = lacking[start : start + step]
        found = _by_their_own(design, values[which], known[which], step, mesh)
        coefficients[which], sums[:, which], conditions[which] = found
    return TileFit(coefficients, sums.sum(axis=1), conditions, len(lacking))


def _by_all_lights(
    design: LightDesign, values: np.ndarray, mesh: Mesh | None
) -> tuple[np.ndarray, Float[np.ndarray, "2 pixels channels"]]:
    """Coefficients, and the weighted squares of what is left and of what was given, by pixel."""
    pixels = len(values)
    parts = [part.astype(values.dtype) for part in (design.operator, design.rows, design.weight)]
    size = 1 << (pixels - 1).bit_length()  # a program is compiled for every size
    size += 0 if mesh is None else -size % mesh.size
    values = _filled(values, size)
    if mesh is None:
        found = _linear(*map(jnp.asarray, (*parts, values)))
    else:
        found = _linear(*(put(part, mesh, ALIKE) for part in parts), put(values, mesh))
    return np.array(found[0][:pixels]), np.array(found[1][:, :pixels], np.float64)


@jax.jit
def _linear(
    operator: Float[Array, "functions lights"],
    rows: Float[Array, "lights functions"],
    weight: Float[Array, " lights"],
    values: Float[Array, "pixels lights channels"],
) -> tuple[Float[Array, "pixels functions channels"], Float[Array, "2 pixels channels"]]:
    values = jnp.where(weight[:, None] > 0, values, 0)  # where it is 0 they may be NaN
    coefficients = jnp.einsum("kl,plc->pkc", operator, values, precision="highest")
    left = values - jnp.einsum("lk,pkc->plc", rows, coefficients, precision="highest")
    sums = [jnp.einsum("l,plc->pc", weight, part**2, precision="highest") for part in (left, values)]
    return coefficients, jnp.stack(sums)


def _by_their_own(
    design: LightDesign, values: np.ndarray, known: np.ndarray, size: int, mesh: Mesh | None
) -> tuple[np.ndarray, np.ndarray, Float[np.ndarray, " pixels"]]:
    """The same of pixels that lack a light, and their condition numbers: infinite where there are no coefficients."""
    pixels = len(values)
    parts = [part.astype(values.dtype) for part in (design.rows, design.weight)]
    parts += [] if design.gamma is None else [np.sqrt(design.gamma).astype(values.dtype)]
    each = [_filled(part, size) for part in (values, known)]
    if mesh is None:
        found = _factorised(None, [jnp.asarray(part) for part in parts], *map(jnp.asarray, each))
    else:
        found = _factorised(mesh, [put(part, mesh, ALIKE) for part in parts], *(put(part, mesh) for part in each))
    coefficients, sums, conditions = (np.asarray(part)[:pixels] for part in found)
    return coefficients, np.moveaxis(sums, 1, 0), conditions


def _filled(array: np.ndarray, size: int) -> np.ndarray:
    """Zeros after the pixels, up to so many."""
    lacking = size - len(array)
    return np.concatenate([array, np.zeros((lacking, *array.shape[1:]), array.dtype)]) if lacking else array


@partial(jax.jit, static_argnums=0)
def _factorised(
    mesh: Mesh | None,
    parts: list[Array],
    values: Float[Array, "pixels lights channels"],
    known: Bool[Array, "pixels lights"],
) -> tuple[Float[Array, "pixels functions channels"], Float[Array, "pixels 2 channels"], Float[Array, " pixels"]]:
    """By pixel, in equal shares of a flat mesh. `parts`: rows, weights, and with a ridge the root of its Γ."""

    def share(parts, values, known):
        return jax.vmap(partial(_one, *parts))(values, known)

    if mesh is None:
        return share(parts, values, known)
    return jax.shard_map(share, mesh=mesh, in_specs=(ALIKE, SHARES, SHARES), out_specs=SHARES, check_vma=False)(
        parts, values, known
    )


def _one(rows: Array, weight: Array, *rest: Array) -> tuple[Array, Array, Array]:
    """One pixel: R of [sqrt(w) Y, sqrt(w) L] over [sqrt(Γ), 0], as in `project`: no condition is squared."""
    *penalty, values, known = rest
    unknowns, channels = rows.shape[1], values.shape[1]
    weight = jnp.where(known, weight, 0)
    values = jnp.where(weight[:, None] > 0, values, 0)
    system = jnp.sqrt(weight)[:, None] * jnp.concatenate([rows, values], axis=1)
    needed = unknowns
    if penalty:
        system = jnp.concatenate([system, jnp.pad(jnp.diag(penalty[0]), ((0, 0), (0, channels)))])
        needed = 1
    factor = jnp.linalg.qr(system, mode="r")[:unknowns]
    root = factor[:, :unknowns]
    found = solve_triangular(root, jnp.concatenate([factor[:, unknowns:], jnp.eye(unknowns, dtype=root.dtype)], axis=1))
    coefficients, inverse = found[:, :channels], found[:, channels:]
    # In the Frobenius norm: above that of the 2-norm, at most as many times as there are functions.
    condition = jnp.linalg.norm(root) * jnp.linalg.norm(inverse)
    limit = 1 / (unknowns * float(jnp.finfo(root.dtype).eps))
    determined = (jnp.sum(weight > 0) >= needed) & (condition < limit)  # not where it is NaN
    left = values - jnp.matmul(rows, coefficients, precision="highest")
    sums = jnp.stack([jnp.einsum("l,lc->c", weight, part**2, precision="highest") for part in (left, values)])
    return (
        jnp.where(determined, coefficients, jnp.nan),
        jnp.where(determined, sums, 0),
        jnp.where(determined, condition, jnp.inf),
    )
