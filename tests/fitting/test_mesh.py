"""Fits over several devices, in a process of their own: this one has as many as the machine."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hshjax.fitting import device_mesh
from hshjax.fitting._mesh import several_processes
from tests.helpers import slow_unless

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("marked", ["not slow", slow_unless(False, "slow")])
def test_laws_hold_on_eight_devices(marked):
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=8"
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-m",
        marked,
        "tests/fitting/on_devices.py",
    ]
    environment = os.environ | {"XLA_FLAGS": flags.strip()}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600)
    if done.returncode:
        pytest.fail(done.stdout + done.stderr, pytrace=False)


def test_one_device_is_a_mesh_too():
    assert device_mesh(1).size == 1
    assert not several_processes(device_mesh())
    assert not several_processes(None)
