"""The side of a benchmark that drives: two processes, each in its own environment, timed in turn."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


class WorkerError(RuntimeError):
    """A worker ended before it answered; the message ends in what it said."""


class Worker:
    """A process that answers requests, see `_serve`. Ends with the `with` block that it is made in."""

    def __init__(self, command: Sequence[str], variables: Mapping[str, str] | None = None):
        self._said = tempfile.TemporaryFile("w+")  # noqa: SIM115  closed by `__exit__`
        self._command = list(command)
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._said, text=True, cwd=ROOT,
            env=os.environ | dict(variables or {}),
        )  # fmt: skip

    def tell(self, **request: Any) -> None:
        """Sends a request, without waiting for its answer."""
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # it has ended: `hear` says why

    def hear(self) -> dict[str, Any]:
        """The answer to the oldest request without one.

        **Raises:** WorkerError if the process has ended instead.
        """
        line = self._process.stdout.readline()
        if not line:
            status = self._process.wait()
            self._said.seek(0)
            raise WorkerError(f"{' '.join(self._command[1:])} ended with status {status}:\n{self._said.read()[-2000:]}")
        return json.loads(line)

    def ask(self, **request: Any) -> dict[str, Any]:
        self.tell(**request)
        return self.hear()

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_) -> None:
        self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()
        self._said.close()


def ours(cores: Sequence[int]) -> Worker:
    """A worker of this library, in this environment."""
    return Worker([sys.executable, "-m", "benchmarks._ours", joined(cores)])


def of_peer(python: Path, script: str, cores: Sequence[int], variables: Mapping[str, str] | None = None) -> Worker:
    """A worker in a peer's environment, from a script of this folder."""
    # -E and -s: packages of this project's environment must not be seen in the other.
    path = ROOT / "benchmarks" / f"{script}.py"
    return Worker([str(python), "-E", "-s", str(path), joined(cores)], variables)


def joined(cores: Sequence[int]) -> str:
    return ",".join(map(str, cores))
