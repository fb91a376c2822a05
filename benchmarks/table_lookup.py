"""What looking up a compact model in a table costs: wall time, over that of the model itself.

    python -m benchmarks.table_lookup [--smoke]

A model of 150 numbers over 100 functions, three channels, compiled, float32, 131072 random pairs. The shortest of
eleven rounds, all kinds in turn.
"""

import time

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks._smoke import parser
from hshjax import HalfVectorBasis, LogLinearBRDF, direction, tabulate
from hshjax.bases import LogWarp

PAIRS = 2**17
ROUNDS = 11
STEPS = {"default grid": (90, 45, 36), "grid of a MERL file": (90, 90, 180)}


def main() -> None:
    smoke = parser(__doc__).parse_args().smoke
    pairs, rounds, grids = (64, 1, {"tiny grid": (4, 4, 4)}) if smoke else (PAIRS, ROUNDS, STEPS)
    theta, phi = np.random.default_rng(0).uniform(size=(2, 2, pairs)) * [[[1.4]], [[2 * np.pi]]]
    wi, wo = (direction(jnp.asarray(theta[k], jnp.float32), jnp.asarray(phi[k], jnp.float32)) for k in (0, 1))
    basis = HalfVectorBasis(100, LogWarp(0.05))
    model = LogLinearBRDF(basis, [0.01 * np.random.default_rng(k).normal(size=n) for k, n in enumerate((100, 25, 25))])
    brdfs = {"model": model} | {name: tabulate(model, steps=steps).table for name, steps in grids.items()}
    calls = {name: eqx.filter_jit(brdf) for name, brdf in brdfs.items()}
    for call in calls.values():
        call(wi, wo).block_until_ready()  # compiles
    best = dict.fromkeys(calls, np.inf)
    for _ in range(rounds):
        for name, call in calls.items():
            begin = time.perf_counter()
            call(wi, wo).block_until_ready()
            best[name] = min(best[name], time.perf_counter() - begin)
    for name, seconds in best.items():
        print(f"{name:20s} {1e3 * seconds:8.2f} ms   {seconds / best['model']:.2f}")


if __name__ == "__main__":
    main()
