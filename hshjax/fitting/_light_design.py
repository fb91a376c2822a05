"""Least squares over the direction of the light, one problem for all pixels."""

import jax
import jax.numpy as jnp
import numpy as np

from hshjax.bases import AbstractBasis
from hshjax.fitting._prior import Prior, check_kind, penalty_of


class LightDesign:
    """The functions of a basis at the lights, and the matrix that makes coefficients of values. Host arrays, float64.

    `rows` `(lights, functions)`, `operator` `(functions, lights)`, `weight` `(lights,)`, `gamma` `(functions,)` or None
    without a ridge, `condition` of the weighted design matrix, with the ridge.

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
        self.gamma = None if gamma is None else np.asarray(gamma, np.float64)
        self._solve(basis)

    def _solve(self, basis: AbstractBasis) -> None:
        used, unknowns, gamma = int(np.sum(self.weight > 0)), basis.count, self.gamma
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
