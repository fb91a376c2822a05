"""Loops that run until they converge, under vmap."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
from jax.custom_batching import sequential_vmap

from hshjax.fitting._optimistix import constant


def one_by_one(function: Callable[[Any], Any], argument: Any) -> Any:
    """`function(argument)`, of a pytree and without derivatives; under vmap on a CPU, for one element after another.

    Vectorised, a loop runs for all elements until the slowest is done, and holds the memory of all. A processor with
    many lanes gains more than that costs; a CPU does not.
    """
    arrays, rest = eqx.partition(argument, eqx.is_array)

    def call(arrays):
        return function(eqx.combine(arrays, rest))

    if jax.default_backend() != "cpu":
        return call(constant(arrays))
    # Terms may close over arrays of the caller's: what is mapped or differentiated must come in as an argument.
    closed = eqx.filter_closure_convert(call, arrays)
    captured, code = eqx.partition(closed, eqx.is_array)

    @sequential_vmap
    def mapped(captured, arrays):
        return eqx.combine(captured, code)(arrays)

    return mapped(constant(captured), constant(arrays))
