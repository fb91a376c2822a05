"""Time of fitting analytic BRDFs to many materials at once: python -m benchmarks.multi_start --materials 100

Guesses and `multi_start` from 16 starts, RGB, 2000 samples of 1 % noise a material: Cook-Torrance, and GGX + Lambert,
7 parameters each. All materials are one vmapped and compiled call. Prints one line of JSON for each model.
"""

import json
import os
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._smoke import parser
from experiments.recipes.recovery import half_angle_pairs
from hshjax.brdfs import GGX, AbstractBRDF, CookTorrance, Lambert
from hshjax.fitting import CosineWeighted, MultiStart, SampleMisfit, initial_guesses, multi_start
from hshjax.samples import Samples

MODELS = {"Cook-Torrance": CookTorrance, "GGX + Lambert": lambda d, s, m: Lambert(d) + GGX(s, m)}


def random_materials(build, rng: np.random.Generator, materials: int, dtype: str) -> AbstractBRDF:
    """Diffuse 0.05 to 0.6 and specular 0.1 to 0.4 of every channel, slope 0.05 to 0.6 in equal ratios."""
    drawn = (
        rng.uniform(0.05, 0.6, (materials, 3)),
        rng.uniform(0.1, 0.4, (materials, 3)),
        np.exp(rng.uniform(np.log(0.05), np.log(0.6), materials)),
    )
    return jax.vmap(build)(*(jnp.asarray(values, dtype) for values in drawn))


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--materials", type=int, default=100)
    options.add_argument("--starts", type=int, default=16)
    options.add_argument("--samples", type=int, default=2000)
    options.add_argument("--dtype", choices=("float64", "float32"), default="float64")
    chosen = options.parse_args()
    if chosen.smoke:
        chosen.materials, chosen.starts, chosen.samples = 1, 1, 20
    jax.config.update("jax_enable_x64", chosen.dtype == "float64")

    for name, build in MODELS.items():
        rng = np.random.default_rng(0)
        truth = random_materials(build, rng, chosen.materials, chosen.dtype)
        wi, wo = (jnp.asarray(w, chosen.dtype) for w in half_angle_pairs(rng, chosen.samples, isotropic=True))
        value = eqx.filter_vmap(lambda brdf, wi=wi, wo=wo: brdf(wi, wo))(truth)
        value = value * jnp.asarray(1 + 0.01 * rng.standard_normal(value.shape), chosen.dtype)
        template = jax.tree.map(lambda leaf: leaf[0], truth)

        def fit_all(value, wi, wo, template=template) -> MultiStart:
            def fit_one(value):
                samples = Samples.scattered(wi, wo, value, isotropic=True)
                guesses = initial_guesses(template, samples, chosen.starts)
                return multi_start(guesses, {"data": SampleMisfit(samples, CosineWeighted())}, throw=False)

            return eqx.filter_vmap(fit_one)(value)

        begin = time.perf_counter()
        compiled = eqx.filter_jit(fit_all).lower(value, wi, wo).compile()
        middle, middle_cpu = time.perf_counter(), time.process_time()
        found = jax.block_until_ready(compiled(value, wi, wo))
        end, end_cpu = time.perf_counter(), time.process_time()
        leaves = zip(jax.tree.leaves(found.best.model), jax.tree.leaves(truth), strict=True)
        errors = np.concatenate([np.ravel(np.abs(np.asarray(a - b)) / np.asarray(b)) for a, b in leaves])
        figures = {
            "model": name,
            **{key: getattr(chosen, key) for key in ("materials", "starts", "samples", "dtype")},
            "seconds": round(end - middle, 2),
            "cpu_seconds": round(end_cpu - middle_cpu, 2),
            "compile_seconds": round(middle - begin, 1),
            "load": round(os.getloadavg()[0], 1),
            "most_steps": int(jnp.max(found.best.steps)),
            "median_error": round(float(np.median(errors)), 6),
            "worst_error": round(float(np.max(errors)), 4),
        }
        print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()
