"""Programs that the command compiled are there when it is run again."""

import os
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import pytest

import hshjax
from hshjax.io import save_model


def told(tmp_path: Path, home: Path) -> str:
    """What `hshjax info` says of a model, with the user's cache directory somewhere else; warnings are errors."""
    basis = hshjax.IsotropicBasis(hshjax.HSH(2))
    save_model(tmp_path / "m.hshjax", hshjax.LinearBRDF(basis, jnp.ones((basis.count, 1))))
    environment = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}
    places = {"XDG_CACHE_HOME": str(home), "HOME": str(home), "LOCALAPPDATA": str(home)}
    run = "import sys; from hshjax.cli import main; sys.argv = ['hshjax', 'info', 'm.hshjax']; main()"
    command = [sys.executable, "-W", "error::UserWarning", "-c", run]
    done = subprocess.run(command, env=environment | places, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    return done.stdout


def test_programs_are_kept(tmp_path):
    home = tmp_path / "home"
    first = told(tmp_path, home)
    kept = {path.name for path in home.rglob("*-cache")}
    assert kept
    assert told(tmp_path, home) == first
    assert {path.name for path in home.rglob("*-cache")} == kept  # nothing was compiled anew


@pytest.mark.slow
def test_a_home_that_cannot_be_written_is_no_hindrance(tmp_path):
    home = tmp_path / "file"
    home.write_text("no folder")
    assert "LinearBRDF" in told(tmp_path, home)
    assert home.read_text() == "no folder"
