"""Files and folders are written beside their place and renamed: a reader never meets half of one."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

HALF_WRITTEN = ".hshjax-*.partial"
"""The pattern of names beside a place."""


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """A fresh path beside `path` for the body to write; renamed to `path` at the end, removed if the body raises.

    Where `path` is a symbolic link, what it points to is replaced. An OSError of the fresh path names `path`.
    """
    out = Path(os.path.realpath(path))
    beside = _beside(out)
    try:
        yield beside
        os.replace(beside, out)
    except OSError as error:
        if error.filename == os.fspath(beside):
            error.filename = os.fspath(path)
        raise
    finally:
        beside.unlink(missing_ok=True)


@contextmanager
def replacing_folder(path: str | os.PathLike, *, last: str | None = None) -> Iterator[Path]:
    """A fresh folder beside `path` for the body to fill; renamed to it at the end, removed if the body raises.

    Where `path` has files, those of the same names are replaced, one by one, and the others stay. The file `last` is
    removed before the first of them and comes after all: where it is, the others are of the same writing.
    """
    out = Path(path).resolve()
    beside = _beside(out)
    beside.mkdir()
    try:
        yield beside
        if not _renamed(beside, out):
            if last is not None:
                (out / last).unlink(missing_ok=True)
            for file in sorted(beside.iterdir(), key=lambda file: (file.name == last, file.name)):
                os.replace(file, out / file.name)
    finally:
        shutil.rmtree(beside, ignore_errors=not beside.exists())


def _renamed(folder: Path, out: Path) -> bool:
    """Whether a folder got its name: not where there are files in one of that name."""
    if _filled(out):
        return False
    try:
        os.replace(folder, out)
    except OSError:
        if _filled(out):  # by now, by another process
            return False
        raise
    return True


def _filled(folder: Path) -> bool:
    return folder.is_dir() and any(folder.iterdir())


def _beside(path: Path) -> Path:
    """A hidden name in the same folder, as short for long names as for others: file systems end them at 255 bytes."""
    return path.with_name(f".hshjax-{secrets.token_hex(6)}.partial")
