"""The side of a benchmark that works: a process which prepares one case and times it whenever it is asked to.

Runs in every environment, that of a peer too: the standard library and NumPy, nothing of this project. Requests and
answers are JSON, one a line, by standard input and output; whatever else is printed goes to standard error.

- `{"do": "prepare", "case": {...}}` -> what the worker's `prepare` says of it, `compile` [s] among it;
- `{"do": "time"}` -> `seconds` of one call, on average over a repeat of at least `REPEAT`;
- `{"do": "finish"}` -> `peak` and `before` [bytes], the largest resident memory and that before the case, and what
  `check` says.

A process that has one core counts its own processor time, which is the same on a busy machine; one that has several
counts time on the wall.
"""

import json
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

REPEAT = 0.02
"""Seconds that a repeat lasts at least."""


class Prepared(NamedTuple):
    """A case that is ready: `call` does the work once and waits for it, `says` is answered, `check` is called last."""

    call: Callable[[], Any]
    says: dict[str, Any]
    check: Callable[[], dict[str, Any]]


def claim(cores: list[int]) -> None:
    """Keeps this process on these cores, before any library counts them. Where the system cannot, nothing happens."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)


def available() -> list[int]:
    """Cores that this process may use, ascending."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def cores_of(argument: str) -> list[int]:
    return [int(core) for core in argument.split(",")]


def clock(cores: list[int]) -> Callable[[], float]:
    """Processor time on one core, else the wall's."""
    return time.process_time if len(cores) == 1 and hasattr(os, "sched_setaffinity") else time.perf_counter


def peak_bytes() -> int:
    """Largest resident memory of this process so far."""
    if sys.platform == "linux":
        # getrusage would say how large the parent was when it started this process, if that is more.
        status = Path("/proc/self/status").read_text(encoding="ascii")
        return 1024 * int(re.search(r"^VmHWM:\s+(\d+) kB$", status, re.MULTILINE)[1])
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak  # kilobytes, but on macOS


def repeated(call: Callable[[], Any], now: Callable[[], float], count: int) -> float:
    """Seconds of a call, on average over `count`."""
    begin = now()
    for _ in range(count):
        call()
    return (now() - begin) / count


def serve(prepare: Callable[[dict[str, Any]], Prepared], now: Callable[[], float]) -> None:
    """Answers requests until there are no more. `prepare` makes the case of a request ready."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    ready, count, before = None, 1, 0
    for line in sys.stdin:
        request = json.loads(line)
        match request["do"]:
            case "prepare":
                before = peak_bytes()
                ready = prepare(request["case"])
                ready.call()  # what a first call alone does
                count = max(1, round(REPEAT / max(repeated(ready.call, now, 1), 1e-6)))
                answer = ready.says | {"calls": count}
            case "time":
                answer = {"seconds": repeated(ready.call, now, count)}
            case "finish":
                answer = {"peak": peak_bytes(), "before": before} | ready.check()
            case other:
                raise ValueError(f"a request is prepare, time or finish, got {other!r}")
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
