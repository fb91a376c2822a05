"""A folder of materials: as each by itself, resumable, and nothing half-written or of other options taken for done."""

import csv
import json
import os
import shutil
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import OrenNayar
from hshjax.fitting import compare, fit_folder, fit_material
from hshjax.fitting._folder_results import settled, sweep
from hshjax.io import load_model, read_material, save_model
from tests.helpers import DTYPE, X64, assert_close
from tests.io import text_formats

SMALL = {"basis": IsotropicBasis(HSH(1)), "degree": 8}


@pytest.fixture
def folder(tmp_path):
    """Two tables, a broken file and what is no material."""
    top = tmp_path / "in"
    top.mkdir()
    for name, albedo in (("red", [0.5, 0.2, 0.1]), ("grey", [0.4, 0.4, 0.4])):
        save_model(top / name, OrenNayar(jnp.asarray(albedo, DTYPE), jnp.asarray(0.3, DTYPE)))
    (top / "broken").write_bytes(text_formats.ALTA.replace(b"2.5", b"x"))
    (top / "README").write_text("materials")
    return top


def stamps(out):
    return {path.parent.name: path.stat().st_mtime_ns for path in out.glob("*/metrics.json")}


def test_results_are_those_of_each_material(folder, tmp_path):
    out, seen = tmp_path / "out", []
    found = fit_folder(folder, out, **SMALL, watch=lambda *told: seen.append(told))
    assert found.counts == {"done": 2, "failed": 1, "missing": 0, "skipped": 1}
    assert [(done, total) for done, total, _ in seen] == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert [row["name"] for row in found.rows] == ["README", "broken", "grey", "red"]
    assert "line 8, column 4: expected a number, got 'x'" in found.rows[1]["reason"]
    for row in found.rows[2:]:
        one = fit_material(read_material(folder / row["name"]).data, **SMALL)
        errors = compare(one.samples, one.model)
        kept = load_model(out / row["name"] / "model.hshjax")
        assert_close(kept.coefficients, one.model.coefficients)
        metrics = json.loads((out / row["name"] / "metrics.json").read_text())
        assert_close(metrics["relative_error_E"], errors.errors["E"])
        assert row["relative_error_A"] == pytest.approx(float(np.mean(errors.errors["A"])), rel=1e-4)
        assert row["largest_albedo"] == pytest.approx(float(np.max(errors.albedo)), rel=1e-5)
        assert (row["status"], row["coefficients"], row["channels"]) == ("done", 12, 3)
        assert metrics["source"]["options"]["basis"] == str(SMALL["basis"])


def test_summaries_say_the_same(folder, tmp_path):
    found = fit_folder(folder, tmp_path / "out", **SMALL)
    content = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert content == found.summary
    with (tmp_path / "out" / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row, told in zip(rows, content["materials"], strict=True):
        assert row == {key: "" if value is None else str(value) for key, value in told.items()}
    errors = {row["name"]: row["log_error"] for row in found.rows if row["status"] == "done"}
    total = content["totals"]["log_error"]
    assert total["mean"] == total["median"] == pytest.approx(sum(errors.values()) / 2)
    assert total["worst"] == errors[total["worst_name"]] == max(errors.values())


def test_what_is_done_is_not_done_again(folder, tmp_path):
    out = tmp_path / "out"
    first = fit_folder(folder, out, **SMALL)
    before = stamps(out)
    assert set(before) == {"red", "grey"}
    again = fit_folder(folder, out, **SMALL, norm="D")  # the default, said
    assert again.summary == first.summary
    shutil.rmtree(out / "red")
    shutil.copy(folder / "grey", folder / "new")
    third = fit_folder(folder, out, **SMALL)
    assert third.counts["done"] == 3
    after = stamps(out)
    assert after["grey"] == before["grey"]
    assert after["red"] != before["red"]


def test_other_options_and_contents_need_force_which_does_what_differs(folder, tmp_path):
    out = tmp_path / "out"
    fit_folder(folder, out, **SMALL)
    before = stamps(out)
    with pytest.raises(ValueError, match=r"grey was made with norm D, not A \(and 1 more like that\): --force"):
        fit_folder(folder, out, **SMALL, norm="A")
    save_model(folder / "red", OrenNayar(jnp.asarray([0.1], DTYPE), jnp.asarray(0.3, DTYPE)))
    with pytest.raises(ValueError, match=r"red is of another content of the file: --force"):
        fit_folder(folder, out, **SMALL)
    (out / "red" / "notes").write_text("mine")
    assert stamps(out) == before
    assert fit_folder(folder, out, **SMALL, force=True).counts["done"] == 2
    after = stamps(out)
    assert after["grey"] == before["grey"]
    assert after["red"] != before["red"]
    assert load_model(out / "red" / "model.hshjax").coefficients.shape == (4, 1)
    assert (out / "red" / "notes").read_text() == "mine"
    with jax.enable_x64(not X64), pytest.raises(ValueError, match="dtype"):
        fit_folder(folder, out, **SMALL)


@pytest.mark.parametrize(
    "content", [None, "", "{}", "[]", '{"source": 1, "summary": {}}', '{"source": {"options": {}}, "summary": 0}']
)
def test_what_is_no_finished_result_is_not_taken_for_one(folder, tmp_path, content):
    place = tmp_path / "out" / "red"
    place.mkdir(parents=True)
    (place / "model.hshjax").write_text("half")
    if content is not None:
        (place / "metrics.json").write_text(content)
    with pytest.raises(ValueError, match="red is there, and no finished result of a folder of materials"):
        fit_folder(folder, tmp_path / "out", **SMALL)
    assert (place / "model.hshjax").read_text() == "half"


@pytest.mark.parametrize("devices", [None, [jax.devices()[0]] * 2], ids=["here", "threads"])
def test_an_interrupt_keeps_what_is_done_and_says_what_is_missing(folder, tmp_path, devices):
    out = tmp_path / "out"

    def stopped(count, total, row):
        if row is not None and row["status"] == "done":
            raise KeyboardInterrupt

    shutil.rmtree(out, ignore_errors=True)
    for k in range(6):
        shutil.copy(folder / "grey", folder / f"grey {k}")
    with pytest.raises(KeyboardInterrupt):
        fit_folder(folder, out, **SMALL, devices=devices, watch=stopped)
    content = json.loads((out / "summary.json").read_text())
    done = {row["name"] for row in content["materials"] if row["status"] == "done"}
    assert done == set(stamps(out))
    assert content["counts"]["missing"] >= 4
    assert {path.name for path in out.iterdir()} == done | {"summary.csv", "summary.json"}
    before = stamps(out)
    assert fit_folder(folder, out, **SMALL).counts["done"] == 8
    assert before.items() <= stamps(out).items()


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), OSError("no space left"), TypeError("a fault")])
def test_what_stops_a_result_in_the_making_leaves_none(folder, tmp_path, stop):
    def finish(beside, item):
        (beside / "picture").write_text("half")
        raise stop

    with pytest.raises(type(stop)):
        fit_folder(folder, tmp_path / "out", **SMALL, finish=finish)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"summary.csv", "summary.json"}


def test_a_material_whose_picture_cannot_be_made_has_failed_alone(folder, tmp_path):
    def finish(beside, item):
        if item.name == "red":
            raise ValueError("too red")
        return {"seen": item.errors.samples}

    found = fit_folder(folder, tmp_path / "out", **SMALL, finish=finish)
    assert [(row["name"], row["reason"]) for row in found.rows if row["status"] == "failed"][1] == ("red", "too red")
    assert json.loads((tmp_path / "out" / "grey" / "metrics.json").read_text())["seen"] > 0


def test_the_tree_is_kept_and_results_within_are_no_materials(folder):
    (folder / "cloth").mkdir()
    shutil.move(folder / "red", folder / "cloth" / "red")
    for results in ({}, {"fits": "skipped"}):
        found = fit_folder(folder, folder / "fits", recursive=True, **SMALL)
        assert {row["name"]: row["status"] for row in found.rows} == {
            "README": "skipped", "broken": "failed", "cloth/red": "done", "grey": "done", **results,
        }  # fmt: skip
    assert (folder / "fits" / "cloth" / "red" / "model.hshjax").exists()


def test_what_was_left_half_written_long_ago_is_removed(folder, tmp_path):
    out = tmp_path / "out"
    for name, age in (("a", 7200), ("b", 10)):
        beside = out / "cloth" / f".hshjax-{name}.partial"
        beside.mkdir(parents=True)
        (beside / "model.hshjax").write_text("half")
        (out / f".hshjax-{name}.partial").write_text("half")
        for path in (beside, out / beside.name):
            os.utime(path, (time.time() - age,) * 2)
    fit_folder(folder, out, **SMALL)
    left = [path.relative_to(out).as_posix() for path in sorted(out.rglob(".*"))]
    assert left == [".hshjax-b.partial", "cloth/.hshjax-b.partial"]


def test_a_material_named_like_a_summary_has_failed(folder, tmp_path):
    shutil.copy(folder / "grey", folder / "summary.csv")
    for _ in range(2):
        found = fit_folder(folder, tmp_path / "out", **SMALL)
        assert {row["name"]: row["status"] for row in found.rows}["summary.csv"] == "failed"
        assert (tmp_path / "out" / "summary.csv").is_file()


def test_what_would_be_lost_or_makes_no_sense_is_refused(folder, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "in2" / "in2").mkdir(parents=True)
    shutil.copy(folder / "grey", tmp_path / "in2" / "in2" / "in2")
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "summary.csv").write_text("mine")
    (tmp_path / "own2").mkdir()
    (tmp_path / "own2" / "red").write_text("mine")
    (tmp_path / "empty").mkdir()
    for source, out, message in (
        (folder, folder, "results go into another folder"),
        (folder, tmp_path / "file", "is a file"),
        (tmp_path / "in2" / "in2", tmp_path / "in2", "would replace what is read"),
        (folder, tmp_path / "own2", "red is a file"),
        (tmp_path / "empty", tmp_path / "out", "at least one material, got nothing"),
    ):
        before = sorted(tmp_path.rglob("*"))
        with pytest.raises(ValueError, match=message):
            fit_folder(source, out, **SMALL, force=True)
        assert sorted(tmp_path.rglob("*")) == before
    with pytest.raises(ValueError, match=r"summary.csv is there without summary.json"):
        fit_folder(folder, tmp_path / "own", **SMALL)
    with pytest.raises(TypeError, match="ordr"):
        fit_folder(folder, tmp_path / "out", ordr=3)
    (tmp_path / "empty" / "README").write_text("nothing")
    with pytest.raises(ValueError, match="none among 1, the first is README: no material"):
        fit_folder(tmp_path / "empty", tmp_path / "out")


@pytest.mark.parametrize("content", [None, b"", b"other"])
def test_a_result_without_its_model_is_not_taken_for_done(folder, tmp_path, content):
    out = tmp_path / "out"
    fit_folder(folder, out, **SMALL)
    model = out / "red" / "model.hshjax"
    whole = model.read_bytes()
    model.unlink()
    if content is not None:
        model.write_bytes(content)
    with pytest.raises(ValueError, match="red is there, and no finished result"):
        fit_folder(folder, out, **SMALL)
    before = stamps(out)
    assert fit_folder(folder, out, **SMALL, force=True).counts["done"] == 2
    assert len(model.read_bytes()) == len(whole)
    assert stamps(out)["grey"] == before["grey"]


def test_files_of_another_fit_do_not_stay_beside_this_one(folder, tmp_path):
    def pictured(beside, item):
        (beside / "picture").write_text("of norm D")
        return {}

    out = tmp_path / "out"
    fit_folder(folder, out, **SMALL, finish=pictured)
    (out / "red" / "notes").write_text("mine")
    metrics = json.loads((out / "grey" / "metrics.json").read_text())
    metrics["files"] |= {"../red/notes": ""}
    (out / "grey" / "metrics.json").write_text(json.dumps(metrics))
    fit_folder(folder, out, **SMALL, norm="A", force=True)
    for name, more in (("red", {"notes"}), ("grey", set())):
        assert {path.name for path in (out / name).iterdir()} == {"model.hshjax", "metrics.json"} | more


def test_the_summary_is_there_before_the_first_fit(folder, tmp_path, monkeypatch):
    out, begun = tmp_path / "out", []

    def finish(beside, item):
        content = json.loads((out / "summary.json").read_text())
        begun.append((item.name, content["counts"]["missing"]))
        return {}

    fit_folder(folder, out, **SMALL, finish=finish)
    assert begun == [("grey", 3), ("red", 3)]

    def full(*_):
        raise OSError("no space left")

    monkeypatch.setattr("hshjax.fitting._folder.write_summary", full)
    with pytest.raises(OSError, match="no space left"):
        fit_folder(folder, tmp_path / "other", **SMALL, finish=finish)
    assert len(begun) == 2


def test_numbers_of_numpy_and_jax_are_settings(folder, tmp_path):
    first = fit_folder(folder, tmp_path / "out", **SMALL, ridge=0.25, coefficients=7)
    again = fit_folder(folder, tmp_path / "out", **SMALL, ridge=np.float64(0.25), coefficients=np.int64(7).item())
    assert again.summary == first.summary
    assert settled({"a": np.int64(7), "b": jnp.asarray(0.25), "c": (np.float32(0.5),)})["options"] == {
        "a": 7, "b": 0.25, "c": [0.5], "dtype": np.dtype(DTYPE).name,
    }  # fmt: skip


def test_what_lies_where_results_go_is_told_before_the_first_fit(folder, tmp_path):
    (folder / "sub").mkdir()
    shutil.move(folder / "red", folder / "sub" / "red")
    for name in ("a", "b", "c", "d"):
        (tmp_path / name).mkdir()
    (tmp_path / "a" / "sub").write_text("mine")
    (tmp_path / "b" / "grey").symlink_to("nowhere")
    (tmp_path / "c" / "report.html").mkdir()
    (tmp_path / "d" / ".hshjax-a.partial").symlink_to(folder)
    for name, message in (("a", "sub is a file"), ("b", "grey is a link to nothing"), ("c", "report.html is a folder")):
        with pytest.raises(ValueError, match=message):
            fit_folder(folder, tmp_path / name, **SMALL, recursive=True, force=True)
        assert len(list((tmp_path / name).iterdir())) == 1
    with pytest.raises(ValueError, match="devices must be those of jax"):
        fit_folder(folder, tmp_path / "e", **SMALL, devices=[0, 1])
    assert not (tmp_path / "e").exists()
    os.utime(tmp_path / "d" / ".hshjax-a.partial", (0, 0), follow_symlinks=False)
    sweep(tmp_path / "d")
    assert not list((tmp_path / "d").iterdir())
    assert (folder / "grey").exists()


def test_another_model_is_refused_before_anything_is_read(folder, tmp_path, unchecked):
    with pytest.raises(ValueError, match="model must be one of linear"):
        fit_folder(folder, tmp_path / "out", "lambert")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"norm": "Z"}, "norm must be one of A, B, C, D, E"),
        ({"ridge": np.inf}, "ridge must be finite and >= 0, got inf"),
        ({"ridge": -1.0, "model": "exp"}, "ridge must be finite and >= 0, got -1.0"),
        ({"constraints": ("positive",)}, "constraints must be a tuple of names among"),
        ({"basis": HSH(2)}, "a basis of pairs of directions, .* got HSH"),
        ({"devices": 2}, "devices must be a list of those of jax, such as jax.devices(), got 2"),
    ],
)
def test_settings_that_fit_no_material_are_no_fault_of_each(settings, message, folder, tmp_path, unchecked):
    with pytest.raises((ValueError, TypeError), match=message.replace("()", r"\(\)")):
        fit_folder(folder, tmp_path / "out", **SMALL | settings)
    assert not (tmp_path / "out").exists()
