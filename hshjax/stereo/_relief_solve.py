"""The nearest minimum of `ReliefEnergy`: Levenberg-Marquardt, each step by a sparse factorisation.

Steps are damped by how much normals turn, not by how much heights move: near the horizon a large step of the one is a
small one of the other.
"""

from typing import Any

import numpy as np

from hshjax._typing import Float
from hshjax.stereo._relief_energy import Equations, ReliefEnergy, State, Weights

SETTLED = 1e-4
"""Relative decrease of the energy that ends it."""

STEPS = 40

FIRST, LEAST, MOST = 1e-3, 1e-7, 1e4
"""Damping."""

RIDGE = 1e-9
"""Of the mean of the diagonal, for what slopes do not tell: a constant, and the pattern of a chess-board."""

FARTHEST = 0.3
"""Step of the logarithm of the scale."""


def nearest_minimum(energy: ReliefEnergy, state: State, weights: Weights, scaled: bool) -> tuple[State, int]:
    """The state at a minimum near another one, and how many steps it took. - `scaled`: whether the scale moves."""
    damping, steps = FIRST, 0
    equations = energy.equations(state, weights)
    while steps < STEPS and damping <= MOST:
        steps += 1
        move, change = _step(equations, damping, scaled)
        tried = energy.at(state.heights + move, state.scale + change, weights)
        if not tried.energy < state.energy:  # nor where it is not a number
            damping *= 8
            continue
        settled = state.energy - tried.energy < SETTLED * tried.energy
        state, damping = tried, max(damping / 5, LEAST)
        if settled:
            break
        equations = energy.equations(state, weights)
    return state, steps


def _step(equations: Equations, damping: float, scaled: bool) -> tuple[Float[np.ndarray, " corners"], float]:
    """Of heights and of the scale, which is one row and column more."""
    from scipy import sparse

    matrix = equations.matrix + damping * equations.metric
    ridge = RIDGE * np.mean(matrix.diagonal()) + np.finfo(float).tiny
    factor = factored(matrix + ridge * sparse.eye_array(matrix.shape[0]))
    move = -factor.solve(equations.gradient)
    if not scaled:
        return move, 0.0
    along = factor.solve(equations.coupling)
    square = (1 + damping) * equations.scale_square - equations.coupling @ along
    change = -(equations.scale_gradient + equations.coupling @ move) / square if square > 0 else 0.0
    change = float(np.clip(change, -FARTHEST, FARTHEST))
    return move - change * along, change


def factored(matrix: Any) -> Any:
    """The factors of a sparse matrix that is symmetric and positive definite, so that no pivots are looked for."""
    from scipy import sparse
    from scipy.sparse.linalg import splu

    symmetric = {"SymmetricMode": True}
    return splu(sparse.csc_array(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
