"""Many fits of one kind, spread over devices."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.sharding import Mesh

from hshjax.fitting._mesh import ALIKE, SHARES, flat_mesh, gathered, put


def map_over_mesh(function: Callable[[Any], Any], batch: Any, mesh: Mesh) -> Any:
    """`jax.vmap(function)(batch)`, the elements shared out over the devices of a mesh: fits of many materials, say.

        batch = jax.tree.map(lambda *parts: jnp.stack(parts), *samples)  # Samples of equal sizes, one for each material
        fits = map_over_mesh(lambda one: fit(start, {"data": SampleMisfit(one)}, throw=False), batch, device_mesh())

    - `function`: of one element, traced by jax; it returns a pytree. Arrays that it closes over are on every device.
    - `batch`: a pytree whose arrays have a leading axis of equal length, of any number of elements.
    - `mesh`: see `project`. Where it is of several processes, all make the same call with the same batch.

    **Returns:** results with the same leading axis, as arrays of one device. Keys of random numbers may be in both, but
    what jax draws from those of "rbg" depends on the size of the batch, and so on the devices.

    **Raises:** ValueError where leading axes differ or there is no element, and inside a transformation of jax.
    """
    arrays, rest = eqx.partition(batch, eqx.is_array_like)
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(arrays)):
        raise ValueError("inside a transformation of jax map_over_mesh cannot share out a batch: call it outside")
    kinds = _kinds(arrays)
    # Numpy has no keys of random numbers: they travel as the integers that they are.
    arrays = jax.tree.map(np.asarray, _as_integers(arrays))

    def element(one):
        return function(eqx.combine(_as_keys(one, kinds), rest))

    lengths = {leaf.shape[:1] for leaf in jax.tree.leaves(arrays)}
    if len(lengths) != 1 or lengths & {(), (0,)}:
        raise ValueError(
            f"a batch needs arrays with a leading axis of equal length, at least 1, got {sorted(lengths)} of its leaves"
        )
    ((count,),) = lengths
    mesh = flat_mesh(mesh)
    lacking = -count % mesh.size

    def placed(leaf):  # the last element in place of what lacks: it is sure to be one that can be fitted
        return put(np.concatenate([leaf, np.repeat(leaf[-1:], lacking, axis=0)]), mesh)

    def share(arrays):
        return jax.vmap(lambda one: _as_integers(eqx.filter(element(one), eqx.is_array)))(arrays)

    def besides(one):  # what is no array, of which jax knows nothing
        found, static = eqx.partition(element(one), eqx.is_array)
        return _kinds(found), static

    kinds_found, static = eqx.filter_eval_shape(besides, jax.tree.map(lambda a: a[0], arrays))
    each = jax.shard_map(share, mesh=mesh, in_specs=SHARES, out_specs=SHARES, check_vma=False)
    run = jax.jit(each, out_shardings=jax.NamedSharding(mesh, ALIKE))
    found = jax.tree.map(lambda leaf: leaf[:count], gathered(run(jax.tree.map(placed, arrays)), mesh))
    return eqx.combine(_as_keys(found, kinds_found), static)


def _is_key(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _kinds(tree: Any) -> Any:
    """Which keys every leaf holds; "" where it has none."""
    return jax.tree.map(lambda leaf: jax.random.key_impl(leaf) if _is_key(leaf) else "", tree)


def _as_integers(tree: Any) -> Any:
    return jax.tree.map(lambda leaf: jax.random.key_data(leaf) if _is_key(leaf) else leaf, tree)


def _as_keys(tree: Any, kinds: Any) -> Any:
    """What was `_as_integers`."""
    return jax.tree.map(lambda leaf, kind: jax.random.wrap_key_data(leaf, impl=kind) if kind else leaf, tree, kinds)
