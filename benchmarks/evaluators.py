"""What evaluating a basis costs, beside sphericart-jax, zernipax and what this machine can do at the most.

    python -m benchmarks.evaluators [--out runs/evaluators] [--full | --smoke | --figures] [--repeats 9] [--cores 1]

Every row is two processes, one here and one in the peer's environment (made if it is not there, see
`experiments.peers`), which time a repeat each in turn; medians and quartiles of the ratios of neighbouring repeats.
With one core, the default, both are kept on the same one and count processor time, so that what else runs there changes
little; with more, time on the wall. Prints a Markdown table, and writes it to `--out` with `evaluators.json` and
`evaluators.png`. `--figures` runs the rows alone that a figure is asked of; `--smoke` something tiny without peers.
"""

import argparse
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import _matrix, _report, _workers
from benchmarks._limits import LIMITS
from benchmarks._matrix import Case
from benchmarks._serve import available
from benchmarks._workers import Worker
from experiments import peers


class Limits:
    """Workers that measure the machine in turn with everything else. Closed with `stack`."""

    def __init__(self, stack: ExitStack, cores: list[int]):
        command = [sys.executable, "-m", "benchmarks._limits", _workers.joined(cores)]
        self._workers = {name: stack.enter_context(Worker(command)) for name in LIMITS}
        self._amount = {
            name: one.ask(do="prepare", case={"limit": name})["amount"] for name, one in self._workers.items()
        }
        self._seconds: dict[str, list[float]] = {name: [] for name in LIMITS}

    def measure(self) -> None:
        for name, worker in self._workers.items():
            self._seconds[name].append(worker.ask(do="time")["seconds"])

    def rates(self) -> dict[str, float]:
        """Medians [bytes/s, multiply-adds/s]."""
        return {name: self._amount[name] / float(np.median(taken)) for name, taken in self._seconds.items()}


def peer_of(case: Case, cores: list[int]) -> tuple[Worker, dict[str, Any]]:
    """The worker that a case is compared with, and what it is to prepare."""
    if case.basis == "IsotropicBasis":
        return _workers.ours(cores), asdict(case) | {"by_rows": True}
    return _workers.of_peer(peers.environment("harmonics"), "_harmonics", cores), asdict(case)


def measured(case: Case, cores: list[int], repeats: int, limits: Limits, beside: bool) -> dict[str, Any]:
    """One row: seconds, memory and error, without what the limits are needed for."""
    with ExitStack() as stack:
        sides = {"ours": stack.enter_context(_workers.ours(cores))}
        given = {"ours": asdict(case)}
        if beside:
            worker, given["peer"] = peer_of(case, cores)
            sides["peer"] = stack.enter_context(worker)
        prepared = {name: worker.ask(do="prepare", case=given[name]) for name, worker in sides.items()}
        seconds: dict[str, list[float]] = {name: [] for name in sides}
        for _ in range(repeats):
            for name, worker in sides.items():
                seconds[name].append(worker.ask(do="time")["seconds"])
        limits.measure()
        finished = {name: worker.ask(do="finish") for name, worker in sides.items()}
    row: dict[str, Any] = asdict(case) | {"functions": case.functions, "error": finished["ours"]["error"]}
    for name in sides:
        row |= {
            f"seconds {name}": float(np.median(seconds[name])),
            f"compile {name} [s]": prepared[name]["compile"],
            f"peak {name} [MB]": (finished[name]["peak"] - finished[name]["before"]) / 1e6,
        }
    row["ns"] = 1e9 * row["seconds ours"] / (case.points * case.functions)
    if beside:
        row["peer"] = _matrix.PEERS[case.basis]
        row["ratio"] = quartiles(np.array(seconds["ours"]) / np.array(seconds["peer"]))
    return row


def quartiles(values: np.ndarray) -> list[float]:
    """Lower quartile, median, upper quartile."""
    return [float(q) for q in np.quantile(values, (0.25, 0.5, 0.75))]


def with_limits(rows: list[dict[str, Any]], rates: dict[str, float]) -> Iterator[dict[str, Any]]:
    """Rows with `limit`, time over the larger of two that cannot be gone below, and `limited by`, which that is."""
    for row in rows:
        case = Case(**{name: row[name] for name in Case.__dataclass_fields__})
        least = {
            "arithmetic": case.multiply_adds() * case.points / rates[case.dtype],
            "bandwidth": case.bytes() * case.points / rates["bandwidth"],
        }
        by = max(least, key=least.get)
        yield row | {"limit": row["seconds ours"] / least[by], "limited by": by}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--full", action="store_true", help="every case, more than an hour")
    which.add_argument("--figures", action="store_true", help="what a figure is asked of")
    which.add_argument("--smoke", action="store_true", help="something tiny, without peers")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("runs/evaluators"), help="folder of what is written")
    chosen = parser.parse_args()
    cores = available()[-chosen.cores :]
    cases = _matrix.smoke if chosen.smoke else _matrix.full if chosen.full else _matrix.selection
    if chosen.figures:
        cases = _matrix.asked
    beside, rows = not chosen.smoke, []
    with ExitStack() as stack:
        limits = Limits(stack, cores)
        for case in _matrix.distinct(cases()):
            rows.append(measured(case, cores, 1 if chosen.smoke else chosen.repeats, limits, beside))
            print(_report.line(rows[-1]), flush=True)
        rates = limits.rates()
    rows = list(with_limits(rows, rates))
    machine = _report.machine(cores, rates)
    _report.write(chosen.out, "evaluators", machine, rows)
    print(f"\n{_report.table(machine, rows)}\nwritten to {chosen.out}")


if __name__ == "__main__":
    main()
