"""The worker of fitted and tabulated models: `python -m benchmarks._our_models CORES`.

A case is `{"model": name, "path": a .bsdf file, "pairs": n}`, float32, three channels. The table is the file's own;
the series have random coefficients, on which their time does not depend.
"""

import sys
import time
from typing import Any

from benchmarks._serve import Prepared, claim, clock, cores_of, serve

CORES = cores_of(sys.argv[1]) if __name__ == "__main__" else []
if CORES:
    claim(CORES)

import equinox as eqx  # noqa: E402  after the cores have been claimed, which jax counts
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from hshjax import HSH, HalfVectorBasis, IsotropicBasis, LinearBRDF, LogLinearBRDF  # noqa: E402
from hshjax.io import read_rgl  # noqa: E402

MODELS = ("its table", "compact, 150 numbers", "HSH 8, isotropic")


def made(name: str, path: str):
    rng = np.random.default_rng(0)
    match name:
        case "its table":
            return read_rgl(path)
        case "compact, 150 numbers":
            return LogLinearBRDF(HalfVectorBasis(100), [0.05 * rng.normal(size=n) for n in (100, 25, 25)])
        case "HSH 8, isotropic":
            basis = IsotropicBasis(HSH(8))
            return LinearBRDF(basis, rng.normal(size=(basis.count, 3)))
    raise ValueError(f"a model is one of {', '.join(MODELS)}, got {name!r}")


def prepare(case: dict[str, Any]) -> Prepared:
    model = jax.tree.map(
        lambda a: a.astype(np.float32) if eqx.is_inexact_array(a) else a, made(case["model"], case["path"])
    )
    rng = np.random.default_rng(0)
    square, phi = rng.uniform(size=(2, case["pairs"])), rng.uniform(0, 2 * np.pi, (2, case["pairs"]))
    rim = np.sqrt(square)
    w = jnp.asarray(np.stack([rim * np.cos(phi), rim * np.sin(phi), np.sqrt(1 - square)], -1), np.float32)
    begin = time.process_time()
    compiled = eqx.filter_jit(lambda model, wi, wo: model(wi, wo)).lower(model, w[0], w[1]).compile()
    says = {"compile": time.process_time() - begin}
    return Prepared(lambda: jax.block_until_ready(compiled(model, w[0], w[1])), says, dict)


if __name__ == "__main__":
    serve(prepare, clock(CORES))
