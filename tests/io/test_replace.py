"""What is written lands under its name at once, wherever that name leads."""

import os
from contextlib import nullcontext

import pytest

from hshjax.io._replace import replacing, replacing_folder


@pytest.mark.parametrize("name", ["a", "a" * 255, "ä" * 127], ids=["short", "255 bytes", "254 bytes"])
def test_names_as_long_as_a_file_system_allows(name, tmp_path):
    with replacing(tmp_path / name) as beside:
        beside.write_text("new")
    assert (tmp_path / name).read_text() == "new"
    with replacing_folder(tmp_path / ("b" + name[1:])) as beside:
        (beside / name).write_text("new")
    assert [path.name for path in (tmp_path / ("b" + name[1:])).iterdir()] == [name]


@pytest.mark.parametrize("there", [True, False])
def test_a_link_stays_one_and_its_file_is_replaced(there, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    file, link = tmp_path / "elsewhere" / "file", tmp_path / "link"
    if there:
        file.write_text("old")
    link.symlink_to("elsewhere/file")
    with replacing(link) as beside:
        beside.write_text("new")
    assert link.is_symlink()
    assert file.read_text() == "new"
    assert os.listdir(tmp_path / "elsewhere") == ["file"]


def test_an_error_names_what_was_to_be_written(tmp_path):
    path = tmp_path / "no" / "file"
    with pytest.raises(FileNotFoundError) as caught, replacing(path) as beside:
        beside.write_text("new")
    assert caught.value.filename == str(path)


def test_the_file_that_says_finished_comes_last(tmp_path, monkeypatch):
    """Stopped before any of the renames, there is none of it beside files of another writing."""
    out, replace, renamed = tmp_path / "out", os.replace, []
    out.mkdir()
    for name in ("a", "m", "z"):
        (out / name).write_text("old")

    def stopping(source, target, *, after):
        if len(renamed) == after:
            raise KeyboardInterrupt
        renamed.append(target.name)
        replace(source, target)

    for after in range(4):
        renamed.clear()
        (out / "m").write_text("old")
        monkeypatch.setattr("hshjax.io._replace.os.replace", lambda a, b, n=after: stopping(a, b, after=n))
        with (
            pytest.raises(KeyboardInterrupt) if after < 3 else nullcontext(),
            replacing_folder(out, last="m") as beside,
        ):
            for name in ("a", "m", "z"):
                (beside / name).write_text("new")
        assert renamed == ["a", "z", "m"][:after]
        assert (out / "m").exists() == (after == 3)
    assert {path.name: path.read_text() for path in out.iterdir()} == dict.fromkeys("amz", "new")
    assert not list(tmp_path.glob(".*"))


def test_a_folder_that_another_process_makes_meanwhile_is_filled(tmp_path, monkeypatch):
    out, replace = tmp_path / "out", os.replace

    def raced(source, target):
        if target == out:
            out.mkdir()
            (out / "a").write_text("theirs")
            (out / "m").write_text("theirs")
        replace(source, target)

    monkeypatch.setattr("hshjax.io._replace.os.replace", raced)
    with replacing_folder(out, last="m") as beside:
        (beside / "a").write_text("new")
        (beside / "m").write_text("new")
    assert {path.name: path.read_text() for path in out.iterdir()} == {"a": "new", "m": "new"}
    assert not list(tmp_path.glob(".*"))
