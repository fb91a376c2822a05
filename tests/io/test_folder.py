"""What a folder holds is told by content, and nothing in it is left out."""

import os

import pytest

from hshjax.io import list_materials
from tests.io import seeds


@pytest.fixture
def folder(tmp_path):
    """Materials under strange names, and much else."""
    top = tmp_path / "top"
    (top / "b" / "c").mkdir(parents=True)
    (top / ".git").mkdir()
    (top / ".git" / "x.txt").write_bytes(seeds.MEASURED["csv"]())
    (top / "leather").write_bytes(seeds.MEASURED["alta"]())
    (top / "a.jpg").write_bytes(seeds.OTHERS["model"][0]())
    (top / "b" / "x.csv").write_bytes(seeds.MEASURED["csv"]())
    (top / "b" / "c" / "x.csv").write_bytes(seeds.MEASURED["rgl"]())
    (top / ".hidden.csv").write_bytes(seeds.MEASURED["csv"]())
    (top / "README").write_text("materials")
    (top / "empty.bsdf").write_bytes(b"")
    (top / "gone.bsdf").symlink_to("nowhere")
    (top / "linked.csv").symlink_to("b/x.csv")
    (top / "again").symlink_to("b")
    os.mkfifo(top / "pipe")
    (top / "piped.csv").symlink_to("pipe")
    return top


def test_everything_is_listed_with_what_it_is(folder):
    listed = list_materials(folder)
    assert [one.name for one in listed] == sorted(path.name for path in folder.iterdir())
    said = {one.name: (one.kind, one.format or one.reason) for one in listed}
    assert said == {
        ".git": ("other", "hidden"),
        ".hidden.csv": ("other", "hidden"),
        "README": ("other", "no material: a file that begins with b'materials'"),
        "a.jpg": ("material", "saved model"),
        "again": ("other", "a folder: --recursive, or recursive=True, looks into it"),
        "b": ("other", "a folder: --recursive, or recursive=True, looks into it"),
        "empty.bsdf": ("other", "no material: an empty file"),
        "gone.bsdf": ("unreadable", "No such file or directory"),
        "leather": ("material", "ALTA text"),
        "linked.csv": ("material", "CSV with named columns"),
        "pipe": ("other", "neither file nor folder"),
        "piped.csv": ("other", "neither file nor folder"),
    }
    assert all((one.kind == "material") != bool(one.reason) for one in listed)


def test_folders_within_are_looked_into_but_for_links_and_results(folder):
    (folder / "fits").mkdir()
    (folder / "fits" / "x.csv").write_bytes(seeds.MEASURED["csv"]())
    listed = {one.name: one for one in list_materials(folder, recursive=True, without=folder / "b" / ".." / "fits")}
    names = {name for name, one in listed.items() if one.kind == "material"}
    assert names == {"a.jpg", "b/c/x.csv", "b/x.csv", "leather", "linked.csv"}
    assert listed["b/c/x.csv"].path == folder / "b" / "c" / "x.csv"
    assert listed["again"].reason == "a link to a folder"
    assert listed["fits"].reason == "the folder of the results"


def test_a_name_that_cannot_be_written_is_told(tmp_path):
    name = os.path.join(os.fsencode(tmp_path), b"caf\xe9.csv")
    try:
        with open(name, "wb") as file:
            file.write(seeds.MEASURED["csv"]())
    except OSError:
        pytest.skip("a file system that takes UTF-8 only")
    (one,) = list_materials(tmp_path)
    assert one.kind == "unreadable"
    assert one.name == "caf\\udce9.csv"
    assert "no UTF-8" in one.reason


def test_a_folder_that_cannot_be_read_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    for name in ("gone", "file"):
        with pytest.raises(OSError, match=name):
            list_materials(tmp_path / name)
