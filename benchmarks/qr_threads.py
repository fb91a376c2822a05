"""Time of one block of the streamed QR with one LAPACK thread and with all, on an idle and on a busy machine.

    python -m benchmarks.qr_threads [--smoke]

Interleaved, medians of 9. "Busy" means one more process a core that multiplies matrices meanwhile.
"""

import multiprocessing
import os
import time

import numpy as np

from benchmarks._smoke import parser

ROWS, COLUMNS, REPEATS = 4264, 168, 9


def _burn():
    a = np.random.default_rng(0).normal(size=(400, 400))
    while True:
        a = np.tanh(a @ a)


def main() -> None:
    smoke = parser(__doc__).parse_args().smoke
    rows, columns, repeats = (64, 8, 1) if smoke else (ROWS, COLUMNS, REPEATS)
    import jax
    import jax.numpy as jnp
    import scipy.linalg  # noqa: F401  the library that threadpoolctl is to find
    from threadpoolctl import threadpool_limits

    jax.config.update("jax_enable_x64", True)
    block = jnp.asarray(np.random.default_rng(0).normal(size=(rows, columns)))
    factorize = jax.jit(lambda a: jnp.linalg.qr(a, mode="r"))
    factorize(block).block_until_ready()
    cores = os.cpu_count() or 1

    print(f"QR of {rows} x {columns}, float64, {cores} cores: median of {repeats} [ms]")
    print("| machine | one thread | all threads |\n|---|---|---|")
    for machine in ("idle",) if smoke else ("idle", "busy"):
        context = multiprocessing.get_context("spawn")
        others = [context.Process(target=_burn, daemon=True) for _ in range(cores if machine == "busy" else 0)]
        for process in others:
            process.start()
        time.sleep(2 if others else 0)
        times = {1: [], cores: []}
        for _ in range(repeats):
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
