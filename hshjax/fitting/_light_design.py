"""Least squares over the direction of the light, one problem for all pixels."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from hshjax._typing import Array, Float
from hshjax.bases import AbstractBasis
from hshjax.fitting._mesh import ALIKE, put
from hshjax.fitting._prior import Prior, check_kind, penalty_of


class LightDesign:
    """The functions of a basis at the lights, and the matrix that makes coefficients of values. Host arrays, float64.

    `rows` `(lights, functions)`, `operator` `(functions, lights)`, `weight` `(lights,)`, `condition` of the weighted
    design matrix, with the ridge.

    **Raises:** ValueError for lights that are not of unit length or below the horizon, for weights that are negative,
    not finite or all zero, and for lights that do not determine the functions.
    TypeError for a basis of pairs of directions.
    """

    def __init__(self, basis: AbstractBasis, lights, weight, ridge: float, prior: Prior | None):
        check_kind(basis, AbstractBasis, "functions of one direction, such as HSH(3)")
        lights = np.asarray(lights, np.float64)
        if lights.ndim != 2 or lights.shape[1] != 3:
            raise ValueError(f"lights must be directions (lights, 3), got {lights.shape}")
        bad = ~(np.abs(np.linalg.norm(lights, axis=1) - 1) < 1e-3)  # also where a component is NaN
        if bad.any():
            raise ValueError(f"light {np.argmax(bad)} is not of unit length: {lights[np.argmax(bad)]}")
        below = lights[:, 2] < -1e-6
        if basis.hemispherical and below.any():
            raise ValueError(
                f"light {np.argmax(below)} is below the horizon (z < 0), where {basis} has no functions: take "
                "SphericalHarmonics, or weight 0 and another direction"
            )
        self.weight = np.ones(len(lights)) if weight is None else np.asarray(weight, np.float64)
        if self.weight.shape != (len(lights),):
            raise ValueError(f"weight must have one number for each of {len(lights)} lights, got {self.weight.shape}")
        if not (np.all(self.weight >= 0) and np.all(np.isfinite(self.weight)) and self.weight.any()):
            raise ValueError("weights of lights must be finite, >= 0, and not all 0")
        with jax.enable_x64(True):
            self.rows = np.asarray(basis(jnp.asarray(lights)))
        gamma = penalty_of(basis.count, lambda: np.array([mode[:1] for mode in basis.modes]), ridge, prior)
        self._solve(basis, None if gamma is None else np.asarray(gamma, np.float64))

    def _solve(self, basis: AbstractBasis, gamma: np.ndarray | None) -> None:
        used, unknowns = int(np.sum(self.weight > 0)), basis.count
        if used < unknowns and gamma is None:
            raise ValueError(
                f"{used} lights do not determine the {unknowns} functions of {basis}: lower the order, add lights, or "
                "give a ridge > 0"
            )
        root = np.sqrt(self.weight)[:, None]
        weighted = root * self.rows
        if gamma is not None:
            weighted = np.concatenate([weighted, np.diag(np.sqrt(gamma))])
        # Few functions: the singular values tell the condition, and no square of it is formed.
        left, values, right = np.linalg.svd(weighted, full_matrices=False)
        self.condition = float(values[0] / values[-1]) if values[-1] > 0 else np.inf
        limit = 1 / (unknowns * np.finfo(np.float64).eps)
        if not self.condition < limit:
            raise ValueError(
                f"the lights do not determine the {unknowns} functions: condition number {self.condition:.1e}, more "
                f"than {limit:.1e}; lower the order, add lights in other directions, or give a larger ridge"
            )
        self.operator = (right.T / values) @ left[: len(root)].T * root.T


def fit_pixels(
    design: LightDesign, values: np.ndarray, mesh: Mesh | None
) -> tuple[np.ndarray, Float[np.ndarray, "2 channels"]]:
    """Coefficients `(pixels, functions, channels)` of values `(pixels, lights, channels)`, of some floating type; and
    Σ w |L - L̂|², Σ w |L|². With a flat mesh, every device takes its share."""
    pixels = len(values)
    parts = [part.astype(values.dtype) for part in (design.operator, design.rows, design.weight)]
    size = 1 << (pixels - 1).bit_length()  # a program is compiled for every size
    size += 0 if mesh is None else -size % mesh.size
    if size > pixels:
        values = np.concatenate([values, np.zeros((size - pixels, *values.shape[1:]), values.dtype)])
    if mesh is None:
        coefficients, sums = _fitted(*map(jnp.asarray, (*parts, values)))
    else:
        coefficients, sums = _fitted(*(put(part, mesh, ALIKE) for part in parts), put(values, mesh))
    return np.asarray(coefficients)[:pixels], np.asarray(sums, np.float64)[:, :pixels].sum(axis=1)


@jax.jit
def _fitted(
    operator: Float[Array, "functions lights"],
    rows: Float[Array, "lights functions"],
    weight: Float[Array, " lights"],
    values: Float[Array, "pixels lights channels"],
) -> tuple[Float[Array, "pixels functions channels"], Float[Array, "2 pixels channels"]]:
    """Coefficients, and the weighted squares of what is left and of what was given, by pixel."""
    values = jnp.where(weight[:, None] > 0, values, 0)  # where it is 0 they may be NaN
    coefficients = jnp.einsum("kl,plc->pkc", operator, values, precision="highest")
    left = values - jnp.einsum("lk,pkc->plc", rows, coefficients, precision="highest")
    sums = [jnp.einsum("l,plc->pc", weight, part**2, precision="highest") for part in (left, values)]
    return coefficients, jnp.stack(sums)
