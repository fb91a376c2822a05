"""Samples over the devices of a mesh: every device folds its share, and what they found is put together."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from hshjax._typing import Array
from hshjax.fitting._blocks import fold
from hshjax.samples import Samples

Tree = TypeVar("Tree")

AXIS = "devices"
"""Name of the one axis that every mesh is flattened to."""

SHARES, ALIKE = PartitionSpec(AXIS), PartitionSpec()
"""Of arrays in equal parts along their first axis, and of those that every device holds whole."""


def device_mesh(count: int | None = None) -> Mesh:
    """A mesh of one axis over the first `count` devices of jax, by default all, those of other processes included.

    **Raises:** ValueError where there are not so many.
    """
    devices = jax.devices()
    count = len(devices) if count is None else count
    if not 1 <= count <= len(devices):
        raise ValueError(
            f"a mesh of {count} devices was asked for, and jax has {len(devices)}; before anything is computed, "
            'jax.config.update("jax_num_cpu_devices", N), or XLA_FLAGS=--xla_force_host_platform_device_count=N in the '
            "environment, makes N devices of one processor"
        )
    return Mesh(np.asarray(devices[:count]), (AXIS,))


def flat_mesh(mesh: Mesh) -> Mesh:
    """All devices of a mesh along one axis, of which XLA is free to choose the layout of what is not said.

    **Raises:** TypeError for what is no mesh: a number of devices, say.
    """
    if not isinstance(mesh, Mesh):
        raise TypeError(f"mesh must be a mesh of jax, such as device_mesh(4), got {mesh!r}")
    return Mesh(mesh.devices.ravel(), (AXIS,))


def own_mesh(mesh: Mesh) -> Mesh:
    """The devices of a mesh that belong to this process, along one axis; ValueError where none does.

    **Raises:** TypeError as of `flat_mesh`.
    """
    own = [device for device in flat_mesh(mesh).devices.flat if device.process_index == jax.process_index()]
    if not own:
        raise ValueError(f"no device of the mesh belongs to process {jax.process_index()}, which was to take part")
    return Mesh(np.asarray(own), (AXIS,))


def several_processes(mesh: Mesh | None) -> bool:
    """Whether the devices of a mesh belong to more than one."""
    return mesh is not None and len({device.process_index for device in mesh.devices.flat}) > 1


def spread(samples: Samples, mesh: Mesh) -> Samples:
    """The samples, an equal share on every device of a flat mesh; those that are lacking are of weight 0.

    **Raises:** ValueError for samples that are traced, or not whole in this process, and devices of other processes.
    """
    lacking = -samples.size % mesh.size
    parts = samples.wi, samples.wo, samples.value, samples.weight
    if any(isinstance(part, Tracer) for part in parts):
        if several_processes(mesh):
            raise ValueError("inside a transformation of jax the mesh must be of one process, and this one is not")
        filled = [_filled(jnp, part, lacking) for part in parts]  # XLA moves them where they are used
    else:
        if not all(part.is_fully_addressable for part in parts):
            raise ValueError("every process needs all samples in arrays of its own; project_blocks shares out blocks")
        filled = [put(_filled(np, np.asarray(part), lacking), mesh) for part in parts]
    wi, wo, value, weight = filled
    return Samples(wi, wo, value, weight, None, samples.isotropic)


def put(array: np.ndarray, mesh: Mesh, spec: PartitionSpec = SHARES) -> Array:
    """An array of the host on the devices of a flat mesh, by default in equal parts along its first axis."""
    return jax.make_array_from_callback(array.shape, NamedSharding(mesh, spec), lambda part: array[part])


def _filled(of, array, lacking: int):
    """Zeros after an array, by functions `of` numpy or jax."""
    return of.concatenate([array, of.zeros((lacking, *array.shape[1:]), array.dtype)]) if lacking else array


def fold_each(
    mesh: Mesh | None,
    samples: Samples,
    rows: int,
    carry: Array,
    visit: Callable[..., Array],
    held: Any = (),
) -> Array:
    """`fold` of every device's share, one after the other: `(devices, *carry)`. Inside `jax.jit`.

    `visit(held, carry, wi, wo, value, weight)`: what it needs besides a block, a pytree of arrays, is handed to every
    device as `held`.
    """

    def share(samples, held):
        return fold(samples, rows, carry, partial(visit, held))[None]

    if mesh is None:
        return share(samples, held)
    # Loops within `visit` begin with constants: that they differ between devices afterwards is none of its concern.
    shares = jax.shard_map(share, mesh=mesh, in_specs=(SHARES, ALIKE), out_specs=SHARES, check_vma=False)
    return jax.lax.with_sharding_constraint(shares(samples, held), NamedSharding(mesh, ALIKE))


def gathered(tree: Tree, mesh: Mesh | None) -> Tree:
    """What all devices hold alike, as arrays of one device that meet any others; unchanged where it is traced."""
    if mesh is None:
        return tree

    def one(leaf):
        return leaf if isinstance(leaf, Tracer) else jnp.asarray(np.asarray(leaf.addressable_data(0)))

    return jax.tree.map(one, tree)
