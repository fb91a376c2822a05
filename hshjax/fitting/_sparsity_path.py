"""From no coefficient to all of them: L1 fits along a path of weights, each from the one before."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.fitting._fit import chosen, default_tolerance, fit
from hshjax.fitting._jaxopt import Jaxopt
from hshjax.fitting._optimistix import half_square
from hshjax.fitting._result import IterativeFit, Model
from hshjax.fitting._terms import AbstractTerm, Sparsity

NAME = "sparsity"
"""Of the L1 term among the losses of a fit of the path."""


def sparsity_path(
    model: Model,
    objective: Mapping[str, AbstractTerm],
    weights: Sequence[float],
    solver: Jaxopt | None = None,
    *,
    trainable: Any = None,
    max_steps: int = 2000,
    throw: bool = True,
) -> list[IterativeFit[Model]]:
    """`fit` with the further term weight x Σ|c| for every weight, each started where the one before ended.

    - `weights`: decreasing, from about `largest_sparsity_weight` on, where nothing is left but 0.
    - `solver`: `Jaxopt(jaxopt.ProximalGradient, ...)`; by default with the tolerance 1e-8 in float64, 1e-4 in float32.
    - `model`, `objective`, `trainable`, `max_steps`, `throw`: see `fit`.

    **Raises:** ValueError for weights that are not decreasing and >= 0, and what `fit` raises.
    """
    weights = [float(weight) for weight in weights]
    if not weights or any(a < b for a, b in pairwise(weights)) or weights[-1] < 0:
        raise ValueError(
            f"weights must be decreasing and >= 0, so that each fit starts near its optimum, got {weights}"
        )
    if solver is None:
        import jaxopt

        solver = Jaxopt(jaxopt.ProximalGradient, tol=default_tolerance(eqx.filter(model, chosen(model, trainable))))
    path = []
    for weight in weights:
        terms = {**objective, NAME: weight * Sparsity()}
        path.append(fit(model, terms, solver, trainable=trainable, max_steps=max_steps, throw=throw))
        model = path[-1].model
    return path


def largest_sparsity_weight(
    model: eqx.Module, objective: Mapping[str, AbstractTerm], *, trainable: Any = None
) -> Float[Array, ""]:
    """The smallest weight of `Sparsity` at which all trainable numbers are 0 in the optimum, for a convex objective.

    max |∂loss/∂c| at c = 0 (Osborne, Presnell, Turlach, On the LASSO and its Dual, JCGS 9(2), 2000).
    """
    free, held = eqx.partition(model, chosen(model, trainable))

    def loss(free):
        whole = eqx.combine(free, held)
        return sum((half_square(term(whole)) for term in objective.values()), start=0.0)

    gradient = jax.grad(loss)(jax.tree.map(jnp.zeros_like, free))
    return jnp.max(jnp.stack([jnp.max(jnp.abs(leaf)) for leaf in jax.tree.leaves(gradient)]))
