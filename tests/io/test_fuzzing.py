"""What fuzzing gives to readers, and what it leaves behind."""

from pathlib import Path

import pytest

from tests.fuzz.__main__ import fuzzed
from tests.fuzz.one import FIXED, LARGEST, check, limit, sized
from tests.helpers import X64
from tests.io.seeds import seeds

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", FIXED)
def test_inputs_of_one_size_reach_beyond_the_size(name, tmp_path):
    """The good file's own beginning is the good file again; damage shows in the values, not in the length."""
    good, readers = seeds()[name]
    sizes = []
    passes = check(name, good, (*readers, lambda path: sizes.append(path.stat().st_size)), tmp_path / "file")
    with pytest.raises(AssertionError, match="NoneType"):  # of the reader above, which returns nothing
        passes(good[: limit(name, good)])
    assert sizes == [len(good)]
    for changed in (b"", good[:100], 2 * good):
        assert sized(name, good, changed) == good
    assert sized(name, good, b"\xff" * 8)[8:] == good[8:]


def test_no_good_file_is_cut():
    for name, (good, _) in seeds().items():
        assert name in FIXED or limit(name, good) >= max(LARGEST, 2 * len(good))
        assert name in FIXED or sized(name, good, good + b"\0") == good + b"\0"


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="a process of its own, which is the same in either leg")
def test_a_reader_is_run_and_nothing_is_left(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr("tests.fuzz.__main__.MEMORY", tmp_path)
    monkeypatch.chdir(ROOT)
    assert fuzzed("merl", seconds=60, runs=100, seed=1)  # so few runs end long before the time
    assert "merl: no fault; Done 100 runs" in capfd.readouterr().out
    assert not list(tmp_path.iterdir())
