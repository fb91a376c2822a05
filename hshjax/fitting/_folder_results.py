"""Results of a folder of materials on disk: one folder a material, finished where its metrics.json says what of."""

import hashlib
import importlib.metadata
import json
import math
import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import equinox as eqx
import jax

from hshjax.brdfs import AbstractBRDF, LogLinearBRDF
from hshjax.io import save_model
from hshjax.io._replace import HALF_WRITTEN, replacing_folder

MODEL = "model.hshjax"
METRICS = "metrics.json"
"""Of a result; comes last, so that nothing half-written has one."""

ABANDONED = 3600.0
"""Seconds after which what is written beside its place is nobody's: writing a result takes no such time."""

SOURCE, SUMMARY, FILES = "source", "summary", "files"
"""Its keys beside the figures: what it is a result of, its line of the summary, and the SHA-256 of the other files."""


def settled(options: dict[str, Any]) -> dict[str, Any]:
    """Everything a result depends on beside the file, as JSON gives it back."""
    dtype = "float64" if jax.config.jax_enable_x64 else "float32"  # pyright: ignore[reportAttributeAccessIssue]
    version = importlib.metadata.version("hshjax")
    return json.loads(json.dumps(plain({"options": options | {"dtype": dtype}, "version": version})))


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits: a copy is the same material, whatever its date."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def finished(place: Path) -> dict[str, Any] | None:
    """The metrics of a finished result; None where there is nothing.

    **Raises:** ValueError where something else lies there, or the model is gone or not what was written: a file may be
    empty after a power failure.
    """
    if not place.exists() or (place.is_dir() and not any(place.iterdir())):
        return None
    found: Any = None
    try:
        found = json.loads((place / METRICS).read_text(encoding="utf-8"))
        whole = {"options", "version", "sha256"} <= found[SOURCE].keys() and "seconds" in found[SUMMARY]
        whole = whole and found[FILES][MODEL] == digest(place / MODEL)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # not ours, whatever it is
        whole = False
    if not whole:
        raise ValueError(f"{place} is there, and no finished result of a folder of materials")
    return found


def difference(found: dict[str, Any], settings: dict[str, Any], sha256: Callable[[], str]) -> str:
    """In what the source of a finished result is another one; "" where it is the same."""
    source = found[SOURCE]
    old, new = source["options"], settings["options"]
    for name in sorted(old.keys() | new.keys()):
        if old.get(name) != new.get(name):
            return f"was made with {name} {old.get(name)}, not {new.get(name)}"
    if source["version"] != settings["version"]:
        return f"was made by version {source['version']}, not {settings['version']}"
    return "" if source["sha256"] == sha256() else "is of another content of the file"


def refusal(others: Sequence[str]) -> str:
    """The sentence about results that are none of these."""
    more = f" (and {len(others) - 1} more like that)" if len(others) > 1 else ""
    return f"{others[0]}{more}: --force, or force=True, fits anew and replaces what differs"


def write_result(
    place: Path,
    model: AbstractBRDF,
    figures: Callable[[Path], dict[str, Any]],
    line: dict[str, Any],
    source: dict[str, Any],
) -> None:
    """Leaves a whole result at `place`, or what was there. `figures` may write more files into the folder it gets."""
    place.parent.mkdir(parents=True, exist_ok=True)
    with replacing_folder(place, last=METRICS) as beside:
        save_model(beside / MODEL, model)
        metrics = figures(beside) | {SUMMARY: line, SOURCE: source}
        metrics |= {FILES: {file.name: digest(file) for file in sorted(beside.iterdir()) if file.is_file()}}
        text = json.dumps(plain(metrics), indent=1, ensure_ascii=False, allow_nan=False)
        (beside / METRICS).write_text(text + "\n", encoding="utf-8")
        for name in _written(place) - metrics[FILES].keys():  # a picture of another fit, beside this one
            (place / name).unlink(missing_ok=True)


def _written(place: Path) -> set[str]:
    """Names of the files of the result that is there, as far as its metrics say."""
    try:
        names = json.loads((place / METRICS).read_text(encoding="utf-8"))[FILES].keys()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # none, or not ours
        return set()
    return {name for name in names if name == Path(name).name and (place / name).is_file()}


def sweep(out: Path) -> None:
    """Removes what processes that were killed have left half-written, long ago: another one may be at work."""
    for path in out.rglob(HALF_WRITTEN):
        with suppress(FileNotFoundError):  # by now it has its name, or another call has removed it
            old = time.time() - path.lstat().st_mtime > ABANDONED
            if old and path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            elif old:
                path.unlink()


def numbers_of(model: AbstractBRDF) -> int:
    """Coefficients of a series, of all channels; parameters of a lobe."""
    if isinstance(model, LogLinearBRDF):
        return model.count
    coefficients = getattr(model, "coefficients", None)
    if coefficients is not None:
        return coefficients.size
    return sum(leaf.size for leaf in jax.tree.leaves(eqx.filter(model, eqx.is_inexact_array)))


def plain(value: Any) -> Any:
    """Numbers and arrays as those of Python; infinite and NaN become None, for JSON has no such numbers."""
    if isinstance(value, dict):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
