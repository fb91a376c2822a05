"""Devices that the command line is to compute on."""

import os
from contextlib import suppress
from typing import Any

FORCED = "xla_force_host_platform_device_count"
"""The flag in XLA_FLAGS that makes one CPU count as several devices, as `jax_num_cpu_devices` does."""


def threads_on_devices(count: int) -> tuple[Any, ...]:
    """A device for each of so many threads: GPUs, one each. A CPU is one device for all: programs are compiled once.

    **Raises:** ValueError where there are fewer GPUs.
    """
    import jax

    if jax.default_backend() == "cpu":
        return (jax.devices()[0],) * count
    return _counted(count)


def several_devices(count: int) -> tuple[Any, ...]:
    """So many devices, as a mesh wants them: GPUs, or parts of the CPU, which counts as one unless JAX is told before
    it starts.

    **Raises:** ValueError where there are fewer.
    """
    import jax

    if count > 1 and FORCED not in os.environ.get("XLA_FLAGS", ""):
        with suppress(RuntimeError):  # JAX has started: it has the devices that it has, which are counted below
            jax.config.update("jax_num_cpu_devices", count)
    return _counted(count)


def _counted(count: int) -> tuple[Any, ...]:
    import jax

    found = jax.devices()
    if len(found) < count:
        kind = found[0].platform.upper()
        raise ValueError(f"expected {count} devices, got a machine on which JAX has {len(found)} of the kind {kind}")
    return tuple(found[:count])
