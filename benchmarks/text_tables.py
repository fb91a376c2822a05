"""What reading samples from text costs: wall time, of ALTA and CSV files of growing length, and of writing CSV.

    python -m benchmarks.text_tables [--smoke]

Rows of seven numbers with all their digits. The shorter of two rounds; the first read of a process, which compiles, is
not counted.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks._smoke import parser
from hshjax.io import read_alta, read_csv_samples, write_csv_samples
from hshjax.io._directions import polar
from hshjax.samples import Samples

ROWS = (7_405, 100_000, 1_000_000)
"""The first: as many as a goniometer measured of one tape."""


def main() -> None:
    lengths = (20,) if parser(__doc__).parse_args().smoke else ROWS
    with tempfile.TemporaryDirectory() as folder:
        for rows in lengths:
            _measure(Path(folder), rows)


def _measure(folder: Path, rows: int) -> None:
    rng = np.random.default_rng(0)
    theta, phi = rng.uniform(size=(2, 2, rows)) * [[[1.5]], [[2 * np.pi]]]
    samples = Samples.scattered(*(polar(theta[k], phi[k]) for k in (0, 1)), rng.uniform(size=(rows, 1)))
    csv, alta = folder / "samples.csv", folder / "samples.dat"
    write = _seconds(lambda: write_csv_samples(csv, samples))
    table = csv.read_text(encoding="utf-8").split("\n", 3)[3].replace(",", " ")
    alta.write_text(f"#DIM 6 1\n#PARAM_IN CARTESIAN\n{table}", encoding="utf-8")
    read_csv_samples(csv)  # compiles
    seconds = _seconds(lambda: read_csv_samples(csv)), _seconds(lambda: read_alta(alta))
    size = csv.stat().st_size / 1e6
    print(
        f"{rows:8d} rows, {size:6.1f} MB   CSV {seconds[0]:6.3f} s   ALTA {seconds[1]:6.3f} s   written {write:6.3f} s"
    )


def _seconds(call: Callable[[], object]) -> float:
    best = np.inf
    for _ in range(2):
        begin = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begin)
    return best


if __name__ == "__main__":
    main()
