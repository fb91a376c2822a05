"""Bounded parameters: the boxes that a model's fields declare, and the free numbers that a smooth solver moves.

Solvers that keep boxes move the parameters themselves. For the others, and for derivatives of a fit, there is a chart:
a two-sided box is x = low + (high - low) (1 + sin u) / 2, a one-sided one x = low + sqrt(1 + u²) - 1: both reach the
bound itself at a finite u, with dx/du = 0 there, so that a fit can end on a bound and its derivative knows it.

Source: James & Roos, MINUIT, Computer Physics Communications 10, 1975, "transformation for parameters with limits".
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import DictKey, GetAttrKey, KeyPath, SequenceKey, keystr

from hshjax._typing import Array, Bool, Real

INSIDE = 1e-5
"""Where a start on a bound is moved to, as a share of the box: on it, dx/du = 0 would hold it there for ever."""

NEAR = {4: 3e-4, 8: 5e-7}
"""What counts as on the bound, as a share of the box, by the bytes of a float: where fits to a bound come to rest."""


class Box(NamedTuple):
    """The closed interval of a parameter and its name in the model; infinite ends bound nothing."""

    name: str
    low: float
    high: float

    @property
    def size(self) -> float:
        """Its width, or 1 where an end is infinite."""
        return self.high - self.low if self.bounded == 2 else 1.0

    @property
    def bounded(self) -> int:
        """How many ends are finite."""
        return math.isfinite(self.low) + math.isfinite(self.high)


def declared(model: Any) -> list[Box]:
    """The box of every leaf, in the order of `jax.tree.leaves`; that of the innermost field that declares bounds."""
    boxes = []
    for path, _ in jax.tree_util.tree_leaves_with_path(model):
        _, metadata = declaration(model, path)
        boxes.append(Box(path_name(path), *metadata.get("bounds", (-math.inf, math.inf))))
    return boxes


def declaration(model: Any, path: KeyPath) -> tuple[KeyPath, Mapping[str, Any]]:
    """The innermost field on a leaf's path that declares bounds: the path of the module it belongs to, its metadata.

    The path and an empty mapping where none does.
    """
    node, found = model, (path, {})
    for depth, key in enumerate(path):
        if isinstance(key, GetAttrKey):
            field = {f.name: f for f in dataclasses.fields(node)}.get(key.name)
            if field and "bounds" in field.metadata:
                found = path[:depth], field.metadata
            node = getattr(node, key.name)
        elif isinstance(key, SequenceKey):
            node = node[key.idx]
        elif isinstance(key, DictKey):
            node = node[key.key]
        else:  # a container of somebody else's, whose fields declare nothing
            break
    return found


def path_name(path: KeyPath) -> str:
    """A leaf's path as it is written in Python, `brdf.slope`."""
    return keystr(path).lstrip(".")


def to_bounded(u: Real, box: Box) -> Real:
    """The parameter that a free number stands for."""
    if box.bounded == 2:
        # Rounding may carry the end of the sine beyond the bound, where a second fit would not start.
        return jnp.clip(box.low + box.size / 2 * (1 + jnp.sin(u)), *_ends(u, box))
    rise = u * u / (1 + jnp.sqrt(1 + u * u))  # sqrt(1 + u²) - 1, without cancellation
    if math.isfinite(box.low):
        return box.low + rise
    return box.high - rise if box.bounded else u


def to_free(x: Real, box: Box, inside: float = INSIDE) -> Real:
    """The free number of a parameter that lies in its box, at least `inside` of the box from its ends; NaN for NaN."""
    if not box.bounded:
        return x
    margin = inside * box.size
    x = jnp.clip(x, box.low + margin, box.high - margin)
    if box.bounded == 2:
        return jnp.arcsin(jnp.clip(2 * (x - box.low) / box.size - 1, -1, 1))
    rise = x - box.low if math.isfinite(box.low) else box.high - x
    return jnp.sqrt(rise * (rise + 2))


def outside(x: Any, box: Box) -> Any:
    """Where a parameter is not in its box, for arrays of jax and of numpy.

    A bound that a float32 cannot hold is met by the float32 nearest to it.
    """
    low, high = _ends(x, box)
    return (x < low) | (x > high)


def pushed_out(x: Real, gradient: Real, low: Real, high: Real) -> Bool[Array, "..."]:
    """Where a parameter is on a bound, and a loss of this gradient would fall beyond it."""
    return ((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0))


def _ends(x: Any, box: Box) -> tuple[np.ndarray, np.ndarray]:
    """The bounds in the dtype of x."""
    return np.asarray(box.low, x.dtype), np.asarray(box.high, x.dtype)


def nan_outside(x: Real, box: Box) -> Real:
    """The parameter, or NaN where it is not in its box."""
    return jnp.where(outside(x, box), jnp.nan, x) if box.bounded else x


def on_bound(x: Real, box: Box) -> Bool[Array, "..."]:
    """Where a parameter has ended on a bound: nearer than an optimum inside could be told from one on it."""
    near = box.size * NEAR[x.dtype.itemsize]
    return (x - box.low <= near) | (box.high - x <= near)
