"""Mitsuba as an oracle: its light by our formula, the process around it, and (slow) spheres lit by both."""

import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from experiments import peers
from experiments.peers import _environments, _process
from experiments.peers.interpolation import mitsuba_radiance, refined
from tests.helpers import DTYPE

IMAGE = np.arange(1, 37, dtype=np.float32).reshape(3, 4, 3) ** 1.5

EVALUATED = (
    ((0.6, 0.0, -0.8), (51.9595, 57.6155, 63.4679)),
    ((0.48, 0.6, -0.64), (32.2164, 36.4165, 40.942)),
    ((-0.6, -0.64, 0.48), (124.1139, 131.5626, 139.163)),
    ((0.0, 0.0, 1.0), (73.4095, 79.7678, 86.3008)),
)
"""Directions and what Mitsuba 3.9.1 (`scalar_rgb`, `envmap.eval`) says that comes from there under IMAGE."""


def test_interpolation_is_that_of_mitsuba():
    w, radiance = map(np.array, zip(*EVALUATED, strict=True))
    np.testing.assert_allclose(mitsuba_radiance(IMAGE, w), radiance, rtol=1e-5)


def test_refined_map_has_the_light_at_its_centres():
    fine = refined(IMAGE, 4)
    centres = hshjax.EnvironmentMap(jnp.asarray(fine, DTYPE), up="y").direction
    np.testing.assert_allclose(fine, mitsuba_radiance(IMAGE, centres), rtol=1e-12)


@pytest.fixture
def ours_as_peer(monkeypatch, tmp_path):
    """Scripts of a folder, run by this interpreter."""
    monkeypatch.setattr(_process, "environment", lambda name: sys.executable)
    monkeypatch.setattr(_process, "SCRIPTS", tmp_path)
    (tmp_path / "exchange.py").write_text((_environments.ROOT / "experiments/peers/exchange.py").read_text())
    return tmp_path


def test_arrays_numbers_and_strings_travel(ours_as_peer):
    (ours_as_peer / "echo.py").write_text(
        "from exchange import answer\nanswer(lambda x: {'sum': x['a'].sum() + x['n'], 'text': x['text'] + '!'})\n"
    )
    answer = peers.run("mitsuba", "echo", {"a": np.arange(3.0), "n": 4, "text": "so"})
    assert answer["sum"] == 7
    assert answer["text"] == "so!"
    with pytest.raises(ValueError, match="'file' of int64 cannot travel"):
        peers.run("mitsuba", "echo", {"file": 1})
    with pytest.raises(ValueError, match="'file' of int64 cannot travel"):
        peers.run_each("mitsuba", "echo", [{"n": 1}, {"file": 1}])
    with pytest.raises(ValueError, match="'a' of object cannot travel"):
        peers.run("mitsuba", "echo", {"a": None})


def test_several_inputs_share_a_process(ours_as_peer):
    (ours_as_peer / "count.py").write_text(
        "import os\nfrom exchange import answer\nanswer(lambda x: {'double': 2 * x['n'], 'process': os.getpid()})\n"
    )
    answers = peers.run_each("mitsuba", "count", [{"n": n} for n in (3, 1, 2)])
    assert [answer["double"] for answer in answers] == [6, 2, 4]
    assert len({int(answer["process"]) for answer in answers}) == 1
    assert peers.run_each("mitsuba", "count", []) == []


def test_a_failing_script_says_why(ours_as_peer):
    (ours_as_peer / "fails.py").write_text("raise SystemExit('no such scene')\n")
    with pytest.raises(peers.PeerError, match=r"fails of mitsuba ended with status 1:\nno such scene"):
        peers.run("mitsuba", "fails", {})


def test_environment_says_what_is_missing(monkeypatch, tmp_path):
    with pytest.raises(ValueError, match="unknown peer 'mitsubishi'; peers: mitsuba"):
        peers.environment("mitsubishi")

    def refuse(command, **_):
        return subprocess.CompletedProcess(command, 2, "", "error: no index")

    monkeypatch.setattr(_environments, "_uv", lambda: "uv")
    monkeypatch.setattr(_environments.subprocess, "run", refuse)
    with pytest.raises(peers.PeerUnavailableError, match=r"(?s)mitsuba==.*package index.*error: no index"):
        peers.environment("mitsuba", cache=tmp_path)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    monkeypatch.setattr(_environments.shutil, "which", lambda *_, **__: None)
    with pytest.raises(peers.PeerUnavailableError, match="make setup"):
        peers.environment("mitsuba", cache=tmp_path)


def test_llvm_is_the_one_that_is_named(monkeypatch, tmp_path):
    library = tmp_path / "libLLVM-19.so"
    library.touch()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    assert peers.llvm_library() == str(library)
    library.unlink()
    with pytest.raises(peers.PeerUnavailableError, match=r"DRJIT_LIBLLVM_PATH is .* which is no file"):
        peers.llvm_library()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "libLLVM.so.19.1")  # what the loader is to find
    assert peers.llvm_library() == "libLLVM.so.19.1"


def test_llvm_is_found_in_the_folder_of_the_peers(monkeypatch, tmp_path):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setenv("HSHJAX_PEERS", str(tmp_path))
    (tmp_path / "llvm" / "lib").mkdir(parents=True)
    for name in ("libLLVM-15.so.1", "libLLVM.so.19.1"):
        (tmp_path / "llvm" / "lib" / name).touch()
    assert peers.llvm_library() == str(tmp_path / "llvm" / "lib" / "libLLVM.so.19.1")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lambert", "ggx"])
def test_spheres_agree(name):
    try:
        peers.environment("mitsuba")
    except peers.PeerUnavailableError as error:
        pytest.skip(str(error))
    rng = np.random.default_rng(3)
    image, w = rng.uniform(0.5, 2, (5, 8, 3)).astype(np.float32), rng.normal(size=(500, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    brdf, inputs = {
        "lambert": (hshjax.Lambert(0.5), {"reflectance": np.full(3, 0.5)}),
        "ggx": (hshjax.GGX(1.0, 0.4), {"alpha": 0.4}),
    }[name]
    common = {"variant": "scalar_rgb", "strategy": "both", "size": 8, "spp": 400, "seed": 1}
    peer = peers.run(
        "mitsuba", "mitsuba_sphere", common | inputs | {"bsdf": name, "environment": image, "directions": w}
    )
    np.testing.assert_allclose(peer["radiance"], mitsuba_radiance(image, w), rtol=2e-5)

    step = (np.arange(8) + 0.5) / 4 - 1
    x, y = np.meshgrid(step, -step)
    np.testing.assert_array_equal(peer["inside"], x * x + y * y < 1)
    x, y = x[peer["inside"]], y[peer["inside"]]
    normals = jnp.asarray(np.stack([x, y, np.sqrt(1 - x * x - y * y)], -1), DTYPE)
    light = hshjax.EnvironmentMap(jnp.asarray(refined(image, 24), DTYPE), up="y")
    ours = np.asarray(hshjax.reflect(brdf, light, normals, jnp.asarray([0, 0, 1], DTYPE)))
    mean, error = peer["mean"][peer["inside"]], peer["error"][peer["inside"]]
    assert np.max(np.abs(ours - mean) / error) < 4.5
    assert np.all(np.abs((ours - mean).sum(0)) < 4 * np.sqrt((error**2).sum(0)))
