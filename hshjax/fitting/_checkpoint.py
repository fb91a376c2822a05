"""What a long run has done so far, on disk: whole or not at all."""

import hashlib
import io
import json
import os
import re
import time
import zipfile
from collections.abc import Mapping
from contextlib import AbstractContextManager
from os import PathLike
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hshjax.fitting._lock import held
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

    **Raises:** ValueError for a folder that another number of processes has written to, or that is a file, and for
    `every` < 0.
    """

    def __init__(self, folder: str | PathLike, run: Mapping[str, Any], index: int, count: int, every: float):
        if not every >= 0:
            raise ValueError(f"every must be >= 0 seconds, got {every}")
        self._folder, self._run, self._every = Path(folder), dict(run), every
        if self._folder.exists() and not self._folder.is_dir():
            raise ValueError(f"a checkpoint must be a folder, and {folder} is none")
        self._folder.mkdir(parents=True, exist_ok=True)
        for other in sorted(self._folder.iterdir()):
            named = re.fullmatch(r"blocks-\d+-of-(\d+)\.npz", other.name)
            if named is not None and int(named[1]) != count:
                raise ValueError(
                    f"{folder} holds what {named[1]} processes have done, and the run has {count} now: take as many, "
                    "or another folder"
                )
        self._path = self._folder / f"blocks-{index}-of-{count}.npz"
        self._last = time.monotonic()

    def held(self) -> AbstractContextManager[None]:
        """For the body, no other run has this place: two would mix what they have done; see `_lock.held`."""
        return held(self._path.with_suffix(".lock"))

    @property
    def due(self) -> bool:
        """Whether it is time to write."""
        return time.monotonic() - self._last >= self._every

    def load(self, *needed: str) -> dict[str, np.ndarray] | None:
        """The state that was written last, or None. `needed`: names of entries that every state has.

        **Raises:** ValueError for a state of another run, saying in what, and for a damaged file.
        """
        if not self._path.exists():
            return None
        try:
            state = unpacked(self._path.read_bytes())
            before = json.loads(str(state.pop(RUN)))
            lacking = [name for name in needed if name not in state]
            if lacking:
                raise ValueError(f"it has no entry {', '.join(lacking)}")
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
