"""The worker of this library: `python -m benchmarks._ours CORES`. See `_serve` and `_matrix`.

Compilation is counted in processor time, from Python to machine code, after the same of one order less.
"""

import sys
import time
from dataclasses import replace
from typing import Any

from benchmarks._serve import Prepared, claim, clock, cores_of, serve

CORES = cores_of(sys.argv[1]) if __name__ == "__main__" else []
if CORES:
    claim(CORES)

import jax  # noqa: E402  after the cores have been claimed, which it counts
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks import _oracle  # noqa: E402
from benchmarks._matrix import Case  # noqa: E402
from hshjax.bases._base import matmul  # noqa: E402

CHECKED = 2000
"""Points at which results are compared with float64."""


def directions(rng: np.random.Generator, points: int) -> np.ndarray:
    """Uniform above 1.1 degrees from the horizon, `(points, 3)`: derivatives of odd orders are infinite there."""
    z, phi = rng.uniform(0.02, 1, points), rng.uniform(0, 2 * np.pi, points)
    rim = np.sqrt(1 - z * z)
    return np.stack([rim * np.cos(phi), rim * np.sin(phi), z], -1)


def arrays(case: Case, points: int) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
    """Directions (two of them for pairs), coefficients, and the weight of every result in a sum; float64."""
    rng = np.random.default_rng(0)
    w = tuple(directions(rng, points) for _ in range(2 if case.basis == "IsotropicBasis" else 1))
    return w, rng.normal(size=(case.functions, case.channels)), rng.normal(size=(points, case.channels))


def function(case: Case, by_rows: bool):
    """What is timed, of (directions, coefficients, weight)."""
    basis = case.made()

    def value(w, coefficients):
        return matmul(basis(*w), coefficients) if by_rows else basis.evaluate(coefficients, *w)

    def weighted(w, coefficients, weight):
        return jnp.sum(weight * value(w, coefficients))

    return {
        "rows": lambda w, coefficients, weight: basis(*w),
        "evaluate": lambda w, coefficients, weight: value(w, coefficients),
        "by coefficients": jax.grad(weighted, argnums=1),
        "by directions": jax.grad(weighted, argnums=0),
    }[case.verb]


def reference(case: Case, given) -> Any:
    """The same in float64, by scipy where that has the functions, or None."""
    w, coefficients, weight = given
    if case.basis != "IsotropicBasis" and case.verb != "by directions":
        rows = _oracle.rows(case.basis, case.order, w[0])
        return {"rows": rows, "evaluate": rows @ coefficients, "by coefficients": rows.T @ weight}[case.verb]
    if case.dtype == "float64":
        return None
    with jax.enable_x64(True):
        return jax.jit(function(case, False))(*jax.tree.map(lambda a: jnp.asarray(a, jnp.float64), given))


def error(case: Case) -> float | None:
    """Largest difference to float64 of what is timed, over the largest value there."""
    given = jax.tree.map(lambda a: a.astype(case.dtype).astype(np.float64), arrays(case, min(case.points, CHECKED)))
    exact = reference(case, given)
    if exact is None:
        return None
    found = jax.jit(function(case, False))(*jax.tree.map(lambda a: jnp.asarray(a, case.dtype), given))
    pairs = list(zip(jax.tree.leaves(found), jax.tree.leaves(exact), strict=True))
    largest = max(np.abs(np.asarray(b)).max() for _, b in pairs)
    return float(max(np.abs(np.asarray(a, np.float64) - np.asarray(b)).max() for a, b in pairs) / largest)


def prepare(request: dict[str, Any]) -> Prepared:
    by_rows = request.pop("by_rows", False)
    case = Case(**request)
    jax.config.update("jax_enable_x64", case.dtype == "float64")
    jax.block_until_ready(jax.jit(lambda x: x + 1)(jnp.zeros(3)))  # what the first program alone pays for
    given = jax.tree.map(lambda a: jnp.asarray(a, case.dtype), arrays(case, case.points))
    # What is set up once for all programs of this kind is no part of one's compilation.
    before = replace(case, order=max(case.order - 1, 0), points=min(case.points, 64))
    few = jax.tree.map(lambda a: jnp.asarray(a, case.dtype), arrays(before, before.points))
    jax.jit(function(before, by_rows)).lower(*few).compile()
    begin = time.process_time()
    compiled = jax.jit(function(case, by_rows)).lower(*given).compile()
    says = {"compile": time.process_time() - begin}
    return Prepared(lambda: jax.block_until_ready(compiled(*given)), says, lambda: {"error": error(case)})


if __name__ == "__main__":
    serve(prepare, clock(CORES))
