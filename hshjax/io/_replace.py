"""Files and folders are written beside their place and renamed: a reader never meets half of one."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """A fresh path beside `path` for the body to write; renamed to `path` at the end, removed if the body raises."""
    path = Path(path)
    beside = path.with_name(f".{path.name}.{secrets.token_hex(6)}.partial")
    try:
        yield beside
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


@contextmanager
def replacing_folder(path: str | os.PathLike) -> Iterator[Path]:
    """A fresh folder beside `path` for the body to fill; renamed to it at the end, removed if the body raises.

    Where `path` has files, those of the same names are replaced, one by one, and the others stay.
    """
    out = Path(path).resolve()
    beside = out.with_name(f".{out.name}.{secrets.token_hex(6)}.partial")
    beside.mkdir()
    try:
        yield beside
        if out.is_dir() and any(out.iterdir()):
            for file in sorted(beside.iterdir()):
                os.replace(file, out / file.name)
        else:
            os.replace(beside, out)
    finally:
        shutil.rmtree(beside, ignore_errors=not beside.exists())
