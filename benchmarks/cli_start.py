"""How long the command takes to start: wall time of whole processes, programs compiled before.

    python -m benchmarks.cli_start [--smoke]

`--help`; `info --json` of a fitted model (165 coefficients in three channels), evaluated for its albedo; `render` of it
at 64 x 64 pixels; `info` of a MERL file of 1.46 million pairs. After two runs that fill the cache, the median and the
shortest of seven, in seconds.
"""

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks._smoke import parser
from hshjax import HSH, IsotropicBasis, Lambert, LinearBRDF
from hshjax.io import save_model, write_merl

RUNS = 7
COMMAND = "import sys; sys.argv[0] = 'hshjax'; from hshjax.cli import main; main()"


def main() -> None:
    smoke = parser(__doc__).parse_args().smoke
    warm, runs, order = (0, 1, 1) if smoke else (2, RUNS, 8)
    with tempfile.TemporaryDirectory() as folder:
        model, merl, picture = (str(Path(folder) / name) for name in ("m.hshjax", "m.binary", "m.png"))
        basis = IsotropicBasis(HSH(order))
        coefficients = np.random.default_rng(0).normal(0, 0.01, (basis.count, 3)).astype(np.float32)
        coefficients[0] = 1
        save_model(model, LinearBRDF(basis, coefficients))
        write_merl(merl, Lambert([0.5, 0.4, 0.3]))
        commands = {
            "--help": ["--help"],
            "info of a model": ["info", model, "--json"],
            "render 64 x 64": ["render", model, "--size", "64", "--out", picture, "--force", "--json"],
            "info of a MERL file": ["info", merl, "--json"],
        }
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "programs")}
        for name, arguments in list(commands.items())[: 1 if smoke else None]:
            seconds = []
            for _ in range(warm + runs):
                begin = time.perf_counter()
                subprocess.run(
                    [sys.executable, "-c", COMMAND, *arguments], env=environment, check=True, stdout=subprocess.DEVNULL
                )
                seconds.append(time.perf_counter() - begin)
            kept = seconds[warm:]
            print(f"{name:22s} {statistics.median(kept):6.2f} s   shortest {min(kept):.2f} s", flush=True)


if __name__ == "__main__":
    main()
