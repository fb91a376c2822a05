"""A script in the environment of a peer: arrays in, arrays out."""

import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from experiments.peers._environments import environment
from experiments.peers._errors import PeerError, PeerUnavailableError
from experiments.peers._llvm import VARIABLE, llvm_library

TAIL = 2000

SCRIPTS = Path(__file__).parent


def run(
    name: str, script: str, inputs: Mapping[str, Any], *, llvm: bool = False, here: bool = False
) -> dict[str, np.ndarray]:
    """What `<script>.py` of this folder answers to arrays, numbers and strings, in a process of its own.

    They travel in `.npz` files without pickle, see `exchange.answer`. `llvm`: the script needs LLVM's library. `here`:
    it needs this library as well, and runs in this environment, which has the peer if the extra of its name is
    installed.

    **Raises:** PeerError with the end of what a failing script said; PeerUnavailableError; ValueError for inputs that
    cannot travel.
    """
    return run_each(name, script, [inputs], llvm=llvm, here=here)[0]


def run_each(
    name: str, script: str, inputs: Sequence[Mapping[str, Any]], *, llvm: bool = False, here: bool = False
) -> list[dict[str, np.ndarray]]:
    """`run` for several inputs, one after another in one process: what it loads and compiles serves all of them."""
    several = [{key: np.asarray(value) for key, value in one.items()} for one in inputs]
    for key, array in chain.from_iterable(arrays.items() for arrays in several):
        if array.dtype.kind not in "biufU" or key in ("file", "allow_pickle"):  # names of savez's own arguments
            raise ValueError(f"input {key!r} of {array.dtype} cannot travel")
    if here and importlib.util.find_spec(name) is None:
        raise PeerUnavailableError(f'{name} is to run beside this library: pip install ".[{name}]"')
    python = sys.executable if here else environment(name)
    variables = os.environ | ({VARIABLE: llvm_library()} if llvm else {})
    with tempfile.TemporaryDirectory(prefix="hshjax-peer-") as folder:
        pairs = [tuple(Path(folder) / f"{part}-{k}.npz" for part in ("given", "wanted")) for k in range(len(several))]
        for (given, _), arrays in zip(pairs, several, strict=True):
            np.savez(given, **arrays)
        path = SCRIPTS / f"{script}.py"
        # -E and -s: packages of this project's environment must not be seen in the other.
        done = subprocess.run(
            [str(python), "-E", "-s", str(path), *map(str, chain.from_iterable(pairs))],
            capture_output=True, text=True, check=False, env=variables,
        )  # fmt: skip
        if done.returncode or not all(wanted.exists() for _, wanted in pairs):
            said = (done.stderr.strip() or done.stdout.strip())[-TAIL:]
            raise PeerError(f"{script} of {name} ended with status {done.returncode}:\n{said}")
        return [_read(wanted) for _, wanted in pairs]


def _read(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return {key: file[key] for key in file.files}
