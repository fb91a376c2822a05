"""The worker that measures what the machine can do: `python -m benchmarks._limits CORES`. NumPy alone.

A case is `{"limit": name}`, and its answer to `prepare` says how much one call does:

- `bandwidth` [bytes]: a = b + c on arrays of 128 MB, far beyond any cache, into memory that is there. Three arrays are
  counted, and not that a processor may read `a` before it writes there.
- `float32`, `float64` [multiply-adds]: a product of two square matrices of 1024 rows by NumPy's BLAS.
"""

import sys
from typing import Any

from benchmarks._serve import Prepared, claim, clock, cores_of, serve

if __name__ == "__main__":
    CORES = cores_of(sys.argv[1])
    claim(CORES)

import numpy as np  # after the cores have been claimed, which its BLAS counts

LIMITS = ("bandwidth", "float32", "float64")
LENGTH = 2**25
ROWS = 1024


def prepare(case: dict[str, Any]) -> Prepared:
    name = case["limit"]
    if name == "bandwidth":
        a, b, c = (np.full(LENGTH, k, np.float32) for k in range(3))
        return Prepared(lambda: np.add(b, c, out=a), {"amount": 3 * a.nbytes}, dict)
    if name in LIMITS:
        a, b, c = (np.full((ROWS, ROWS), 1 + k, name) for k in range(3))
        return Prepared(lambda: np.matmul(b, c, out=a), {"amount": ROWS**3}, dict)
    raise ValueError(f"a limit is one of {', '.join(LIMITS)}, got {name!r}")


if __name__ == "__main__":
    serve(prepare, clock(CORES))
