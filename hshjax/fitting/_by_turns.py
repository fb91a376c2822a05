"""Independent work by turns on several devices: a thread each, in which JAX computes on that device."""

import queue
import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import Any, TypeVar

import jax

from hshjax.fitting._lapack import suited_threads

Item = TypeVar("Item")
Found = TypeVar("Found")


def check_devices(devices: Sequence[Any] | None) -> None:
    """ValueError where there is none, or something else; TypeError for what is no sequence: a number, say."""
    if devices is None:
        return
    if not isinstance(devices, Sequence):
        raise TypeError(f"devices must be a list of those of jax, such as jax.devices(), got {devices!r}")
    if not devices:
        raise ValueError("work is done on one device or more, got none")
    for device in devices:
        if not isinstance(device, jax.Device):
            raise ValueError(f"devices must be those of jax, as jax.devices() gives them, got {device!r}")


def by_turns(
    work: Callable[[Item], Found], items: Sequence[Item], devices: Sequence[Any] | None = None
) -> Generator[tuple[int, Found], None, None]:
    """`work(item)` of every item: the item's number and what was found, as it is done.

    - `devices`: of JAX, a thread each, and one device may have several; a thread takes the next item that nobody has.
      None, or a single one: one item after the other, in the thread of the caller. Results are those of one device to
      rounding, if `work` knows nothing of devices and shares nothing that it writes.

    What `work` raises is raised here. Then, on Ctrl-C, and where the caller stops early, no further item is begun, and
    those that other threads are at are waited for: a thread in a compiled program cannot be stopped.
    """
    check_devices(devices)
    if devices is None or len(devices) == 1:
        for k, item in enumerate(items):
            with nullcontext() if devices is None else jax.default_device(devices[0]):
                found = work(item)
            yield k, found
        return
    todo: queue.SimpleQueue[tuple[int, Item]] = queue.SimpleQueue()
    done: queue.SimpleQueue[tuple[int, Any, BaseException | None]] = queue.SimpleQueue()
    for one in enumerate(items):
        todo.put(one)
    stop = threading.Event()
    wide = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]

    def serve(device: Any) -> None:
        k = -1  # of no item yet
        try:
            with jax.default_device(device), jax.enable_x64(wide):  # which are each thread's own
                while not stop.is_set():
                    try:
                        k, item = todo.get_nowait()
                    except queue.Empty:
                        return
                    done.put((k, work(item), None))
        except BaseException as error:  # or it would be waited for without end
            done.put((k, None, error))

    # The limit belongs to the process: threads that set and restore it by turns would leave any of their values.
    with suited_threads(0), ThreadPoolExecutor(len(devices)) as pool:
        try:
            for device in devices:
                pool.submit(serve, device)
            for _ in range(len(items)):
                k, found, error = done.get()
                if error is not None:
                    raise error
                yield k, found
        finally:
            stop.set()
