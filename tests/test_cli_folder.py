"""`hshjax fit` of a folder: results, summaries, a page; what it says and how it ends."""

import csv
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from hshjax.brdfs import OrenNayar
from hshjax.cli import app
from hshjax.cli._devices import several_devices, threads_on_devices
from hshjax.cli._spheres import _exposure
from hshjax.io import save_model
from tests.io import text_formats

SMALL = ("--order", 1, "--degree", 8)


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def folder(tmp_path):
    """Two materials and what is none, in a folder with brackets and HTML in its names."""
    top = tmp_path / "in[old]"
    top.mkdir()
    save_model(top / "red & <i>.x", OrenNayar(0.5, 0.3))
    shutil.copy(top / "red & <i>.x", top / "second")
    (top / "README").write_text("materials")
    return top


def test_a_folder_is_fitted_reported_and_gone_on_with(folder, tmp_path):
    out = tmp_path / "out"
    done = run("fit", folder, *SMALL, "--out", out)
    assert done.exit_code == 0, done.output + done.stderr
    assert "2 done, 1 skipped" in done.stdout
    assert "2/2 second: " in done.stderr
    assert "skipped: README (no material: a file that begins with b'materials')" in done.stderr
    assert {path.name for path in out.iterdir()} == {
        "red & <i>.x", "second", "report.html", "summary.csv", "summary.json",
    }  # fmt: skip
    assert {path.name for path in (out / "second").iterdir()} == {"metrics.json", "model.hshjax", "spheres.png"}
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    assert "red &amp; &lt;i&gt;.x" in page
    assert "<i>" not in page
    # The figures of a single fit, and three keys more.
    assert run("fit", folder / "second", *SMALL, "--out", tmp_path / "one").exit_code == 0
    one, two = (json.loads((place / "metrics.json").read_text()) for place in (tmp_path / "one", out / "second"))
    assert two.keys() - one.keys() == {"summary", "source", "files"}
    assert {key: two[key] for key in one} == one
    assert (tmp_path / "one" / "model.hshjax").read_bytes() == (out / "second" / "model.hshjax").read_bytes()
    refused = run("fit", folder, *SMALL, "--norm", "A", "--out", out)
    assert refused.exit_code == 1
    assert "was made with norm D, not A (and 1 more like that): --force" in refused.stderr
    # Again, with one more that is broken.
    before = {path: path.stat().st_mtime_ns for path in out.rglob("metrics.json")}
    (folder / "broken").write_bytes(text_formats.ALTA.replace(b"2.5", b"x"))
    again = run("fit", folder, *SMALL, "--out", out, "--devices", 2, "--json")
    assert again.exit_code == 1
    assert json.loads(again.stdout)["counts"] == {"done": 2, "failed": 1, "missing": 0, "skipped": 1}
    assert "error: 1 of 3 materials were not fitted" in again.stderr
    assert "expected a number, got 'x'" in again.stderr
    assert "Traceback" not in again.stderr
    assert {path: path.stat().st_mtime_ns for path in out.rglob("metrics.json")} == before
    with (out / "summary.csv").open(newline="") as file:
        assert [row["status"] for row in csv.DictReader(file)] == ["skipped", "failed", "done", "done"]
    assert "Not fitted" in (out / "report.html").read_text()


def test_bad_input_and_misuse_are_told_apart(folder, tmp_path):
    empty, out = tmp_path / "empty", tmp_path / "out"
    empty.mkdir()
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "report.html").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    for arguments, status, message in (
        (("fit", folder), 2, "is a folder: say by --out"),
        (("fit", folder, "--out", tmp_path / "x.hshjax"), 2, "more than one model"),
        (("fit", folder, "--out", out, "--picture", "x.png"), 2, "--picture is for one material"),
        (("fit", folder / "second", "--out", out, "--devices", 2), 2, "are for a folder"),
        (("fit", folder / "second", "--out", out, "--recursive"), 2, "are for a folder"),
        (("fit", folder, "--out", out, "--devices", 0), 2, "--devices"),
        (("fit", empty, "--out", out), 1, "expected at least one material"),
        (("fit", folder, "--out", tmp_path / "no" / "where"), 1, "there is no folder"),
        (("fit", folder, "--out", folder, "--force"), 1, "is what is read"),
        (("fit", folder, "--out", tmp_path / "own"), 1, "report.html is there already: --force"),
    ):
        done = run(*arguments)
        assert done.exit_code == status, (arguments, done.output, done.stderr)
        assert message in done.stderr.replace("\n", " ")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_is_listed(folder):
    done = run("info", folder)
    assert done.exit_code == 0, done.output + done.stderr
    assert "2 materials of 3 entries" in " ".join(done.stdout.split())  # titles are wrapped, and filled up
    assert "saved model" in done.stdout
    listed = json.loads(run("info", folder, "--json").stdout)
    assert listed["materials"] == 2
    assert {one["name"]: one["kind"] for one in listed["entries"]} == {
        "README": "other", "red & <i>.x": "material", "second": "material",
    }  # fmt: skip
    for arguments in (("info", folder, "--energy"), ("info", folder / "second", "--recursive")):
        assert run(*arguments).exit_code == 2


def test_ctrl_c_leaves_a_summary_of_what_is_missing(folder, tmp_path, monkeypatch):
    out, whole = tmp_path / "out", []

    def stopping(path, *_):
        if whole:
            raise KeyboardInterrupt
        whole.append(path)
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(8) + b"\0\0\0\1\0\0\0\1")

    with monkeypatch.context() as patched:
        patched.setattr("hshjax.cli._fit_folder.save_spheres", stopping)
        done = run("fit", folder, *SMALL, "--out", out)
    assert done.exit_code == 130
    assert "interrupted: 1 of 2 materials are done" in done.stderr
    assert {path.name for path in out.iterdir()} == {"red & <i>.x", "report.html", "summary.csv", "summary.json"}
    assert "Missing" in (out / "report.html").read_text()
    assert run("fit", folder, *SMALL, "--out", out).exit_code == 0
    with monkeypatch.context() as patched:  # before anything is begun
        patched.setattr("hshjax.fitting._folder.planned", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
        done = run("fit", folder, *SMALL, "--out", out)
    assert done.exit_code == 130
    assert "every file is as it was, or whole" in done.stderr


def test_devices_are_counted(monkeypatch):
    """A CPU takes any number of threads on one device; parts of it are counted as GPUs are."""
    assert len(set(threads_on_devices(5))) == 1
    assert len(several_devices(1)) == 1
    with pytest.raises(ValueError, match="expected 1000 devices, got a machine on which JAX has 1 of the kind CPU"):
        several_devices(1000)
    monkeypatch.setattr("jax.default_backend", lambda: "gpu")
    with pytest.raises(ValueError, match="expected 7 devices, got a machine"):
        threads_on_devices(7)
    source = "from hshjax.cli._devices import several_devices as f; print(len(set(f(3))))"
    for flags, count in ((os.environ.get("XLA_FLAGS", ""), 3), ("--xla_force_host_platform_device_count=4", 3)):
        done = subprocess.run(
            [sys.executable, "-c", source], env=os.environ | {"XLA_FLAGS": flags}, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        assert done.stdout.strip() == str(count), done.stderr


@pytest.mark.parametrize(("pixels", "factor"), [(0, 1.0), (1, 0.3), (999, 0.9)])
def test_dark_spheres_are_shown_and_no_reason_to_lose_a_fit(pixels, factor):
    """A highlight on black is exposed by its own brightness."""
    radiance = np.zeros((25, 40, 3))
    radiance.reshape(-1, 3)[1 : 1 + pixels, 1] = 1.0
    radiance[0, 1] *= 3
    radiance[0, 0] = np.nan  # beside the sphere
    assert _exposure(radiance) == pytest.approx(factor)
