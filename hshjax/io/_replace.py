"""Files are written beside their place and renamed: a reader never meets half a file."""

import os
import secrets
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
