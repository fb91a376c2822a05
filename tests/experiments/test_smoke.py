"""Every recipe runs end to end on its small config, and gives the same metrics for the same seed."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

from experiments import config as configs, recipes
from tests.helpers import slow_unless

ROOT = Path(__file__).parents[2]
SMOKE = sorted((ROOT / "configs" / "smoke").glob("*.toml"))


@pytest.fixture(autouse=True)
def _needed_data(request):
    """Skips a config on measured data where there is none, and one on Mitsuba beside JAX without the extra."""
    path = request.node.callspec.params.get("path") if hasattr(request.node, "callspec") else None
    if isinstance(path, Path) and "$HSHJAX_DATA" in path.read_text(encoding="utf-8"):
        request.getfixturevalue("data")
    if isinstance(path, Path) and path.stem == "mitsuba_plugin" and path.parent == SMOKE[0].parent:
        pytest.importorskip("mitsuba", reason='the extra: pip install ".[mitsuba]"')


def test_every_recipe_has_a_smoke_config():
    used = {line for path in SMOKE for line in path.read_text(encoding="utf-8").splitlines() if "recipe" in line}
    assert [name for name in recipes.available() if f'recipe = "{name}"' not in used] == []


LONG = (
    "compact_ablation",
    "compact_race",
    "compact_scattered",
    "face_relit",
    "harmonic_conversion",
    "joint_recovery",
    "lighting_recovery",
    "material_fit",
    "measured_fits",
    "mitsuba_plugin",
    "mitsuba_spheres",
    "natural_light",
    "paper_basis_sweep",
    "reciprocity_filter",
    "recovery",
    "shape_from_shading",
    "stereo_ablation",
    "stereo_hard",
    "stereo_held_out",
    "stereo_near",
)
"""Their smaller parts are tested by themselves; one makes an environment for another renderer."""

TWICE = ("quickstart",)
"""Run twice, and not once more by itself."""

ALL = sorted((ROOT / "configs").rglob("*.toml"))


@pytest.mark.parametrize("path", ALL, ids=[str(path.relative_to(ROOT)) for path in ALL])
def test_every_config_is_valid(path):
    configs.load(path)


once_is_enough = pytest.mark.skipif(
    os.environ.get("HSHJAX_TEST_DTYPE") == "float32", reason="a config chooses its own precision: once is enough"
)


def run(path, runs):
    """Run a config in a process of its own, for a run configures jax; returns what it measured."""
    cache = {
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    done = subprocess.run(
        [sys.executable, "-m", "experiments", str(path), "--runs", str(runs)],
        cwd=ROOT, capture_output=True, text=True, env=os.environ | cache,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    (folder,) = runs.iterdir()
    assert (folder / "report.html").stat().st_size > 0
    return (folder / "metrics.json").read_text()


@once_is_enough
@pytest.mark.parametrize("path", [slow_unless(path.stem not in (*LONG, *TWICE), path, id=path.stem) for path in SMOKE])
def test_smoke(path, tmp_path):
    assert run(path, tmp_path / "runs") != "{}"


@once_is_enough
@pytest.mark.parametrize("path", [slow_unless(path.stem in TWICE, path, id=path.stem) for path in SMOKE])
def test_the_same_seed_measures_the_same(path, tmp_path):
    assert run(path, tmp_path / "first") == run(path, tmp_path / "second")
