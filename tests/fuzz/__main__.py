"""Every reader, each in a process of its own, for a share of the time; as many at once as there are processors.

    python -m tests.fuzz [--seconds 60] [--runs 100000] [--seed 1] [NAME ...]

With atheris (dependency group `fuzz`) inputs are led by what they reach in `hshjax.io`; without it, Hypothesis draws
damages of a good file. What a reader must not do (see `tests.io.hostile.outcome`), and a reader that was never run, end
this with status 1; the file that caused it is kept in `.fuzz/`.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.io.seeds import MEASURED, OTHERS

MEMORY = Path("/dev/shm")
"""Where inputs are written if it is there: files in memory."""

STARTING = 120
"""Seconds that a process may take beside its share."""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60, help="of all readers together, beside starting them")
    parser.add_argument("--runs", type=int, default=100_000, help="of each reader at most")
    parser.add_argument("--seed", type=int, default=1, help="of the damages, 0: of the time")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join([*MEASURED, *OTHERS])}")
    options = parser.parse_args()
    names = options.names or [*MEASURED, *OTHERS]
    unknown = {*names} - {*MEASURED, *OTHERS}
    if unknown:
        parser.error(f"no such reader: {', '.join(sorted(unknown))}")
    share = max(1, round(options.seconds / len(names)))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        good = list(pool.map(lambda name: fuzzed(name, share, options.runs, options.seed), names))
    return int(not all(good))


def fuzzed(name: str, seconds: int, runs: int, seed: int) -> bool:
    """Whether a reader was run and has no fault; said on standard output."""
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
        limits = map(str, (seconds, runs, seed))
        command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz.one", name, *limits, folder]
        try:
            # Libraries of images print what they find wrong, thousands of times: the last lines say how it ended.
            done = subprocess.run(
                command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
                timeout=seconds + STARTING,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            print(f"{name}: FAULT; no end after {seconds + STARTING} s", flush=True)
            return False
    last = [line for line in done.stdout.splitlines() if line.strip()][-1:]
    ran = re.search(r"^Done [1-9]\d* runs", done.stdout, re.MULTILINE)
    good = done.returncode == 0 and ran is not None
    print(f"{name}: {'no fault' if good else 'FAULT'}; {' '.join(last)}", flush=True)
    if not good:
        print(done.stdout[-4000:], flush=True)
    return good


if __name__ == "__main__":
    sys.exit(main())
