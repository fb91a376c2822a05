"""What analytic lobes cost, alone and under light from many directions: processor time of one core.

    python -m benchmarks.lobes [--smoke]

Float32, three channels. `value`, `forward` (the derivative by all parameters along one direction) and `reverse` (the
gradient of a sum by all parameters): nanoseconds a pair, of 100 000. `reflect`: nanoseconds a point and direction, 2000
points under an environment map of 8 x 16. Medians of nine.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._ours import directions
from benchmarks._serve import available, claim, clock, repeated
from benchmarks._smoke import parser
from hshjax import (
    ABC,
    GGX,
    BlinnPhong,
    CookTorrance,
    EnvironmentMap,
    HalfVectorBasis,
    Lambert,
    LinearBRDF,
    OrenNayar,
    SchlickFresnel,
    Ward,
    reflect,
)
from hshjax.brdfs._base import in_dtype

PAIRS, POINTS, REPEATS = 100_000, 2000, 9


def models() -> dict[str, Callable]:
    body, gloss = jnp.asarray([0.1, 0.2, 0.3]), jnp.asarray([0.5, 0.6, 0.7])
    compact = HalfVectorBasis(150)
    coefficients = 0.01 * np.random.default_rng(0).normal(size=(compact.count, 3))
    return {
        "Lambert": Lambert(body),
        "OrenNayar": OrenNayar(body, 0.4),
        "BlinnPhong": BlinnPhong(gloss, 20.0),
        "Ward": Ward(gloss, 0.2, 0.3),
        "CookTorrance": CookTorrance(body, gloss, 0.2),
        "GGX": GGX(gloss, 0.2),
        "GGX, Schlick": GGX(gloss, 0.2, SchlickFresnel(body)),
        "ABC": ABC(body, gloss, 100.0, 1.0),
        "HalfVectorBasis(150)": LinearBRDF(compact, coefficients),
    }


def main() -> None:
    smoke = parser(__doc__).parse_args().smoke
    cores = available()[-1:]
    claim(cores)
    pairs, points, repeats = (64, 4, 1) if smoke else (PAIRS, POINTS, REPEATS)
    now, rng = clock(cores), np.random.default_rng(0)

    def some(count):
        return jnp.asarray(directions(rng, count), jnp.float32)

    wi, wo, normals = some(pairs), some(pairs), some(points)
    light = EnvironmentMap(jnp.ones((8, 16, 3), jnp.float32), up="z")
    view = jnp.asarray([0, 0, 1], jnp.float32)

    def forward(brdf, wi, wo):
        arrays, static = eqx.partition(brdf, eqx.is_inexact_array)
        return jax.jvp(lambda arrays: eqx.combine(arrays, static)(wi, wo), (arrays,), (arrays,))[1]

    # Directions are arguments: of constants XLA computes half vectors while it compiles.
    verbs = {
        "value": (lambda brdf, wi, wo: brdf(wi, wo), (wi, wo), pairs),
        "forward": (forward, (wi, wo), pairs),
        "reverse": (eqx.filter_grad(lambda brdf, wi, wo: jnp.sum(brdf(wi, wo))), (wi, wo), pairs),
        "reflect": (reflect, (light, normals, view), points * light.emitters),
    }
    print(f"| lobe | {' | '.join(verbs)} |\n|{'---|' * (1 + len(verbs))}")
    for name, brdf in models().items():
        brdf = in_dtype(brdf, jnp.float32)
        cells = []
        for verb, given, count in verbs.values():
            compiled = eqx.filter_jit(verb)

            def call(compiled=compiled, brdf=brdf, given=given):
                return jax.block_until_ready(compiled(brdf, *given))

            call()
            cells.append(f"{1e9 * np.median([repeated(call, now, 1) for _ in range(repeats)]) / count:.1f}")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
