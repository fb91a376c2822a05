"""Every reader in turn, each in a process of its own, for a share of the time.

    python -m tests.fuzz [--seconds 60] [--runs 100000] [NAME ...]

With atheris (dependency group `fuzz`) inputs are led by what they reach in `hshjax.io`; without it, Hypothesis draws
damages of a good file. What a reader must not do (see `tests.io.hostile_process.wrong`) ends the run with status 1; the
file that caused it is kept in `.fuzz/`.
"""

import argparse
import subprocess
import sys

from tests.io.seeds import MEASURED, OTHERS


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60, help="of all readers together")
    parser.add_argument("--runs", type=int, default=100_000, help="of each reader at most")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join([*MEASURED, *OTHERS])}")
    options = parser.parse_args()
    names = options.names or [*MEASURED, *OTHERS]
    unknown = {*names} - {*MEASURED, *OTHERS}
    if unknown:
        parser.error(f"no such reader: {', '.join(sorted(unknown))}")
    failed = []
    for name in names:
        command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz.one", name]
        command += [str(max(1, round(options.seconds / len(names)))), str(options.runs)]
        # Libraries of images print what they find wrong, thousands of times: the last lines say how it ended.
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
        last = [line for line in done.stdout.splitlines() if line.strip()][-1:]
        print(f"{name}: {'no fault' if done.returncode == 0 else 'FAULT'}; {' '.join(last)}", flush=True)
        if done.returncode:
            failed.append(name)
            print(done.stdout[-4000:])
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
