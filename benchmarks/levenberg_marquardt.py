"""Levenberg-Marquardt of a whole fit against every method of scipy.optimize.least_squares, given the same Jacobian.

    python -m benchmarks.levenberg_marquardt [--samples 100000] [--repeats 3] [--together]

HSH of order 8, isotropic: 165 unknowns a channel, 3 channels, float64, the mapping log(1 + ρ z_i z_o), a Cook-Torrance
surface with 1 % of noise. Each row starts at 0 and ends at the same loss. The channels of a linear model do not touch:
both sides fit them one by one (`jax.vmap` of `fit` here, a loop there). `--together` also times one fit of all 495
unknowns, where neither side is told so; it takes several minutes. scipy gets the design matrix and the analytic
Jacobian, and pays for neither its formation nor the compilation; `fit` forms its rows anew at every step.
"""

import time

from benchmarks._smoke import parser


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--samples", type=int, default=100_000)
    options.add_argument("--repeats", type=int, default=3)
    options.add_argument("--together", action="store_true")
    options = options.parse_args()
    if options.smoke:
        options.samples, options.repeats = 200, 1

    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    import numpy as np
    import scipy.optimize

    from hshjax import (
        HSH,
        CookTorrance,
        IsotropicBasis,
        LinearBRDF,
        LogCosineWeighted,
        SampleMisfit,
        Samples,
        direction,
        fit,
    )

    rng = np.random.default_rng(0)
    n, channels = options.samples, 3
    basis = IsotropicBasis(HSH(2 if options.smoke else 8))
    wi, wo = (direction(np.arccos(rng.uniform(0.05, 1, n)), rng.uniform(0, 2 * np.pi, n)) for _ in range(2))
    truth = CookTorrance(np.array([0.2, 0.1, 0.05]), 0.3, 0.3)
    value = truth(wi, wo) * (1 + 0.01 * rng.standard_normal((n, channels)))

    def fitted(coefficients, value):
        objective = {"data": SampleMisfit(Samples.scattered(wi, wo, value), LogCosineWeighted())}
        found = fit(LinearBRDF(basis, coefficients), objective, throw=False)
        return found.loss, found.steps

    zeros = jnp.zeros((basis.count, channels))
    by_channel = jax.jit(jax.vmap(lambda c, v: fitted(c[:, None], v[:, None]), in_axes=(1, 1)))
    rows = np.asarray(basis(wi, wo))
    cosines = np.asarray(wi[:, 2] * wo[:, 2])[:, None]
    target = np.log1p(cosines * np.asarray(value))

    def residual(x, which):
        # The odd continuation below 0, as the mapping has it.
        shaded = cosines * (rows @ x.reshape(basis.count, -1))
        return (np.sign(shaded) * np.log1p(np.abs(shaded)) - target[:, which]).ravel()

    def jacobian(x, which):
        shaded = cosines * (rows @ x.reshape(basis.count, -1))
        slope = cosines / (1 + np.abs(shaded))
        if slope.shape[1] == 1:
            return slope * rows
        dense = np.zeros((n, channels, basis.count, channels))
        for c in range(channels):
            dense[:, c, :, c] = slope[:, [c]] * rows
        return dense.reshape(n * channels, -1)

    def scipy_fit(method, together):
        groups = [list(range(channels))] if together else [[c] for c in range(channels)]
        found = [
            scipy.optimize.least_squares(
                residual, np.zeros(basis.count * len(which)), jacobian, method=method, ftol=1e-8, xtol=1e-8, gtol=1e-8,
                args=(which,),
            )
            for which in groups
        ]  # fmt: skip
        return sum(f.cost for f in found), max(f.nfev for f in found)

    start = time.perf_counter()
    compiled = by_channel.lower(zeros, value).compile()
    print(f"compilation of the vmapped fit: {time.perf_counter() - start:.1f} s")

    def ours():
        loss, steps = jax.block_until_ready(compiled(zeros, value))
        return float(loss.sum()), int(steps.max())

    def ours_together():
        loss, steps = jax.block_until_ready(fitted(zeros, value))
        return float(loss), int(steps)

    cases = {"hshjax.fit, by channel": ours} | {
        f"scipy {method}, by channel": (lambda method=method: scipy_fit(method, False))
        for method in ("trf", "dogbox", "lm")
    }
    if options.together:
        cases |= {"hshjax.fit, together": ours_together}
        cases |= {f"scipy {m}, together": (lambda method=m: scipy_fit(method, True)) for m in ("trf", "dogbox")}
    times = {name: [] for name in cases}
    outcome = {}
    for _ in range(options.repeats):
        for name, case in cases.items():  # interleaved: a busy minute hits all of them
            start, cpu = time.perf_counter(), time.process_time()
            outcome[name] = case()
            times[name].append((time.perf_counter() - start, time.process_time() - cpu))
    print("| fit | wall [s] | CPU [s] | steps | loss |\n|---|---|---|---|---|")
    for name, series in times.items():
        wall, cpu = np.median(np.asarray(series), axis=0)
        loss, steps = outcome[name]
        print(f"| {name} | {wall:.2f} | {cpu:.2f} | {steps} | {loss:.6f} |")


if __name__ == "__main__":
    main()
