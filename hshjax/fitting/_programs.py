"""Compiled programs of a process that compiles very many."""

from pathlib import Path

import jax

MAPPINGS = 20_000
"""Of a process, above which compiled programs are dropped. Each one of XLA's maps memory some ten times, and Linux
grants 65 530 mappings: the program that asks for one more kills its process."""


def few_programs() -> None:
    """Drops compiled programs before the process has too many (`MAPPINGS`)."""
    table = Path("/proc/self/maps")
    if table.exists() and table.read_bytes().count(b"\n") > MAPPINGS:
        jax.clear_caches()
