"""The loss of a fit as a function of free numbers."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._typing import Array
from hshjax.fitting._bounds import Box, to_bounded
from hshjax.fitting._optimistix import half_square
from hshjax.fitting._terms import AbstractTerm, l1_weight


class Loss(eqx.Module):
    """Terms of a model, of which the leaves in `structure` move and the rest is `held`.

    A chart, one box for each moving leaf, says for which parameters the free numbers y stand: see `to_bounded`.
    """

    smooth: dict[str, AbstractTerm]
    sparse: dict[str, Array]
    held: Any
    structure: Any = eqx.field(static=True)

    def __init__(self, terms: dict[str, AbstractTerm], held: Any, structure: Any):
        weights = {name: l1_weight(term) for name, term in terms.items()}
        self.smooth = {name: term for name, term in terms.items() if weights[name] is None}
        self.sparse = {name: weight for name, weight in weights.items() if weight is not None}
        self.held, self.structure = held, structure

    def parameters(self, y: list[Array], chart: Sequence[Box]) -> list[Array]:
        """The leaves that y stands for."""
        # Behind a barrier, or XLA fuses the sine into the residuals and takes it once for every one of them.
        return jax.lax.optimization_barrier([to_bounded(u, box) for u, box in zip(y, chart, strict=True)])

    def model(self, leaves: list[Array]) -> Any:
        """The whole model."""
        return eqx.combine(jax.tree.unflatten(self.structure, leaves), self.held)

    def residuals(self, y: list[Array], chart: Sequence[Box]) -> dict[str, Any]:
        """Of the smooth terms."""
        model = self.model(self.parameters(y, chart))
        return {name: _floating(name, term(model)) for name, term in self.smooth.items()}

    def parts(self, y: list[Array], chart: Sequence[Box]) -> tuple[Array, dict[str, Array]]:
        """The smooth part of the loss, and every term's part by name."""
        found = {name: half_square(residual) for name, residual in self.residuals(y, chart).items()}
        size = jnp.stack([jnp.sum(jnp.abs(u)) for u in y]).sum()
        by_name = found | {name: weight.astype(size.dtype) * size for name, weight in self.sparse.items()}
        return sum(found.values(), start=jnp.zeros_like(size)), by_name


def _floating(name: str, residual: Any) -> Any:
    leaves = jax.tree.leaves(residual)
    if not leaves or not all(eqx.is_inexact_array(leaf) for leaf in leaves):
        raise ValueError(f"the term {name!r} must return floating arrays (its residual), got {residual!r}")
    return residual
