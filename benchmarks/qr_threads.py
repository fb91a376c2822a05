"""Time of one block of the streamed QR with one LAPACK thread and with all, on an idle and on a busy machine.

    python -m benchmarks.qr_threads

Interleaved, medians of 9. "Busy" means one more process a core that multiplies matrices meanwhile.
"""

import multiprocessing
import os
import time

import numpy as np

ROWS, COLUMNS, REPEATS = 4264, 168, 9


def _burn():
    a = np.random.default_rng(0).normal(size=(400, 400))
    while True:
        a = np.tanh(a @ a)


def main() -> None:
    import jax
    import jax.numpy as jnp
    import scipy.linalg  # noqa: F401  the library that threadpoolctl is to find
    from threadpoolctl import threadpool_limits

    jax.config.update("jax_enable_x64", True)
    block = jnp.asarray(np.random.default_rng(0).normal(size=(ROWS, COLUMNS)))
    factorize = jax.jit(lambda a: jnp.linalg.qr(a, mode="r"))
    factorize(block).block_until_ready()
    cores = os.cpu_count() or 1

    print(f"QR of {ROWS} x {COLUMNS}, float64, {cores} cores: median of {REPEATS} [ms]")
    print("| machine | one thread | all threads |\n|---|---|---|")
    for machine in ("idle", "busy"):
        context = multiprocessing.get_context("spawn")
        others = [context.Process(target=_burn, daemon=True) for _ in range(cores if machine == "busy" else 0)]
        for process in others:
            process.start()
        time.sleep(2 if others else 0)
        times = {1: [], cores: []}
        for _ in range(REPEATS):
            for threads, series in times.items():
                with threadpool_limits(limits=threads, user_api="blas"):
                    start = time.perf_counter()
                    factorize(block).block_until_ready()
                    series.append(time.perf_counter() - start)
        for process in others:
            process.terminate()
        one, many = (f"{1e3 * float(np.median(series)):.0f}" for series in times.values())
        print(f"| {machine} | {one} | {many} |")


if __name__ == "__main__":
    main()
