"""Models on disk: one line of JSON, then the bytes of the arrays. Never pickle: a file can name classes, not code.

    {"format": "hshjax-model", "version": 1, "library": ..., "bytes": ..., "crc32": ..., "model": tree}\\n
    the arrays, little-endian, first index slowest, one after the other in the order of the tree

The tree spells a module as {"module": class, "of": home, "fields": {...}}, an array as {"array": dtype,
"shape": [...]} (a numpy array adds "host": true), tuples, lists and dicts as {"tuple": [...]}, {"list": [...]},
{"dict": {...}}, floats that JSON lacks as {"float": "inf"}, and everything else as itself.
"""

import dataclasses
import importlib.metadata
import inspect
import json
import math
import os
import re
import types as python_types
import zlib
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import hshjax.bases
import hshjax.brdfs
from hshjax.io._binary import LARGEST
from hshjax.io._replace import replacing
from hshjax.io.errors import FileFormatError

FORMAT = "hshjax-model"
VERSION = 1
LIBRARY = "hshjax"
NAMESPACES: tuple[python_types.ModuleType, ...] = (hshjax.bases, hshjax.brdfs)
"""A file may name the public modules of these packages."""

DTYPES = frozenset(
    [
        *("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"),
        *("float16", "bfloat16", "float32", "float64", "complex64", "complex128"),
    ]
)
ADDED: dict[str, frozenset[str]] = {
    "HalfVectorBasis": frozenset(["difference_warp"]),
    "HalfVectorTable": frozenset(["measured"]),
    "RGLTable": frozenset(["phi_i"]),
}
"""Fields that classes have got since they could be saved: a file from before means their defaults."""

MARK = re.compile(rb'\{\s*"format"\s*:\s*"' + FORMAT.encode() + b'"')
"""What a saved model begins with; a number of a measured material may begin with the same byte."""

MAX_LINE = 2**24
"""Bytes of line 1: thousands of arrays. A file without an end of line must not exhaust a machine."""

MAX_DIMENSIONS = 32
MAX_ORDER = 512
"""Of a basis: 263 169 functions of one direction. What a file asks for must not exhaust a machine."""
MAX_EMPTY = 2**31
"""Elements that an empty array would have if its empty axes had length 1."""


def sniff(head: bytes) -> bool:
    """Whether a file that begins with `head` is a saved model."""
    return MARK.match(head) is not None


def save_model(path: str | PathLike, model: eqx.Module) -> None:
    """Save a module (a basis, a BRDF, one of your own) bit by bit; written beside and renamed.

    A module is saved by its fields: its class, called with them, must give it back. Fields hold modules, arrays,
    numbers, strings, booleans, None, and tuples, lists and string-keyed dicts of those.

    **Raises:** TypeError for anything else, naming the field; for the result of a fit, of which to save the `model`.
    """
    if type(model).__module__.startswith("hshjax.fitting") and hasattr(model, "model"):
        raise TypeError(f"a {type(model).__name__} is the result of a fit: save its .model")
    writer = _Writer()
    tree = writer.encode(model, type(model).__name__)
    blob = b"".join(writer.blobs)
    header = {
        "format": FORMAT,
        "version": VERSION,
        "library": importlib.metadata.version(LIBRARY),
        "bytes": len(blob),
        "crc32": zlib.crc32(blob),
        "model": tree,
    }
    with replacing(path) as beside, beside.open("xb") as file:
        file.write(json.dumps(header, allow_nan=False).encode() + b"\n")
        file.write(blob)


def load_model(path: str | PathLike, types: Sequence[type[eqx.Module]] = (), *, dtype=None) -> Any:
    """The module that `save_model` saved, bit by bit.

    Only classes that are public in `hshjax.bases` and `hshjax.brdfs`, and those given in `types`, are built, by their
    own constructors. `dtype` casts the floating arrays (say, `jnp.float32` for a float64 model while 64-bit types are
    off); without it nothing is ever cast.

    **Raises:** FileFormatError for a file that is no such model, is damaged, is of a newer version or names an unknown
    class; ValueError where jax's configuration cannot hold a saved type; OSError where the file cannot be opened.
    """
    with Path(path).open("rb") as file:
        line = file.readline(MAX_LINE)
        header = _header(path, line.removesuffix(b"\n"), line.endswith(b"\n"))
        left = os.fstat(file.fileno()).st_size - len(line)
        if left != header["bytes"]:
            what = "truncated" if left < header["bytes"] else "trailing bytes"
            raise FileFormatError(path, "arrays", f"{header['bytes']} bytes after line 1", f"{left} ({what})")
        if left > LARGEST:
            raise FileFormatError(path, "arrays", f"at most {LARGEST} bytes", f"{left}")
        blob = file.read()
    if zlib.crc32(blob) != header["crc32"]:
        raise FileFormatError(path, "arrays", f"bytes of CRC-32 {header['crc32']}", f"{zlib.crc32(blob)}")
    reader = _Reader(path, blob, {t.__name__: t for t in types}, dtype)
    try:
        model = reader.decode(header["model"], "model")
    except RecursionError as error:
        raise FileFormatError(path, "line 1, model", "a tree of sensible depth", "one that is too deep") from error
    if reader.position != len(blob):
        raise FileFormatError(path, "arrays", f"{reader.position} bytes, by the shapes on line 1", f"{len(blob)}")
    if not isinstance(model, eqx.Module):
        raise FileFormatError(path, "line 1, model", "a module", type(model).__name__)
    return model


def _header(path: str | PathLike, line: bytes, ended: bool) -> dict[str, Any]:
    """The first line, checked as far as it concerns the file as a whole."""
    try:
        header = json.loads(line.decode("utf-8"), parse_constant=_refuse)
    except (ValueError, RecursionError):
        header = None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        expected = f'a line of JSON with "format": "{FORMAT}"'
        raise FileFormatError(path, "line 1", expected, f"{line[:40]!r}" if line else "an empty line")
    if not ended:
        raise FileFormatError(path, f"byte {len(line)}", "the end of line 1", "the end of the file")
    version = header.get("version")
    if version != VERSION:
        hint = f" (written by {LIBRARY} {header.get('library')}: a newer one reads it)" if _exceeds(version) else ""
        raise FileFormatError(path, "line 1, version", str(VERSION), f"{version!r}{hint}")
    for name in ("bytes", "crc32"):
        if type(header.get(name)) is not int or header[name] < 0:
            raise FileFormatError(path, f"line 1, {name}", "an integer >= 0", repr(header.get(name)))
    if "model" not in header:
        raise FileFormatError(path, "line 1, model", "a tree", "nothing")
    return header


def _refuse(constant: str):
    raise ValueError(f"{constant} is not JSON")


def _exceeds(version: object) -> bool:
    return isinstance(version, int) and version > VERSION


def _library_class(name: str) -> type[eqx.Module] | None:
    """A public module class of the library by name."""
    if name.startswith("_"):
        return None
    for namespace in NAMESPACES:
        found = vars(namespace).get(name)
        if inspect.isclass(found) and issubclass(found, eqx.Module):
            return found
    return None


class _Writer:
    """Turns values into the tree, and collects the bytes of the arrays on the way."""

    def __init__(self):
        self.blobs: list[bytes] = []

    def encode(self, value: Any, where: str) -> Any:
        if value is None or isinstance(value, bool | str) or type(value) is int:
            return value
        if type(value) is float:
            return value if math.isfinite(value) else {"float": repr(value)}
        if isinstance(value, eqx.Module):
            return self._module(value, where)
        if isinstance(value, jax.Array | np.ndarray):
            return self._array(value, where)
        if type(value) in (tuple, list):
            items = [self.encode(item, f"{where}[{k}]") for k, item in enumerate(value)]
            return {type(value).__name__: items}
        if type(value) is dict and all(isinstance(key, str) for key in value):
            return {"dict": {key: self.encode(item, f"{where}[{key!r}]") for key, item in value.items()}}
        raise TypeError(
            f"{where} cannot be saved: expected modules, arrays, numbers, strings, booleans, None, and tuples, "
            f"lists or string-keyed dicts of those, got {type(value).__name__}"
        )

    def _module(self, module: eqx.Module, where: str) -> dict[str, Any]:
        cls = type(module)
        ours = _library_class(cls.__name__) is cls
        fields = {name: getattr(module, name) for name in _field_names(cls, where)}
        return {
            "module": cls.__name__,
            "of": LIBRARY if ours else cls.__module__,
            "fields": {name: self.encode(value, f"{where}.{name}") for name, value in fields.items()},
        }

    def _array(self, array: jax.Array | np.ndarray, where: str) -> dict[str, Any]:
        if str(array.dtype) not in DTYPES:
            raise TypeError(f"{where} cannot be saved: expected a number type, got {array.dtype}")
        host = np.asarray(array)
        self.blobs.append(host.astype(host.dtype.newbyteorder("<")).tobytes())
        entry = {"array": str(array.dtype), "shape": list(array.shape)}
        return entry if isinstance(array, jax.Array) else entry | {"host": True}


def _field_names(cls: type, where: str) -> tuple[str, ...]:
    """The fields of a module class; TypeError unless its constructor takes exactly them, by name."""
    names = tuple(field.name for field in dataclasses.fields(cls))
    parameters = inspect.signature(cls).parameters
    if set(parameters) != set(names):
        raise TypeError(
            f"{where} cannot be saved: expected {cls.__name__} to be built from its fields ({', '.join(names)}), "
            f"got a constructor that takes ({', '.join(parameters)})"
        )
    return names


class _Reader:
    """Turns the tree into values; `position` is the first byte of the arrays not read yet."""

    def __init__(self, path: str | PathLike, blob: bytes, types: dict[str, type[eqx.Module]], dtype):
        self.path, self.blob, self.types, self.dtype, self.position = path, blob, types, dtype, 0

    def error(self, where: str, expected: str, got: str) -> FileFormatError:
        return FileFormatError(self.path, f"line 1, {where}", expected, got)

    def decode(self, node: Any, where: str) -> Any:
        if node is None or isinstance(node, bool | str | int | float):
            return node
        if not isinstance(node, dict):
            raise self.error(where, "a value or a tagged object", type(node).__name__)
        match node:
            case {"module": str(name), "of": str(home), "fields": dict(fields), **rest} if not rest:
                return self._module(name, home, fields, where)
            case {"array": str(dtype), "shape": list(shape), **rest} if not rest or rest == {"host": True}:
                return self._array(dtype, shape, bool(rest), where)
            case {"float": "inf" | "-inf" | "nan" as text, **rest} if not rest:
                return float(text)
            case {"tuple": list(items), **rest} if not rest:
                return tuple(self.decode(item, f"{where}[{k}]") for k, item in enumerate(items))
            case {"list": list(items), **rest} if not rest:
                return [self.decode(item, f"{where}[{k}]") for k, item in enumerate(items)]
            case {"dict": dict(items), **rest} if not rest:
                return {key: self.decode(item, f"{where}[{key!r}]") for key, item in items.items()}
        raise self.error(where, "a module, array, float, tuple, list or dict", f"an object with keys {sorted(node)}")

    def _module(self, name: str, home: str, fields: dict[str, Any], where: str) -> eqx.Module:
        cls = _library_class(name) if home == LIBRARY else self.types.get(name)
        if cls is None:
            known = "a public class of hshjax.bases or hshjax.brdfs, or one given by types=(...)"
            raise self.error(where, known, f"{name!r} of {home!r}")
        names = {field.name for field in dataclasses.fields(cls)}
        if not names - (ADDED.get(name, frozenset()) if home == LIBRARY else frozenset()) <= set(fields) <= names:
            raise self.error(f"{where}, {name}", f"the fields {sorted(names)}", f"{sorted(fields)}")
        values = {field: self.decode(node, f"{where}.{field}") for field, node in fields.items()}
        order = values.get("order")
        if home == LIBRARY and isinstance(order, int) and order > MAX_ORDER:
            raise self.error(f"{where}.order", f"an order of at most {MAX_ORDER}", str(order))
        try:
            return cls(**values)
        except Exception as error:
            # Whatever a constructor says about the values of a file is a fault of the file.
            raise self.error(where, f"fields that {name} accepts", f"{type(error).__name__}: {error}") from error

    def _array(self, dtype: str, shape: list[Any], on_host: bool, where: str) -> jax.Array | np.ndarray:
        if dtype not in DTYPES:
            raise self.error(f"{where}, array", f"one of {', '.join(sorted(DTYPES))}", repr(dtype))
        left = len(self.blob) - self.position
        if not all(type(n) is int and n >= 0 for n in shape) or len(shape) > MAX_DIMENSIONS:
            raise self.error(f"{where}, shape", f"at most {MAX_DIMENSIONS} integers >= 0", f"{shape}")
        element = np.dtype(jnp.dtype(dtype)).newbyteorder("<")
        count = math.prod(shape)
        # An empty axis hides the others from that product, and numpy refuses absurd ones: they are bounded as well.
        absurd = count == 0 and math.prod(max(n, 1) for n in shape) > MAX_EMPTY
        if count * element.itemsize > left or absurd:
            raise self.error(f"{where}, shape", f"an array of at most {left} bytes", f"{shape} of {dtype}")
        host = np.frombuffer(self.blob, element, count, self.position).reshape(shape)
        self.position += count * element.itemsize
        host = host.astype(element.newbyteorder("="))
        if self.dtype is not None and jnp.issubdtype(host.dtype, jnp.floating):
            host = host.astype(self.dtype)
        return host if on_host else self._on_device(host, where)

    def _on_device(self, host: np.ndarray, where: str) -> jax.Array:
        array = jnp.asarray(host)
        if array.dtype != host.dtype:
            raise ValueError(
                f"{self.path}: {where} is {host.dtype} and jax keeps it as {array.dtype}: set jax_enable_x64, "
                "or pass dtype=jnp.float32 to cast floating arrays"
            )
        return array
