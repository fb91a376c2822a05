"""The coordination service of several processes in one of its own, so that the end of none of them is that of all."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def coordinator(port: int, processes: int) -> Iterator[None]:
    """For the body, jax's coordination service for so many processes, at a port of this host.

    By itself jax has it in process 0. When that is lost, jax aborts the others where Python cannot catch it. Beside a
    service that is none of theirs they go on, and calls that they share end with a `ProcessError`. All of them call

        jax.distributed.initialize("HOST:PORT", processes, number, coordinator_bind_address="127.0.0.1:0")

    of which the last is for a service that process 0 starts nevertheless, and nobody asks. The body must last longer
    than the processes do. jax calls the tasks of this service recoverable, and that experimental.

    **Raises:** ValueError for no process, and for a port that is not from 1 to 65535; OSError for one that another
    program has.
    """
    from jax._src.lib import _jax  # pyright: ignore[reportPrivateImportUsage]  there is no public name for it

    if processes < 1:
        raise ValueError(f"a coordinator needs at least one process, got {processes}")
    if not 1 <= port <= 65535:
        raise ValueError(f"a port is a number from 1 to 65535, got {port}")
    # Where the port is taken, jaxlib does not always get as far as an error: it may crash.
    both = socket.has_dualstack_ipv6()
    socket.create_server(("", port), family=socket.AF_INET6 if both else socket.AF_INET, dualstack_ipv6=both).close()
    service = _jax.get_distributed_runtime_service(f"[::]:{port}", processes, recoverable=True)
    try:
        yield
    finally:
        service.shutdown()
