"""What every script of a peer is: arrays in, arrays out. Runs inside the peer's environment, which has only NumPy."""

import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np


def answer(work: Callable[[dict[str, Any]], Mapping[str, Any]]) -> None:
    """Reads the first file of every pair on the command line, writes what `work` returns to the second, in that order.

    None is pickled. Numbers and strings arrive as such, everything else as arrays.
    """
    for given, wanted in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        with np.load(given, allow_pickle=False) as file:
            inputs = {name: file[name].item() if file[name].ndim == 0 else file[name] for name in file.files}
        with open(wanted, "wb") as file:
            np.savez(file, **work(inputs))
