"""Series in every pixel that go on with what does not belong to them: it is found out, and nothing is mixed."""

import os
import shutil

import numpy as np
import pytest

from hshjax.fitting import TileError, project_pixels
from hshjax.fitting._checkpoint import Checkpoint
from hshjax.fitting._processes import Processes
from tests.fitting.test_project_pixels import BASIS, LIGHTS, PIXELS, Lazy, photographs, same
from tests.helpers import DTYPE, X64

PART = "coefficients.npy"


def interrupted(**settings):
    """After three tiles of six."""
    with pytest.raises(OSError, match="the disk is gone"):
        project_pixels(BASIS, LIGHTS, Lazy(photographs(), broken=60), rows=20, every=0.0, **settings)


def empty(dtype=DTYPE):
    return np.zeros((PIXELS, BASIS.count, 3), dtype)


def test_other_photographs(tmp_path):
    out = tmp_path / "out.npy"
    interrupted(out=out)
    message = f"was done with other photographs than these: remove {tmp_path}/.out.npy.unfinished to begin anew"
    for verify, tile in (("last", 2), ("all", 0)):
        with pytest.raises(TileError, match=f"tile {tile}: {message}"):
            project_pixels(BASIS, LIGHTS, photographs(seed=1), rows=20, out=out, verify=verify)
    same(project_pixels(BASIS, LIGHTS, photographs(), rows=20, out=out), photographs())


def test_one_other_photograph_among_the_first(tmp_path):
    """Is seen where all are read again, and nothing is fitted for that."""
    out, other = tmp_path / "out.npy", photographs()
    interrupted(out=out)
    other[25, 3, 1] += 0.5
    with pytest.raises(TileError, match="tile 1: was done with other photographs than these"):
        project_pixels(BASIS, LIGHTS, other, rows=20, out=out, verify="all")
    source, said = Lazy(photographs()), []
    fit = project_pixels(
        BASIS, LIGHTS, source, rows=20, out=out, verify="all", on_tile=lambda number, of: said.append(number)
    )
    assert [start for start, _ in source.read[1:]] == list(range(0, PIXELS, 20))
    assert said == [3, 4, 5]
    same(fit, photographs())


def test_photographs_in_another_order_of_memory_are_the_same(tmp_path):
    out, values = tmp_path / "out.npy", photographs()
    interrupted(out=out)
    turned = values.transpose(1, 0, 2).copy().transpose(1, 0, 2)
    same(project_pixels(BASIS, LIGHTS, turned, rows=20, out=out, verify="all"), values)


def test_another_array(tmp_path):
    out = empty()
    interrupted(out=out, checkpoint=tmp_path)
    for other in (empty(), np.full_like(out, np.nan)):
        with pytest.raises(
            TileError, match=r"tile 2: was done, and out does not hold its fit: remove the checkpoint to begin anew"
        ):
            project_pixels(BASIS, LIGHTS, photographs(), rows=20, out=other, checkpoint=tmp_path)
    same(project_pixels(BASIS, LIGHTS, photographs(), rows=20, out=out, checkpoint=tmp_path), photographs())


@pytest.mark.skipif(not X64, reason="values must have more digits than the array")
def test_an_array_of_fewer_digits(tmp_path):
    out = empty(np.float32)
    interrupted(out=out, checkpoint=tmp_path)
    project_pixels(BASIS, LIGHTS, photographs(), rows=20, out=out, checkpoint=tmp_path)
    np.testing.assert_allclose(out, project_pixels(BASIS, LIGHTS, photographs()).coefficients, rtol=1e-5, atol=1e-5)


def test_tiles_that_do_not_come_any_more(tmp_path, monkeypatch):
    out, tiles = tmp_path / "out.npy", np.array_split(photographs(), 5)

    def killed(results):
        raise OSError("the disk is gone")

    with monkeypatch.context() as patch:
        patch.setattr("hshjax.fitting._tile_results.TileResults.publish", killed)
        with pytest.raises(OSError, match="the disk is gone"):
            project_pixels(BASIS, LIGHTS, iter(tiles), pixels=PIXELS, out=out)
    with pytest.raises(TileError, match=r"tile 4: was done, and does not come any more: remove .*unfinished to begin"):
        project_pixels(BASIS, LIGHTS, iter(tiles[:2]), pixels=PIXELS, out=out)
    same(project_pixels(BASIS, LIGHTS, iter(tiles), pixels=PIXELS, out=out), photographs())


def test_two_runs_with_one_path(tmp_path):
    values, out, second = photographs(), tmp_path / "out.npy", []

    def meanwhile(number, of):
        with pytest.raises(ValueError, match=r"out.npy.unfinished is in use by another run: give each a place of its"):
            project_pixels(BASIS, LIGHTS, photographs(seed=1), rows=20, out=out)
        second.append(number)

    same(project_pixels(BASIS, LIGHTS, values, rows=20, out=out, on_tile=meanwhile), values)
    assert second == list(range(6))
    assert [one.name for one in tmp_path.iterdir()] == [out.name]


def test_a_file_that_another_run_has_replaced_is_not_published(tmp_path):
    out, folder = tmp_path / "out.npy", tmp_path / ".out.npy.unfinished"

    def replaced(number, of):
        shutil.copy(folder / PART, folder / "new.npy")
        os.replace(folder / "new.npy", folder / PART)

    with pytest.raises(ValueError, match="is of another run by now: give each an out of its own"):
        project_pixels(BASIS, LIGHTS, photographs(), rows=20, out=out, on_tile=replaced)
    assert not out.exists()


@pytest.mark.parametrize("left", [empty(np.float16), np.zeros((PIXELS, 1, 3), DTYPE)])
def test_a_file_of_another_kind_before_anything_was_done(left, tmp_path):
    out, folder = tmp_path / "out.npy", tmp_path / ".out.npy.unfinished"
    folder.mkdir()
    np.save(folder / PART, left)
    fit = project_pixels(BASIS, LIGHTS, photographs(), rows=20, out=out)
    assert fit.coefficients.dtype == DTYPE
    same(fit, photographs())


def test_the_folder_is_removed_by_one_process_and_nobody_has_a_file_open(tmp_path, monkeypatch):
    """Others that remove theirs at the same time end it with an error."""
    folder, found = tmp_path / ".out.npy.unfinished", []
    monkeypatch.setattr(Processes, "finish", lambda self: found.extend(one.name for one in folder.iterdir()))
    monkeypatch.delattr(Checkpoint, "remove")
    project_pixels(BASIS, LIGHTS, photographs(), rows=20, out=tmp_path / "out.npy")
    assert found == ["blocks-0-of-1.npz"]
    assert not folder.exists()
