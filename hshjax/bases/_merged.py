"""Batches of `vmap` as more points, or channels, of one call: side by side, blocks would hold them all at once."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from hshjax._typing import Array

FEW = 256
"""Points from which on items are taken one by one, where coefficients and points differ from item to item."""


def merged(call: Callable[..., Array], mapped: tuple[bool, ...], coefficients: Array, w: Array) -> Array | None:
    """A batch of `call(coefficients, w)`, of `(modes, channels)` and `(points, 3)`; the result is `(points, channels,
    ...)`, point by point. See `operation`."""
    of_items, at_items = mapped
    if of_items and at_items:
        return None if w.shape[1] < FEW else jax.lax.map(lambda item: call(*item), (coefficients, w))
    if at_items:
        found = call(coefficients, w.reshape(-1, 3))
        return found.reshape(*w.shape[:2], *found.shape[1:])
    size, modes, channels = coefficients.shape
    found = call(jnp.moveaxis(coefficients, 0, 1).reshape(modes, size * channels), w)
    return jnp.moveaxis(found.reshape(w.shape[0], size, channels, *found.shape[2:]), 1, 0)


def merged_pairs(call: Callable[..., Array], mapped: tuple[bool, ...], *arrays: Array) -> Array | None:
    """The same of `call(*shared, wi, wo)`, `(pairs, 3)` each, where nothing of `shared` differs from item to item."""
    *shared, wi, wo = arrays
    *of_items, at_wi, at_wo = mapped
    if any(of_items):
        return None
    size = (wi if at_wi else wo).shape[0]
    whole = [w if each else jnp.broadcast_to(w, (size, *w.shape)) for w, each in ((wi, at_wi), (wo, at_wo))]
    found = call(*shared, *(w.reshape(-1, 3) for w in whole))
    return found.reshape(*whole[0].shape[:2], *found.shape[1:])
