"""What half-vector functions cost: processor time a pair of the anisotropic ones, over that of the isotropic ones.

    python -m benchmarks.half_vector [--smoke]

As many functions of either kind, three channels, float32, 32768 pairs: the sum, its gradient by one direction, and the
design rows. Every figure is the best of 25, all kinds in turn, so that a busy machine disturbs them alike. "Symmetric"
are those of `anisotropic_order(count)`, "free" those without symmetries.
"""

import time

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._smoke import parser
from hshjax import AnisotropicHalfVectorBasis, HalfVectorBasis, anisotropic_order, direction

PAIRS = 2**15
REPEATS = 25
COUNTS = (50, 150)


def verbs(basis, count, wi, wo) -> dict:
    coefficients = jnp.ones((count, 3), jnp.float32)
    slope = jax.jit(jax.grad(lambda wi: jnp.sum(basis.evaluate(coefficients, wi, wo))))
    return {
        "evaluate": lambda: basis.evaluate(coefficients, wi, wo),
        "gradient": lambda: slope(wi),
        "rows": lambda: basis(wi, wo),
    }


def processor_time(function) -> float:
    start = time.process_time()
    function().block_until_ready()
    return time.process_time() - start


def main() -> None:
    smoke = parser(__doc__).parse_args().smoke
    pairs, repeats, counts = (64, 1, (4,)) if smoke else (PAIRS, REPEATS, COUNTS)
    theta, phi = np.random.default_rng(0).uniform(size=(2, 2, pairs)) * [[[1.4]], [[2 * np.pi]]]
    wi, wo = (direction(jnp.asarray(theta[k], jnp.float32), jnp.asarray(phi[k], jnp.float32)) for k in (0, 1))
    functions = {}
    for count in counts:
        free = anisotropic_order(count, bilateral=False, half_turn=False)
        for kind, basis in {
            "isotropic": HalfVectorBasis(count),
            "symmetric": AnisotropicHalfVectorBasis(count),
            "free": AnisotropicHalfVectorBasis(free),
        }.items():
            for verb, function in verbs(basis, count, wi, wo).items():
                functions[count, kind, verb] = function
                function().block_until_ready()  # compiles
    best = dict.fromkeys(functions, np.inf)
    for _ in range(repeats):
        for case, function in functions.items():
            best[case] = min(best[case], processor_time(function))
    print("functions  verb      isotropic [ns a pair]  symmetric / isotropic  free / isotropic")
    for count in counts:
        for verb in ("evaluate", "gradient", "rows"):
            one = best[count, "isotropic", verb]
            ratios = "".join(f"{best[count, kind, verb] / one:20.2f}" for kind in ("symmetric", "free"))
            print(f"{count:9d}  {verb:9s}{one / pairs * 1e9:20.0f}{ratios}")


if __name__ == "__main__":
    main()
