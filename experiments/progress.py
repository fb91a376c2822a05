"""What a run says while it works: bars on a terminal, plain lines elsewhere, on standard error; and what it prints."""

import time
from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

_Item = TypeVar("_Item")

SECONDS_BETWEEN_LINES = 10.0


class Voice:
    """Prints lines and follows loops. Loops may nest: they share one display."""

    def __init__(self, console: Console | None = None):
        self.console = Console(stderr=True, highlight=False, soft_wrap=True) if console is None else console
        self._bars: Progress | None = None

    def say(self, text: str) -> None:
        """One line, as it stands: no markup."""
        self.console.print(text, markup=False)

    def show(self, columns: list[str], rows: list[list[str]]) -> None:
        """A table on standard output, however wide."""
        table = Table(*columns, box=None, pad_edge=False)
        for row in rows:
            table.add_row(*row)
        Console(highlight=False, markup=False, width=None if self.console.is_terminal else 200).print(table)

    def follow(self, iterable: Iterable[_Item], description: str, total: int | None = None) -> Iterator[_Item]:
        """The same items, with a sign of progress after each."""
        if total is None and isinstance(iterable, Sized):
            total = len(iterable)
        return (self._bar if self.console.is_terminal else self._lines)(iterable, description, total)

    def _bar(self, iterable: Iterable[_Item], description: str, total: int | None) -> Iterator[_Item]:
        outermost = self._bars is None
        if self._bars is None:
            self._bars = Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
                console=self.console,
                transient=True,
            )
            self._bars.start()
        bars = self._bars
        task = bars.add_task(description, total=total)
        try:
            for item in iterable:
                yield item
                bars.advance(task)
        finally:
            bars.remove_task(task)
            if outermost:
                bars.stop()
                self._bars = None

    def _lines(self, iterable: Iterable[_Item], description: str, total: int | None) -> Iterator[_Item]:
        start = last = time.monotonic()
        of = "" if total is None else f"/{total}"
        count = 0
        for count, item in enumerate(iterable, 1):
            yield item
            if time.monotonic() - last >= SECONDS_BETWEEN_LINES:
                last = time.monotonic()
                self.say(f"{description}: {count}{of}, {last - start:.0f} s")
        self.say(f"{description}: {count}{of} done, {time.monotonic() - start:.1f} s")
