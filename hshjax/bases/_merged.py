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


def merged_pairs(function: Callable) -> Callable:
    """The same for `function(shared, wi, wo)` of `(pairs, 3)` each, where `shared`, any tree, is that of all items."""
    run = custom_vmap(function)

    @run.def_vmap
    def _(size, batched, shared, wi, wo):
        of_items, *at_items = batched
        if any(jax.tree.leaves(of_items)):
            axes = jax.tree.map(lambda differs: 0 if differs else None, batched)
            return jax.vmap(function, axes)(shared, wi, wo), True
        whole = [
            w if each else jnp.broadcast_to(w, (size, *w.shape)) for w, each in zip((wi, wo), at_items, strict=True)
        ]
        found = merged_pairs(function)(shared, *(w.reshape(size * w.shape[1], 3) for w in whole))
        return found.reshape(size, whole[0].shape[1], *found.shape[1:]), True

    return run
