"""Eq. 1 in closed form: a series in spherical harmonics for the light, one in a pair basis for the BRDF, no quadrature.

With the light's coefficients ℓ in the local frame of a point, and h the functions of one direction of the BRDF,

    R = Σ_ab q_a A_ab h_b(wo) / z_o^p,   q = Mᵀ ℓ,   M_ja = ∫ Y_j h_a z^(1-p) dω over the hemisphere

where A is the BRDF's matrix and p the exponent of its target: 0 for the BRDF itself, 1 where its series holds the
cosines. M does at once what may be done in two steps, restriction to the hemisphere and the cosine (a tridiagonal
matrix in HSH).

A normal at azimuth φ and polar angle θ takes the light to ℓ = Jᵀ Z(θ) J Z(φ) c: Z turns about z, J is a quarter turn
about x (`hshjax.bases._rotation`). The outer parts are the same for all points:

1. J Z(φ) c is a trigonometric polynomial in φ, whose coefficients hold the light;
2. Z(θ) mixes pairs of entries;
3. Mᵀ Jᵀ, and for an isotropic BRDF A as well, make one more constant matrix, which holds the material.

So many points cost two products of large matrices with small ones, and some powers of unit complex numbers. Parity
takes most of the entries away: J exchanges even and odd in y with even and odd in z, and leaves x alone. The rest is
kept contiguous, in four groups.
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._special import blockwise
from hshjax._typing import Array, Float
from hshjax.bases import to_matrix
from hshjax.bases._base import matmul
from hshjax.bases._rotation import (
    EXACT,
    OBLIQUE,
    azimuthal,
    partners,
    powers_of,
    series_turned_by,
    spin,
    turn_by,
)
from hshjax.brdfs import LinearBRDF
from hshjax.geometry import azimuth, frame, meridian_frame, to_local
from hshjax.lighting import HarmonicLight
from hshjax.reflectance._harmonic_tables import (
    SOURCES,
    Problem,
    classes,
    grouped,
    layout,
    light_matrices,
    materials,
    restrictions,
)
from hshjax.reflectance._parts import products

BLOCK = 1024
"""Points a block unless the caller says otherwise: what order 8 makes of them stays in the second-level cache."""


@eqx.filter_jit
def harmonic_radiance(
    brdf: LinearBRDF, light: HarmonicLight, normal: Float[Array, "n 3"], view: Float[Array, "n 3"], block: int | None
) -> Float[Array, "n channels"]:
    """Radiance `(n, channels)` that leaves points towards `view`: of any order, under a light of any order."""
    problem = Problem.of(brdf, light.order)
    matrix = to_matrix(products(brdf), brdf.coefficients)
    coefficients, matrix = (a.astype(normal.dtype) for a in (light.coefficients, matrix))
    channels = jnp.broadcast_shapes(coefficients.shape[1:], matrix.shape[2:])
    coefficients = jnp.broadcast_to(coefficients, coefficients.shape[:1] + channels)
    matrix = jnp.broadcast_to(matrix, matrix.shape[:2] + channels)

    # In a world turned so that no normal is likely to meet its pole.
    oblique = jnp.asarray(turn_by(OBLIQUE).T, normal.dtype)
    series = jnp.asarray(series_turned_by(light.order, tuple(OBLIQUE)), normal.dtype)
    coefficients = matmul(series, coefficients)

    # Points without a surface, of zero normal and view, are black: what is computed for them counts nowhere.
    surface = jnp.any(normal != 0, axis=-1, keepdims=True)
    normal = jnp.where(surface, normal, jnp.asarray([[0, 0, 1]], normal.dtype))

    known = light_matrices(light.order, coefficients), materials(problem, matrix)

    # Recomputed, not stored, in reverse: what a block makes is much more than what it returns.
    @jax.checkpoint
    def of_block(known, normal, view):
        if problem.symmetry == "none":
            turn = matmul(frame(normal), oblique.T)
        else:
            turn = meridian_frame(matmul(normal, oblique.T))
        wo = to_local(turn, matmul(view, oblique.T))
        above = ~(wo[:, 2:] <= 0)  # NaN is not below: it stays NaN
        wo = jnp.where(above, wo, jnp.zeros_like(wo).at[:, 2].set(1))
        value = _sum(problem, known[0], known[1], turn, problem.basis(wo))
        if problem.exponent:
            value /= wo[:, 2:] ** problem.exponent
        return jnp.where(above, value, 0)

    return blockwise(partial(of_block, known), block or BLOCK, normal, view)


def _sum(problem: Problem, light: Any, material: Any, turn: Array, rows: Array) -> Float[Array, "points channels"]:
    """Σ_ab q_a A_ab h_b for points in frames `turn` `(points, 3, 3)`, with h_b in `rows` `(points, k)`."""
    groups = _turned_light(light, problem.order, turn[:, 2])
    if problem.symmetry == "none":
        product = jnp.einsum("cap,abc->cbp", _incident(problem, groups, turn), material, precision=EXACT)
        return jnp.einsum("cbp,pb->pc", product, rows, precision=EXACT)
    total = jnp.zeros((light[0].shape[0], rows.shape[0]), rows.dtype)
    for columns, sources, parts in zip(classes(problem.basis), SOURCES[problem.symmetry], material, strict=True):
        product = sum(
            jnp.einsum("cbi,cip->cbp", part, groups[source], precision=EXACT)
            for source, part in zip(sources, parts, strict=True)
        )
        # A sum over rows as a product with ones: the compiler's own takes five times as long.
        ones = jnp.ones(len(columns), rows.dtype)
        total += jnp.einsum("cbp,b->cp", product * rows.T[columns][None], ones, precision=EXACT)
    return total.T


def _turned_light(matrices: tuple[Array, Array], order: int, normal: Float[Array, "points 3"]) -> tuple:
    """Steps 1 and 2: the four groups, (channels, entries, points) each."""
    entries = layout(order)
    about_z = powers_of(*azimuth(normal), order + 1)
    about_y = powers_of(normal[:, 2], jnp.hypot(normal[:, 0], normal[:, 1]), order + 1)
    first, second = (
        jnp.einsum("cif,fp->cip", matrix, about_z[:, parity::2].reshape(-1, normal.shape[0]), precision=EXACT)
        for parity, matrix in enumerate(matrices)
    )
    cos, sin = (
        about_y[0][entries.k][None],
        (about_y[1][entries.k] * jnp.asarray(entries.sense, normal.dtype)[:, None])[None],
    )
    return grouped(entries, first * cos + second * sin, second * cos - first * sin)


def _incident(problem: Problem, groups: tuple, turn: Float[Array, "points 3 3"]) -> Float[Array, "channels k points"]:
    """Step 3 for a BRDF without symmetry: q, turned about the normal from the meridian's frame to the points' own."""
    parts = [
        jnp.einsum("bi,cip->cbp", part, group, precision=EXACT)
        for part, group in zip(restrictions(problem, turn.dtype), groups, strict=True)
    ]
    columns = np.argsort(np.concatenate(classes(problem.basis)))
    q = jnp.concatenate(parts, axis=1)[:, columns]
    m, _ = azimuthal(problem.basis)
    re, im = powers_of(*spin(turn), problem.basis.order + 1)[:, np.abs(m)]
    return q * re[None] + jnp.moveaxis(partners(problem.basis, jnp.moveaxis(q, 1, 0)), 0, 1) * im[None]
