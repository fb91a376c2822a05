"""Levenberg-Marquardt for residuals that outnumber the unknowns by far: the default solver of `fit`."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.flatten_util import ravel_pytree

from hshjax._typing import Array
from hshjax.bases._base import matmul

START = 1e-3
"""Damping of the first step, relative to the diagonal of JᵀJ."""


class LevenbergMarquardt(optx.AbstractGaussNewton):
    """(JᵀJ + λ diag JᵀJ) δ = -Jᵀr by a Cholesky factorisation, λ from 1e-3 on by the ratio of true to predicted gain.

    Unlike `optimistix.LevenbergMarquardt` it is invariant to the scale of the residuals and of each parameter, forms
    JᵀJ once for an accepted step however many dampings are tried, and factorises a matrix of unknowns x unknowns where
    the other takes the QR of all residuals. JᵀJ squares the condition number; the step that it blurs is damped, and
    the next gradient is exact again. In memory: the Jacobian, residuals x unknowns.

    - `rtol`, `atol`: a fit has converged when a step changes neither the parameters nor the loss by more.

    Source: Marquardt, An Algorithm for Least-Squares Estimation of Nonlinear Parameters, SIAM J. Appl. Math. 11(2),
    1963; cutoffs of the gain ratio as in `optimistix.ClassicalTrustRegion`.
    """

    rtol: float
    atol: float
    norm: Callable[[Any], Array]
    descent: optx.AbstractDescent
    search: optx.AbstractSearch
    verbose: Callable[..., None]

    def __init__(self, rtol: float, atol: float):
        self.rtol, self.atol, self.norm = rtol, atol, optx.max_norm
        self.descent = _DampedNormalEquations()
        self.search = optx.ClassicalTrustRegion(high_constant=10.0, low_constant=0.1)
        self.verbose = _silent


def _silent(**_: Any) -> None:
    pass


class _NormalEquations(eqx.Module):
    gram: Array
    gradient: Array


class _DampedNormalEquations(optx.AbstractDescent):
    """The step of damping λ = START / step size."""

    def init(self, y, f_info_struct):
        flat = ravel_pytree(y)[0]
        return _NormalEquations(jnp.zeros((flat.size, flat.size), flat.dtype), flat), y

    def query(self, y, f_info, state):
        flat, unravel = ravel_pytree(y)
        residual = ravel_pytree(f_info.residual)[0]
        # Row by row the transpose of J, as the products come: no copy of it in another layout.
        transposed = jax.vmap(lambda unit: ravel_pytree(f_info.jac.mv(unravel(unit)))[0])(
            jnp.eye(flat.size, dtype=flat.dtype)
        )
        return _NormalEquations(matmul(transposed, transposed.T), matmul(transposed, residual)), y

    def step(self, step_size, state):
        equations, y = state
        gram = equations.gram
        diagonal = jnp.diagonal(gram)
        largest = jnp.max(diagonal)
        # What the residuals do not see (a parameter on its bound) stays where it is, at the price of rounding.
        scale = jnp.where(diagonal > 0, diagonal, jnp.where(largest > 0, largest, 1))
        unit = jnp.sqrt(scale)
        # Below rounding no damping keeps a singular matrix factorisable.
        rounding = gram.shape[0] * jnp.finfo(gram.dtype).eps
        damping = jnp.maximum(START / step_size, rounding)
        matrix = gram / (unit[:, None] * unit[None]) + damping.astype(gram.dtype) * jnp.eye(
            gram.shape[0], dtype=gram.dtype
        )
        solved = jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(matrix), equations.gradient / unit)
        delta = ravel_pytree(y)[1](-solved / unit)
        finite = jnp.all(jnp.isfinite(solved))
        return delta, optx.RESULTS.where(finite, optx.RESULTS.successful, optx.RESULTS.nonfinite)
