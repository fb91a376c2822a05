"""Results of finished stages on disk: one .npz each, arrays beside a JSON tree. Reading one runs no code."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from hshjax.io._replace import replacing

_TREE = "__tree__"
_ARRAY = "__array__"


def write_beside(path: Path, write: Callable[[Path], object]) -> None:
    """Calls `write` on a neighbour of `path` and renames it: at `path` lies the whole file or none."""
    with replacing(path) as beside:
        write(beside)


def write_text(path: Path, text: str) -> None:
    """`write_beside` for text, UTF-8."""
    write_beside(path, lambda beside: beside.write_text(text, encoding="utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """`write_beside` for bytes."""
    write_beside(path, lambda beside: beside.write_bytes(content))


def save(path: Path, value: Any) -> None:
    """Writes dicts with string keys, lists, tuples (read back as lists), numbers, strings, booleans, None and arrays.

    **Raises:** TypeError that names the place of anything else.
    """
    arrays: dict[str, np.ndarray] = {}
    tree = _encode(value, arrays, "result")
    content = {_TREE: np.frombuffer(json.dumps(tree).encode(), np.uint8), **arrays}

    def write(beside: Path) -> None:
        with beside.open("wb") as file:
            np.savez(file, **content)  # no objects among them, see _encode

    write_beside(path, write)


def load(path: Path) -> Any:
    """What `save` wrote; arrays come back as NumPy arrays of their dtype.

    **Raises:** ValueError that names the file, where it is not one of ours.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        return _decode(json.loads(arrays.pop(_TREE).tobytes()), arrays)
    except (KeyError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise ValueError(f"{path}: not the result of a stage ({error}); delete it to compute it again") from error


def _encode(value: Any, arrays: dict[str, np.ndarray], place: str) -> Any:
    # First, for a NumPy float64 is a float too, and would not come back as what it was.
    if isinstance(value, np.generic | np.ndarray | jax.Array):
        array = np.asarray(value)
        if array.dtype.kind not in "biufcU":
            raise TypeError(f"{place}: an array of {array.dtype} cannot be kept")
        name = f"a{len(arrays)}"
        arrays[name] = array
        return {_ARRAY: name}
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str) or key == _ARRAY:
                raise TypeError(f"{place}: keys must be strings, got {key!r}")
        return {key: _encode(item, arrays, f"{place}[{key!r}]") for key, item in value.items()}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list | tuple):
        return [_encode(item, arrays, f"{place}[{index}]") for index, item in enumerate(value)]
    raise TypeError(
        f"{place}: a stage returns arrays, numbers, strings, lists and dicts of those; got {type(value).__name__}. "
        "Return the arrays of a model and build the model from them."
    )


def _decode(tree: Any, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(tree, dict):
        if tree.keys() == {_ARRAY}:
            return arrays[tree[_ARRAY]]
        return {key: _decode(item, arrays) for key, item in tree.items()}
    return [_decode(item, arrays) for item in tree] if isinstance(tree, list) else tree
