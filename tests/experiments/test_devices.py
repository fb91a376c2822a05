"""Devices of a run: how it is done and not what it is; independent items by turns, with the same results."""

import io
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import jax
import numpy as np
import pytest
from rich.console import Console

from experiments import config as configs, runner
from experiments.progress import Voice
from experiments.record import Record
from tests.helpers import slow_unless

ROOT = Path(__file__).parents[2]

PROBE = '''"""A recipe for tests."""

from typing import Literal

import jax
import jax.numpy as jnp
from jax.sharding import NamedSharding, PartitionSpec

from experiments.config import RecipeConfig


class Config(RecipeConfig):
    recipe: Literal["probe"]


def item(x):
    return {"x": x, "noise": jax.random.normal(jax.random.key(x), (3,))}


def run(config, record):
    assert len(set(record.devices)) == config.devices == record.mesh.size <= jax.device_count()
    found = record.stage_each({f"item {k}": (k,) for k in range(7)}, item, "items")
    assert [one["x"] for one in found] == list(range(7))
    row = jax.device_put(jnp.arange(8.0), NamedSharding(record.mesh, PartitionSpec("devices")))
    assert row.sharding.device_set == set(record.devices)
    record.metric("sum", sum(float(one["noise"].sum()) for one in found) + float(row.sum()))
'''
COMMAND = (
    "import sys; from experiments import __main__ as command, recipes; recipes.__path__ = [sys.argv[1]]; "
    "command.app(sys.argv[2:])"
)


def test_two_devices_measure_what_one_does(tmp_path):
    """Processes of their own: how many devices there are is said before JAX starts."""
    (tmp_path / "recipes").mkdir()
    (tmp_path / "recipes" / "probe.py").write_text(PROBE)
    metrics, names = [], set()
    for devices, more in (("1", ["--devices", "2"]), ("2", ["devices=1"])):
        (tmp_path / "study.toml").write_text(f'recipe = "probe"\ndevices = {devices}\n')
        runs = tmp_path / f"runs {devices}"
        command = [sys.executable, "-c", COMMAND, str(tmp_path / "recipes"), str(tmp_path / "study.toml"), *more]
        done = subprocess.run([*command, "--runs", str(runs)], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        (folder,) = runs.iterdir()
        names.add(folder.name)
        metrics.append(json.loads((folder / "metrics.json").read_text()))
        assert json.loads((folder / "manifest.json").read_text())["devices"] == (2 if more[0] == "--devices" else 1)
    assert metrics[0] == metrics[1]
    assert len(names) == 1


def test_the_hash_does_not_know_devices():
    config = configs.load(ROOT / "configs" / "smoke" / "quickstart.toml")
    assert config.devices == 1
    several = configs.load(ROOT / "configs" / "smoke" / "quickstart.toml", ["devices=3"])
    assert several.devices == 3
    assert configs.digest(several) == configs.digest(config)
    with pytest.raises(configs.ConfigError, match="devices: expected greater than or equal to 1, got 0"):
        configs.load(ROOT / "configs" / "smoke" / "quickstart.toml", ["devices=0"])


def test_more_devices_than_there_are_is_an_error():
    with pytest.raises(ValueError, match="expected 1000 devices, got a machine on which JAX has 1"):
        runner.start(1000)


@pytest.mark.parametrize("count", [1, 3])
def test_items_of_a_stage_are_kept_one_by_one(tmp_path, count):
    threads, fail = set(), ["c"]

    def compute(name):
        if name in fail:
            raise KeyboardInterrupt
        threads.add(threading.get_ident())
        computed.append(name)
        return np.asarray([len(name)])

    def found():
        record = Record(tmp_path, 0, Voice(Console(file=io.StringIO())), jax.devices()[:1] * count)
        return record.stage_each({name: (name,) for name in "abcd"}, compute, "items")

    computed: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        found()
    before = {path.name for path in (tmp_path / "stages").iterdir()}
    assert before == {f"{name}.npz" for name in computed}
    assert "c.npz" not in before
    fail.clear()
    assert [one.tolist() for one in found()] == [[1]] * 4
    assert sorted(computed) == list("abcd")


@pytest.mark.parametrize("name", [slow_unless(False, "compact_scattered")])
def test_a_study_measures_the_same_on_two_devices(tmp_path, data, name):
    metrics = []
    for devices in ("1", "2"):
        runs = tmp_path / devices
        done = subprocess.run(
            [sys.executable, "-m", "experiments", f"configs/smoke/{name}.toml", "--runs", runs, "--devices", devices],
            cwd=ROOT, capture_output=True, text=True, env=os.environ, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        (folder,) = runs.iterdir()
        metrics.append(json.loads((folder / "metrics.json").read_text()))
    assert metrics[0].keys() == metrics[1].keys()
    for key, value in metrics[0].items():
        assert metrics[1][key] == pytest.approx(value, rel=1e-9), key
