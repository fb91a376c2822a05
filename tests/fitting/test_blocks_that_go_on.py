"""Runs over blocks that go on with what does not belong to them: it is found out, and nothing is mixed."""

import errno
import io

import numpy as np
import pytest

from hshjax.fitting import BlockError, SampleBlocks, project_blocks
from hshjax.fitting._checkpoint import Checkpoint
from hshjax.fitting._lock import held
from tests.fitting.test_project_blocks import BASIS, arrays, blocks_of, interrupted

pytestmark = pytest.mark.usefixtures("unchecked")  # which look into blocks, and so read them


@pytest.mark.parametrize("changed", range(4), ids=["wi", "wo", "value", "weight"])
def test_other_samples(changed, tmp_path):
    interrupted(tmp_path)
    parts = list(arrays())
    parts[changed] = parts[changed].copy()
    if changed < 2:
        parts[changed][:] = parts[changed][::-1]
    else:
        parts[changed][1000] = 0.125  # in the last block that is in
    with pytest.raises(BlockError, match="block 3: is another one than the checkpoint holds: take another folder"):
        project_blocks(BASIS, SampleBlocks(*parts, rows=300, isotropic=True), checkpoint=tmp_path)


def test_one_other_block_among_the_first(tmp_path):
    """Is seen where all are read again; from a sequence and from a generator."""
    interrupted(tmp_path)
    parts = list(arrays())
    parts[2] = parts[2].copy()
    parts[2][350] = 0.125
    with pytest.raises(BlockError, match="block 1: is another one than the checkpoint holds"):
        project_blocks(BASIS, SampleBlocks(*parts, rows=300, isotropic=True), checkpoint=tmp_path, verify="all")
    blocks, said = blocks_of(), []
    project_blocks(BASIS, blocks, checkpoint=tmp_path, verify="all", on_block=lambda number, of: said.append(number))
    assert blocks.read == list(range(10))
    assert said == list(range(4, 10))


def test_a_generator_whose_blocks_are_all_compared(tmp_path):
    def breaking(source):
        yield from source[:4]
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        project_blocks(BASIS, breaking(blocks_of()), checkpoint=tmp_path, every=0.0)
    other = list(blocks_of())
    other[1] = other[2]
    with pytest.raises(BlockError, match="block 1: is another one than the checkpoint holds"):
        project_blocks(BASIS, iter(other), checkpoint=tmp_path, verify="all")
    with pytest.raises(BlockError, match="block 3: is in the checkpoint, and does not come any more"):
        project_blocks(BASIS, iter(blocks_of()[:2]), checkpoint=tmp_path, verify="all")
    got = project_blocks(BASIS, iter(blocks_of()), checkpoint=tmp_path, verify="all")
    np.testing.assert_array_equal(got.samples, project_blocks(BASIS, blocks_of()).samples)


def test_a_generator_that_yields_fewer(tmp_path):
    def breaking():
        yield from blocks_of()[:4]
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        project_blocks(BASIS, breaking(), checkpoint=tmp_path, every=0.0)
    with pytest.raises(BlockError, match="block 3: is in the checkpoint, and does not come any more"):
        project_blocks(BASIS, iter(blocks_of()[:2]), checkpoint=tmp_path)


def test_two_runs_with_one_folder(tmp_path):
    second = []

    def meanwhile(number, of):
        with pytest.raises(ValueError, match="is in use by another run: give each a place of its own"):
            project_blocks(BASIS, blocks_of(), checkpoint=tmp_path)
        second.append(number)

    project_blocks(BASIS, blocks_of(), checkpoint=tmp_path, on_block=meanwhile)
    assert second == list(range(10))
    assert not list(tmp_path.iterdir())


def test_a_folder_is_free_while_a_traceback_lives(tmp_path):
    blocks = blocks_of()
    blocks.broken = 4
    with pytest.raises(OSError, match="the disk is gone") as caught:
        project_blocks(BASIS, blocks, checkpoint=tmp_path, every=0.0)
    project_blocks(BASIS, blocks_of(), checkpoint=tmp_path)
    assert caught.value.__traceback__ is not None


@pytest.mark.parametrize("code", [None, errno.ENOSYS, errno.ENOLCK])
def test_systems_without_locks(code, tmp_path, monkeypatch):
    def refused(file, flags):
        raise OSError(code, "no locks here")

    monkeypatch.setattr("hshjax.fitting._lock.fcntl" + (".flock" if code else ""), refused if code else None)
    with held(tmp_path / "lock"):
        pass
    assert not list(tmp_path.iterdir())


def test_a_lock_that_was_removed_under_it_is_none(tmp_path, monkeypatch):
    path = tmp_path / "lock"
    monkeypatch.setattr("hshjax.fitting._lock.fcntl.flock", lambda file, flags: path.unlink())
    with pytest.raises(ValueError, match="was in use by another run until now: try again"), held(path):
        pass


def test_errors_of_the_disk_stay_errors(tmp_path, monkeypatch):
    def broken(file, flags):
        raise OSError(errno.EIO, "the disk is gone")

    monkeypatch.setattr("hshjax.fitting._lock.fcntl.flock", broken)
    with pytest.raises(OSError, match="the disk is gone"), held(tmp_path / "lock"):
        pass


@pytest.mark.parametrize("name", ["numbers", "total", "kind", "marks"])
def test_a_state_that_lacks_an_entry_is_damaged(name, tmp_path):
    interrupted(tmp_path)
    (file,) = tmp_path.iterdir()
    with np.load(file) as state:
        left = {key: value for key, value in state.items() if key != name}
    written = io.BytesIO()
    np.savez(written, **left)
    file.write_bytes(written.getvalue())
    with pytest.raises(ValueError, match=rf"npz is damaged \(it has no entry {name}\): remove it to begin anew"):
        project_blocks(BASIS, blocks_of(), checkpoint=tmp_path)


def test_a_folder_with_files_of_others_and_a_file_for_a_folder(tmp_path):
    mine = tmp_path / "blocks-of-mine-of-wood.npz"
    mine.write_bytes(b"")
    Checkpoint(tmp_path, {}, 0, 1, 0.0)
    with pytest.raises(ValueError, match=f"a checkpoint must be a folder, and {mine} is none"):
        project_blocks(BASIS, blocks_of(), checkpoint=mine)
