"""Functions of arrays with rules of their own for derivatives and for batches, which no transformation drops.

`jax.custom_jvp` around `jax.custom_batching.custom_vmap` says the same. But of the first JAX keeps the bare function
where it linearises a loop, and the second cannot be linearised: second derivatives of a sum inside `jax.lax.map`
failed. A primitive of JAX has both rules wherever it occurs.
"""

from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.api_util import shaped_abstractify
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from hshjax._typing import Array

Axes = tuple[int | None, ...]

Zero = ad.Zero
"""The tangent of what does not change."""


def instantiated(tangent: Any) -> Array:
    return ad.instantiate_zeros(tangent)


def operation(
    name: str,
    function: Callable[..., Array],
    derivative: Callable[[Any, Sequence[Array], Sequence[Any]], tuple[Array, Array]],
    merged: Callable[..., Array | None],
    *,
    linear: int,
) -> Callable[..., Array]:
    """`function(static, *arrays)`, an array, with these rules; `static` is hashable.

    - `derivative(static, primals, tangents)` is (value, tangent); some tangents may be `Zero`, not all.
    - `linear`: the argument, counted from the end, that it is linear in: its transpose is that of the tangent.
    - `merged(call, mapped, *arrays)` is the value of a batch by `call(*arrays)` of more points, or channels, the batch
      leading in what is `mapped` and in the result; None if it cannot be that, and is taken side by side.
    """
    primitive = Primitive(name)

    @partial(jax.jit, static_argnames=("static", "axes"))  # traced once, for its type and for its program
    def whole(*arrays, static, axes):
        value = partial(function, static)
        for level in reversed(axes):
            value = jax.vmap(value, level)
        return value(*arrays)

    def abstract(*arrays, static, axes):
        # With what the types of arguments say besides, as the axes of a mesh that they vary over.
        return shaped_abstractify(jax.eval_shape(partial(whole, static=static, axes=axes), *arrays))

    def jvp(primals, tangents, *, static, axes):
        if not axes:
            return derivative(static, primals, tangents)
        # A level of axes at a time, the outermost first; a tangent lies as what it is the tangent of.
        moving = [k for k, tangent in enumerate(tangents) if not isinstance(tangent, Zero)]

        def item(primals, given):
            all_of: list[Any] = [Zero(jax.typeof(primal)) for primal in primals]  # floats are their own tangents
            for k, tangent in zip(moving, given, strict=True):
                all_of[k] = tangent
            return jvp(primals, all_of, static=static, axes=axes[1:])

        level = list(axes[0])
        return jax.vmap(item, (level, [level[k] for k in moving]))(list(primals), [tangents[k] for k in moving])

    def transpose(cotangent, *arrays, static, axes):
        place = len(arrays) + linear
        if [k for k, array in enumerate(arrays) if ad.is_undefined_primal(array)] != [place]:
            raise TypeError(f"{name} is linear in the coefficients of its functions, and in nothing else")
        like = arrays[place].aval
        fixed = [*arrays[:place], jnp.zeros(like.shape, like.dtype), *arrays[place + 1 :]]

        def along(moved):
            tangents: list[Any] = [Zero(jax.typeof(array)) for array in fixed]
            tangents[place] = moved
            return jvp(fixed, tangents, static=static, axes=axes)[1]

        found: list[Any] = [None] * len(arrays)
        (found[place],) = jax.linear_transpose(along, fixed[place])(instantiated(cotangent))
        return found

    def batch(arrays, axis, *, static, axes):
        mapped = tuple(k is not None for k in axis)
        arrays = [jnp.moveaxis(a, k, 0) if k is not None else a for a, k in zip(arrays, axis, strict=True)]
        found = None if axes else merged(partial(call, static), mapped, *arrays)
        if found is None:
            level: Axes = tuple(0 if each else None for each in mapped)
            found = primitive.bind(*arrays, static=static, axes=(level, *axes))
        return found, 0

    def call(static: Hashable, *arrays: Array) -> Array:
        return primitive.bind(*arrays, static=static, axes=())

    primitive.def_impl(whole)
    primitive.def_abstract_eval(abstract)
    mlir.register_lowering(primitive, mlir.lower_fun(whole, multiple_results=False))
    ad.primitive_jvps[primitive] = jvp
    ad.primitive_transposes[primitive] = transpose
    batching.primitive_batchers[primitive] = batch
    return call
