"""One kernel for a piece of straight-line arithmetic, also within a loop."""

from collections.abc import Callable
from functools import reduce
from operator import add
from typing import Any

import jax
import jax.numpy as jnp


def kernel(function: Callable, *arrays: Any):
    """`function(*arrays)` as a piece of its own, also within a loop.

    XLA's compiler for processors would fuse it with the loop's slices of whole arrays, and then finds no vectors in it.
    It fuses nothing across a branch, and the predicate of this one is hidden from it. Other devices need none of this.
    """

    function = jax.jit(function)  # traced once for all that follows

    def branch(*arrays):
        true = jax.lax.optimization_barrier(jnp.ones((), bool))
        shape = jax.eval_shape(function, *arrays)

        def never(*arrays):
            # Both branches have to vary over the same axes of a mesh: in `jax.shard_map` a plain 0 varies over none.
            zero = reduce(add, [jnp.sum(jnp.ravel(a)[:0]) for a in jax.tree.leaves(arrays)])
            return jax.tree.map(lambda one: jnp.full(one.shape, zero.astype(one.dtype)), shape)

        return jax.lax.cond(true, function, never, *arrays)

    return jax.lax.platform_dependent(*arrays, cpu=branch, default=function)
