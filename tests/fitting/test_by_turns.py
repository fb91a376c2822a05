"""Work by turns on threads and devices: the same results, each once, and an end when one is asked for."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg  # noqa: F401  loads the library whose threads are counted
from threadpoolctl import threadpool_info

from hshjax.fitting._by_turns import by_turns
from tests.helpers import X64

CPU = jax.devices()[0]


@pytest.mark.parametrize("devices", [None, [CPU], [CPU] * 3], ids=["none", "one", "three"])
def test_every_item_is_done_once_and_in_the_precision_of_the_caller(devices):
    found = dict(by_turns(lambda x: float(jnp.sum(0.1 * jnp.arange(float(x)))), range(20), devices))
    assert found == {k: pytest.approx(0.05 * k * (k - 1), rel=1e-6) for k in range(20)}
    assert list(by_turns(len, [], devices)) == []
    with jax.enable_x64(not X64):
        kinds = {found for _, found in by_turns(lambda _: jnp.zeros(1).dtype, range(6), devices)}
    assert kinds == {np.dtype("float32" if X64 else "float64")}


def test_threads_work_at_the_same_time():
    barrier = threading.Barrier(3, timeout=10)
    assert sorted(k for k, _ in by_turns(lambda _: barrier.wait(), range(6), [CPU] * 3)) == list(range(6))


@pytest.mark.parametrize("devices", [None, [CPU] * 2], ids=["here", "threads"])
def test_an_error_is_raised_and_ends_the_rest(devices):
    begun = []

    def work(k):
        begun.append(k)
        if k == 3:
            raise ArithmeticError("three")
        time.sleep(0.001)  # which the thread that asks for results may need

    with pytest.raises(ArithmeticError, match="three"):
        list(by_turns(work, range(1000), devices))
    assert len(begun) < 1000


def test_the_threads_of_linear_algebra_are_as_many_as_before():
    def limits():
        return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]

    before = limits()
    inside = [found for _, found in by_turns(lambda _: limits(), range(4), [CPU] * 2)]
    assert all(set(one) == {1} for one in inside)
    assert limits() == before


@pytest.mark.parametrize(
    ("devices", "message"), [([], "one device or more, got none"), ([CPU, 1], "those of jax, .* got 1")]
)
def test_what_are_no_devices_is_an_error(devices, message):
    with pytest.raises(ValueError, match=message):
        list(by_turns(len, ["a", "b"], devices))


def test_a_thread_that_cannot_begin_is_not_waited_for(monkeypatch):
    def none(device):
        raise RuntimeError("lost")

    monkeypatch.setattr(jax, "default_device", none)
    with pytest.raises(RuntimeError, match="lost"):
        list(by_turns(len, ["a", "b"], [CPU] * 2))


def test_devices_take_turns_and_agree():
    """A process of its own: JAX is told how many devices a CPU counts for before it starts."""
    source = """
import threading
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_num_cpu_devices", 2)
from hshjax import HSH, OrenNayar, direction
from hshjax.fitting._by_turns import by_turns
meet = threading.Barrier(2, timeout=60)
theta = np.linspace(0, 1.5, 40)
@jax.jit
def fitted(roughness):
    w = direction(jnp.asarray(theta), jnp.asarray(3 * theta))
    design = HSH(2)(w)
    return jnp.linalg.solve(design.T @ design + 0.1 * jnp.eye(9), design.T @ OrenNayar(0.5, roughness)(w, w))
def work(roughness):
    meet.wait()
    coefficients = fitted(roughness)
    return np.asarray(coefficients), coefficients.devices()
items = [0.1, 0.2, 0.3, 0.4]
both = dict(by_turns(work, items, jax.devices()))
assert set.union(*(devices for _, devices in both.values())) == set(jax.devices())
meet = threading.Barrier(1)
for k, (coefficients, _) in by_turns(work, items):
    np.testing.assert_array_equal(coefficients, both[k][0])
"""
    done = subprocess.run(
        [sys.executable, "-c", source], cwd=Path(__file__).parents[2], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
