"""A measured material by Mitsuba's `measured`, and by this library: processor time of as many pairs.

    python -m benchmarks.measured_material [FILE.bsdf] [--pairs 262144] [--repeats 9] [--smoke]

Without a file, one is written from a GGX lobe over Lambert. Both sides on one core, a process each, repeats in turn;
medians, and quartiles of the ratio to Mitsuba (variant `llvm_ad_rgb`, in the environment of `experiments.peers`). If
that cannot be had here, the reason is printed and our side alone is measured.
"""

import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks import _workers
from benchmarks._our_models import MODELS
from benchmarks._serve import available
from benchmarks._smoke import parser
from benchmarks._workers import Worker
from experiments import peers
from hshjax import GGX, Lambert
from hshjax.io import write_rgl

LLVM = "DRJIT_LIBLLVM_PATH"


def main() -> None:
    options = parser(__doc__)
    options.add_argument("file", nargs="?")
    options.add_argument("--pairs", type=int, default=2**18)
    options.add_argument("--repeats", type=int, default=9)
    chosen = options.parse_args()
    models = MODELS[2:] if chosen.smoke else MODELS
    if chosen.smoke:
        chosen.pairs, chosen.repeats = 64, 1
    cores = available()[-1:]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        path = chosen.file or f"{folder}/material.bsdf"
        if chosen.file is None and not chosen.smoke:
            write_rgl(path, Lambert([0.3, 0.1, 0.05]) + 0.1 * GGX(1.0, 0.2))
        path = str(Path(path).absolute())
        mitsuba = None if chosen.smoke else peer(stack, cores, path, chosen.pairs)
        print(f"{'':24s} ns a pair   of Mitsuba (quartiles)   compile [s]")
        for name in models:
            with Worker([sys.executable, "-m", "benchmarks._our_models", _workers.joined(cores)]) as ours:
                said = ours.ask(do="prepare", case={"model": name, "path": path, "pairs": chosen.pairs})
                seconds = [(both(ours, mitsuba)) for _ in range(chosen.repeats)]
            mine, theirs = np.array(seconds).T
            low, middle, high = np.quantile(mine / theirs, (0.25, 0.5, 0.75))
            beside = f"{middle:.2f} ({low:.2f}-{high:.2f})" if mitsuba else ""
            print(
                f"{name:24s}{1e9 * np.median(mine) / chosen.pairs:10.1f} {beside:>24s} {said['compile']:12.2f}",
                flush=True,
            )
            if mitsuba:
                print(f"{'  Mitsuba meanwhile':24s}{1e9 * np.median(theirs) / chosen.pairs:10.1f}", flush=True)


def both(ours: Worker, mitsuba: Worker | None) -> tuple[float, float]:
    """Seconds of a call on either side, NaN without Mitsuba."""
    mine = ours.ask(do="time")["seconds"]
    return mine, np.nan if mitsuba is None else mitsuba.ask(do="time")["seconds"]


def peer(stack: ExitStack, cores: list[int], path: str, pairs: int) -> Worker | None:
    """Mitsuba's worker, ready; None, and a word why, where it cannot be had."""
    try:
        python, library = peers.environment("mitsuba"), peers.llvm_library()
    except peers.PeerUnavailableError as error:
        print(f"without Mitsuba: {error}", flush=True)
        return None
    worker = stack.enter_context(_workers.of_peer(python, "_mitsuba_measured", cores, {LLVM: library}))
    worker.ask(do="prepare", case={"path": path, "pairs": pairs})
    return worker


if __name__ == "__main__":
    main()
