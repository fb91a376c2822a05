"""One thread for LAPACK where more only wait for each other."""

from collections.abc import Iterator
from contextlib import contextmanager

THREADED_COLUMNS = 512
"""Columns from which a QR has enough work for several threads."""


@contextmanager
def suited_threads(columns: int) -> Iterator[None]:
    """On the CPU, XLA's QR is SciPy's LAPACK, whose threads spin while they wait.

    A block of 4264 rows and 168 columns takes 36 ms with one thread and 47 ms with two on an idle machine of two cores;
    where other processes have work for the same cores, 110 ms and 626 ms (benchmarks/qr_threads.py).
    """
    if columns >= THREADED_COLUMNS:
        yield
        return
    import scipy.linalg  # noqa: F401  loads the library that is to be limited
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
