"""Stages of a solution, as they go by."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

Progress = Callable[[str, int, int], None]
"""Called with the name of a stage, how much is done and how much there is to do."""


class Stage(NamedTuple):
    """A stage of a solution: its name, how long it took [seconds], figures by name."""

    name: str
    seconds: float
    figures: dict[str, float]


class History:
    """What stages there were; tells `progress` of every step of them."""

    def __init__(self, progress: Progress | None):
        self.stages: list[Stage] = []
        self._progress = progress

    @contextmanager
    def stage(self, name: str, steps: int = 1) -> Iterator["Running"]:
        """A stage of so many steps: call what is given after each."""
        begin, running = time.perf_counter(), Running(name, steps, self._progress)
        yield running
        self.stages.append(Stage(name, time.perf_counter() - begin, running.figures))


class Running:
    """A stage that goes on: a call says that a step is done; `figures` are kept."""

    def __init__(self, name: str, steps: int, progress: Progress | None):
        self.figures: dict[str, float] = {}
        self._name, self._steps, self._done, self._progress = name, steps, 0, progress

    def __call__(self) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(self._name, self._done, self._steps)
