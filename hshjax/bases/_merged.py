"""Batches of `vmap` as more points, or channels, of one call: side by side, blocks would hold them all at once."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from hshjax._typing import Array

FEW = 256
"""Points from which on items are taken one by one, where coefficients and points differ from item to item."""


def merged(function: Callable[[Array, Array], Array]) -> Callable[[Array, Array], Array]:
    """`function(coefficients, w)` of `(modes, channels)` and `(points, 3)`, `(points, channels, ...)`, point by point.

    Values only: a function with this rule cannot be transposed.
    """
    run = custom_vmap(function)

    @run.def_vmap
    def _(size, batched, coefficients, w):
        of_items, at_items = batched
        if of_items and at_items:
            if w.shape[1] < FEW:
                return jax.vmap(function)(coefficients, w), True
            return jax.lax.map(lambda item: merged(function)(*item), (coefficients, w)), True
        if at_items:
            found = merged(function)(coefficients, w.reshape(size * w.shape[1], 3))
            return found.reshape(size, w.shape[1], *found.shape[1:]), True
        channels = coefficients.shape[2]
        beside = jnp.moveaxis(coefficients, 0, 1).reshape(-1, size * channels)
        found = merged(function)(beside, w)
        return jnp.moveaxis(found.reshape(w.shape[0], size, channels, *found.shape[2:]), 1, 0), True

    return run
