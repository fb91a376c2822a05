"""Runs over blocks in several processes, some of which do not live to the end."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.fitting import SampleBlocks, coordinator, project_blocks, project_pixels
from tests.fitting.test_project_blocks import arrays
from tests.helpers import X64, directions, slow_unless

ROOT = Path(__file__).parents[2]
BLOCKS = 30
TIMEOUT = 4.0
"""Seconds: of a machine that has much else to do, too."""
NAMES = ("wi", "wo", "value", "weight")

pytestmark = pytest.mark.skipif(not X64, reason="the processes compute in float64")


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def run(folder, of, devices=1, port=None, **of_process):
    """All processes of a run to their end: `(exit code, output, errors)` of each. `of_process`: arguments `p0` ...

    `port`: of a coordination service that runs already.
    """
    beside, port, started = port is not None, port or free_port(), []
    cache = {
        "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".pytest_cache" / "jax"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    for p in range(of):
        arguments = ["--process", p, "--of", of, "--port", port, "--devices", devices, "--folder", folder]
        command = [sys.executable, "-m", "tests.fitting.process_of_blocks", *map(str, arguments)]
        command += [str(word) for word in of_process.get(f"p{p}", ())] + ["--beside"] * beside
        started.append(
            subprocess.Popen(
                command, cwd=ROOT, env=os.environ | cache, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            )
        )
    ended = []
    for process in started:
        out, errors = process.communicate(timeout=120)
        ended.append((process.returncode, out, errors))
    return ended


@pytest.fixture
def folder(tmp_path):
    for name, array in zip(NAMES, arrays(), strict=True):
        np.save(tmp_path / f"{name}.npy", array)
    return tmp_path


def assert_all_fitted(folder, ended):
    blocks = SampleBlocks(*arrays(), rows=100, isotropic=True)
    expected = project_blocks(IsotropicBasis(HSH(2)), blocks)
    for p, (code, _, errors) in enumerate(ended):
        assert code == 0, errors
        with np.load(folder / f"fit-{p}.npz") as found:
            np.testing.assert_allclose(found["coefficients"], expected.model.coefficients, rtol=1e-10, atol=1e-10)
            np.testing.assert_allclose(found["residual"], expected.residual, rtol=1e-10)
    assert not list(folder.glob("checkpoint/*"))


def blocks_said(out):
    return [int(line.split()[1]) for line in out.splitlines() if line.startswith("block ")]


@pytest.mark.parametrize("of", [2, slow_unless(False, 4)])
def test_a_killed_process_is_named_and_a_restart_goes_on(folder, of):
    waiting = {f"p{p}": ("--timeout", TIMEOUT) for p in range(of)}
    waiting["p1"] = ("--timeout", TIMEOUT, "--kill-after", 3)
    start = time.monotonic()
    ended = run(folder, of, devices=2, **waiting)
    assert time.monotonic() - start < 60
    assert ended[1][0] == -signal.SIGKILL
    for p in set(range(of)) - {1}:
        code, _, errors = ended[p]
        assert code == 3, errors
        lost = "ProcessError: process 1 has not reported for 4 s; the blocks that are in are kept in "
        assert f"{lost}{folder}/checkpoint: the same command goes on after them" in errors
    assert not list(folder.glob("fit-*"))

    again = run(folder, of)  # on another number of devices
    first, second = (blocks_said(one[1][1]) for one in (ended, again))
    assert first == [1, 1 + of, 1 + 2 * of]
    # Killed after its third block was in, before that was written.
    assert second == list(range(1 + 2 * of, BLOCKS, of))
    assert all(not blocks_said(again[p][1]) for p in range(of) if p != 1), "what was whole is not read again"
    assert_all_fitted(folder, again)


@pytest.mark.slow
def test_an_error_in_one_process_ends_all_and_names_the_block(folder):
    value = np.load(folder / "value.npy")
    good = value.copy()
    value[730], weight = np.nan, np.load(folder / "weight.npy")
    weight[730] = 1
    np.save(folder / "value.npy", value)
    np.save(folder / "weight.npy", weight)
    ended = run(folder, 2)
    assert [code for code, _, _ in ended] == [3, 3]
    assert "BlockError: block 7: 1 of" in ended[1][2]
    assert "ProcessError: process 1 has ended with an error (BlockError: block 7: 1 of" in ended[0][2]
    np.save(folder / "value.npy", good)
    weight[730] = arrays()[3][730]
    np.save(folder / "weight.npy", weight)
    again = run(folder, 2)
    assert blocks_said(again[1][1]) == list(range(7, BLOCKS, 2))
    assert_all_fitted(folder, again)


@pytest.mark.slow
def test_the_first_process_is_killed(folder):
    """jax ends the others within seconds, in words of its own: its coordination service lives in the first."""
    ended = run(folder, 2, p0=("--kill-after", 2), p1=("--timeout", TIMEOUT))
    assert ended[0][0] == -signal.SIGKILL
    assert ended[1][0] != 0
    assert "another task died" in ended[1][2] or "does not answer" in ended[1][2]
    assert_all_fitted(folder, run(folder, 2))


@pytest.fixture
def beside():
    """The port of a coordination service in a process of its own, for three."""
    port = free_port()
    script = f"""
import sys
from hshjax import coordinator
with coordinator({port}, 3):
    print("up", flush=True)
    sys.stdin.read()
"""
    command = [sys.executable, "-c", script]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=ROOT, text=True, **pipes) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        yield port
        process.communicate("", timeout=30)
    assert process.returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("killed", [0, 1])
def test_beside_a_coordinator_any_process_may_be_killed(killed, folder, beside):
    """The others say so in time, and end as Python does."""
    words = {f"p{p}": ("--timeout", TIMEOUT) for p in range(3)}
    words[f"p{killed}"] += ("--kill-after", 2)
    start = time.monotonic()
    ended = run(folder, 3, port=beside, **words)
    assert time.monotonic() - start < 60
    assert ended[killed][0] == -signal.SIGKILL
    for p in {0, 1, 2} - {killed}:
        code, _, errors = ended[p]
        assert code == 3, errors
        assert f"ProcessError: process {killed} has not reported for 4 s; the blocks that are in are kept in" in errors
    assert_all_fitted(folder, run(folder, 3))


@pytest.mark.slow
def test_processes_beside_a_coordinator_finish(folder, beside):
    assert_all_fitted(folder, run(folder, 3, port=beside))


@pytest.mark.parametrize(
    ("call", "message"), [((1234, 0), "at least one process, got 0"), ((0, 2), "from 1 to 65535, got 0")]
)
def test_a_coordinator_that_makes_no_sense(call, message):
    with pytest.raises(ValueError, match=message), coordinator(*call):
        pass


def test_a_coordinator_at_a_port_that_is_taken():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(OSError, match="in use"), coordinator(port, 2):
            pass


@pytest.mark.slow
def test_another_number_of_processes_and_another_call_are_refused(folder):
    run(folder, 2, p0=("--timeout", TIMEOUT), p1=("--timeout", TIMEOUT, "--kill-after", 3))
    ended = run(folder, 1)
    assert "holds what 2 processes have done, and the run has 1 now: take as many" in ended[0][2]
    for file in (folder / "checkpoint").iterdir():
        os.unlink(file)
    ended = run(folder, 2, p1=("--order", 3))
    assert all(code == 3 for code, _, _ in ended)
    assert "process 1 of the mesh makes another call" in ended[0][2]


@pytest.mark.slow
def test_samples_that_every_process_has(folder):
    assert_all_fitted(folder, run(folder, 2, devices=2, p0=("--what", "whole"), p1=("--what", "whole")))


@pytest.mark.slow
def test_pixels_of_a_killed_process(folder):
    lights = np.asarray(directions(0, 20, min_z=0.2))
    rng = np.random.default_rng(0)
    values = rng.uniform(0, 1, (103, 20, 3))
    values[rng.random((103, 20)) < 0.03] = np.nan  # some lights in some pixels
    np.save(folder / "lights.npy", lights)
    np.save(folder / "photographs.npy", values)
    pixels, out = ("--what", "pixels", "--timeout", TIMEOUT), folder / "coefficients.npy"
    ended = run(folder, 2, p0=pixels, p1=(*pixels, "--kill-after", 2))
    assert [code for code, _, _ in ended] == [3, -signal.SIGKILL]
    assert "ProcessError: process 1 has not reported for 4 s; the tiles that are done are kept in" in ended[0][2]
    assert not out.exists()
    again = run(folder, 2, p0=pixels, p1=pixels)
    assert [code for code, _, _ in again] == [0, 0], again
    assert blocks_said(again[0][1]) == []
    assert blocks_said(again[1][1]) == [3, 5, 7, 9]
    expected = project_pixels(HSH(2), lights, values)
    np.testing.assert_allclose(np.load(out), expected.coefficients, rtol=1e-10, atol=1e-10)
    for p in range(2):
        with np.load(folder / f"fit-{p}.npz") as found:
            np.testing.assert_allclose(found["residual"], expected.residual, rtol=1e-10)
    assert not list(folder.glob(".coefficients*"))
