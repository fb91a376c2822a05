"""Every benchmark runs on something tiny. The longer ones are run by `make test-slow`."""

import importlib.util
import json
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import jax
import pytest

import benchmarks
from benchmarks import _matrix, _workers
from benchmarks._workers import Worker, WorkerError
from tests.helpers import slow_unless

ROOT = Path(__file__).parents[1]
NAMES = [one.name for one in pkgutil.iter_modules(benchmarks.__path__) if not one.name.startswith("_")]
LONG = ("half_vector", "lobes", "merl_project", "multi_start", "reflectance", "stereo_pixels", "table_lookup")


@pytest.mark.parametrize("name", [slow_unless(name not in LONG, name, id=name) for name in NAMES])
def test_smoke(name, tmp_path):
    if name == "mitsuba_material" and importlib.util.find_spec("mitsuba") is None:
        pytest.skip('the extra: pip install ".[mitsuba]"')
    cache = {
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir or str(tmp_path / "programs"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    folder = ["--out", str(tmp_path)] if name == "evaluators" else []
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{name}", "--smoke", *folder], cwd=ROOT, capture_output=True, text=True,
        env=os.environ | cache,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout
    if name == "evaluators":
        rows = json.loads((tmp_path / "evaluators.json").read_text())["rows"]
        assert all(0 <= row["error"] < 1e-5 and row["ns"] > 0 and row["limit"] > 0 for row in rows)
        assert (tmp_path / "evaluators.png").stat().st_size > 0


def test_a_worker_that_fails_says_why(tmp_path):
    script = tmp_path / "fails.py"
    script.write_text("raise ValueError('no such case')")
    with (
        Worker([sys.executable, str(script)]) as worker,
        pytest.raises(WorkerError, match=r"(?s)status 1.*no such case"),
    ):
        worker.ask(do="prepare", case={})


def test_what_a_case_takes_at_the_least():
    case = _matrix.Case("evaluate", "HSH", 8)
    assert case.multiply_adds() == 3 * 45 + 81 * 3
    assert case.bytes() == 4 * 6
    assert _workers.joined([0, 3]) == "0,3"
    assert len(set(_matrix.full())) == len(_matrix.distinct(_matrix.full()))
