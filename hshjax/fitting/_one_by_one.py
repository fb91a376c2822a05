"""Loops that run until they converge, under vmap."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
from jax.custom_batching import sequential_vmap


def one_by_one(function: Callable[[Any], Any], argument: Any) -> Any:
    """`function(argument)`, of a pytree; under vmap on a CPU, for one element after another.

    Vectorised, a loop runs for all elements until the slowest is done, and holds the memory of all. A processor with
    many lanes gains more than that costs; a CPU does not. `argument` must hold everything that vmap may see, and carry
    no derivatives.
    """
    arrays, rest = eqx.partition(argument, eqx.is_array)

    def call(arrays):
        return function(eqx.combine(arrays, rest))

    return sequential_vmap(call)(arrays) if jax.default_backend() == "cpu" else call(arrays)
