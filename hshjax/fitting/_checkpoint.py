"""What a long run has done so far, on disk: whole or not at all."""

import hashlib
import io
import json
import os
import time
import zipfile
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hshjax.io._replace import replacing

RUN = "run"
"""Name of the entry that says which run a state belongs to."""


def fingerprint(**parts: Any) -> dict[str, str]:
    """Words for settings of a run, arrays among them by a digest; and for the precision of jax."""
    words = {}
    for name, part in parts.items():
        arrays = b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(part) if not isinstance(leaf, str))
        digest = f" [{hashlib.sha256(arrays).hexdigest()[:16]}]" if arrays else ""
        words[name] = f"{' '.join(str(part).split())}{digest}"
    return {**words, "default float": jnp.zeros(()).dtype.name}


class Checkpoint:
    """The state of one process of a run, in a file of `folder`.

    - `run`: what the run is of, by name: a state of another run is refused.
    - `index`, `count`: of this process. - `every`: seconds between two writings; 0 writes whenever it may.

    **Raises:** ValueError for a folder that another number of processes has written to, and for `every` < 0.
    """

    def __init__(self, folder: str | PathLike, run: Mapping[str, Any], index: int, count: int, every: float):
        if not every >= 0:
            raise ValueError(f"every must be >= 0 seconds, got {every}")
        self._folder, self._run, self._every = Path(folder), dict(run), every
        self._folder.mkdir(parents=True, exist_ok=True)
        for other in sorted(self._folder.glob("blocks-*-of-*.npz")):
            number = other.stem.rsplit("-", 1)[1]
            if number != str(count):
                raise ValueError(
                    f"{folder} holds what {number} processes have done, and the run has {count} now: take as many, or "
                    "another folder"
                )
        self._path = self._folder / f"blocks-{index}-of-{count}.npz"
        self._last = time.monotonic()

    @property
    def due(self) -> bool:
        """Whether it is time to write."""
        return time.monotonic() - self._last >= self._every

    def load(self) -> dict[str, np.ndarray] | None:
        """The state that was written last, or None.

        **Raises:** ValueError for a state of another run, saying in what, and for a damaged file.
        """
        if not self._path.exists():
            return None
        try:
            state = unpacked(self._path.read_bytes())
            before = json.loads(str(state.pop(RUN)))
        except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise ValueError(f"{self._path} is damaged ({error}): remove it to begin anew") from error
        for name, now in json.loads(json.dumps(self._run)).items():
            if before.get(name) != now:
                raise ValueError(
                    f"{self._path} is of another run, whose {name} was {before.get(name)} and is {now} now: take "
                    "another folder, or remove the file to begin anew"
                )
        return state

    def save(self, state: Mapping[str, np.ndarray]) -> None:
        """Written beside, onto the disk, and renamed."""
        with replacing(self._path) as beside, beside.open("xb") as file:
            file.write(packed({**state, RUN: np.asarray(json.dumps(self._run))}))
            file.flush()
            os.fsync(file.fileno())
        self._last = time.monotonic()

    def remove(self) -> None:
        """The file; the folder stays, and so does what others have there."""
        self._path.unlink(missing_ok=True)


def packed(state: Mapping[str, np.ndarray]) -> bytes:
    """Arrays as the bytes of an .npz file, in which nothing can be code."""
    file = io.BytesIO()
    np.savez(file, **state)  # pyright: ignore[reportArgumentType]
    return file.getvalue()


def unpacked(message: bytes) -> dict[str, np.ndarray]:
    """What was `packed`."""
    with np.load(io.BytesIO(message), allow_pickle=False) as state:
        return dict(state)
