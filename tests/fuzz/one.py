"""One reader under random damage: `python -m tests.fuzz.one NAME SECONDS RUNS SEED FOLDER`; FOLDER is to write in."""

import sys
import time
import zlib
from collections.abc import Callable
from itertools import count
from pathlib import Path

FAULTS = Path(".fuzz")
ROUND = 100
"""Examples that Hypothesis draws at once, and runs for which memory is limited once."""

LARGEST = 2**16
"""Bytes of an input; twice those of the good file where that is larger."""

FIXED = ("merl", "utia")
"""Formats whose files have one size, or the header says which: another is refused before anything else is looked at."""


def limit(name: str, content: bytes) -> int:
    """Bytes of an input."""
    return LARGEST if name in FIXED else max(LARGEST, 2 * len(content))


def sized(name: str, good: bytes, changed: bytes) -> bytes:
    """An input as a file: of formats of one size it replaces the beginning of the good file."""
    return (changed + good[len(changed) :])[: len(good)] if name in FIXED else changed


def check(name: str, good: bytes, readers: tuple[Callable, ...], path: Path) -> Callable[[bytes], None]:
    """What an input must pass: AssertionError where a reader does what it must not do, after keeping the input."""
    from tests.io.hostile_process import wrong

    def passes(changed: bytes) -> None:
        content = sized(name, good, changed)
        path.write_bytes(content)
        for read in readers:
            fault = wrong(read, path)
            if fault:
                FAULTS.mkdir(exist_ok=True)
                kept = FAULTS / f"{name.replace(', ', '-')}-{zlib.crc32(content):08x}"
                kept.write_bytes(content)
                raise AssertionError(f"{kept}: {fault}")

    return passes


def limited(passes: Callable[[bytes], None]) -> Callable[[bytes], None]:
    """The same in limited memory, for the rest of the process: what the fuzzer itself keeps does not count."""
    from tests.io.hostile_process import limit_memory

    runs = count()

    def run(changed: bytes) -> None:
        if next(runs) % ROUND == 0:
            limit_memory()
        passes(changed)

    return run


def led(name: str, seconds: int, runs: int, start: int, folder: Path) -> None:
    """By coverage. Ends the process."""
    import atheris

    with atheris.instrument_imports(include=["hshjax.io"]):
        import hshjax.io  # noqa: F401  what is imported here is instrumented

    content, readers = prepared(name, folder)
    largest, corpus = limit(name, content), folder / "corpus"
    corpus.mkdir()
    (corpus / "seed").write_bytes(content[:largest])
    limits = [f"-max_total_time={seconds}", f"-runs={runs}", f"-seed={start}", "-timeout=10", "-rss_limit_mb=0"]
    passes = limited(check(name, content, readers, folder / "file"))
    atheris.Setup([sys.argv[0], *limits, f"-max_len={largest}", "-artifact_prefix=/dev/null", str(corpus)], passes)
    atheris.Fuzz()


def drawn(name: str, seconds: int, runs: int, start: int, folder: Path) -> None:
    """By Hypothesis: pieces of the good file, replaced, repeated or left out."""
    from hypothesis import HealthCheck, given, seed, settings, strategies as st

    content, readers = prepared(name, folder)
    passes = limited(check(name, content, readers, folder / "file"))
    end, done = time.monotonic() + seconds, 0
    word = st.one_of(
        st.binary(max_size=16),
        st.sampled_from([b"\xff\xff\xff\x7f", b"\xff" * 8, bytes(8), b"nan", b"-1", b"1e999", b"\n", b",", b"0" * 400]),
    )
    place = st.integers(0, len(content))
    damage = st.lists(st.tuples(place, st.integers(0, 64), word, st.integers(0, 3)), min_size=1, max_size=6)

    while time.monotonic() < end and done < runs:  # Hypothesis has no limit of time: rounds of few examples

        @seed(start + done)
        @settings(max_examples=ROUND, deadline=None, database=None, suppress_health_check=list(HealthCheck))
        @given(damage)
        def run(damages):
            changed = content
            for at, length, new, times in damages:
                at = min(at, len(changed))
                changed = changed[:at] + new * times + changed[at + length :]
            passes(changed[: limit(name, content)])

        run()
        done += ROUND
    print(f"Done {done} runs, drawn by Hypothesis")


def prepared(name: str, folder: Path) -> tuple[bytes, tuple[Callable, ...]]:
    """The good file and its readers, which have read it once."""
    import jax

    from tests.io.seeds import seeds

    jax.config.update("jax_enable_x64", True)
    content, readers = seeds()[name]
    path = folder / "file"
    path.write_bytes(content)
    for read in readers:
        read(path)
    return content, readers


if __name__ == "__main__":
    name, seconds, runs, start, folder = sys.argv[1], *map(int, sys.argv[2:5]), Path(sys.argv[5])
    try:
        import atheris  # noqa: F401  whether it is there
    except ImportError:
        drawn(name, seconds, runs, start, folder)
    else:
        led(name, seconds, runs, start, folder)
