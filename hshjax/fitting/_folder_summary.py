"""The summary of a folder of materials: summary.csv, a row a file, and summary.json, the same with totals."""

import csv
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from hshjax.fitting._compare import JUDGES, Comparison
from hshjax.fitting._folder_results import numbers_of, plain
from hshjax.fitting._material import MaterialFit
from hshjax.io._replace import replacing

KIND = "hshjax fit of a folder"
"""What a summary.json says it is."""

TABLE, TOTALS, REPORT = "summary.csv", "summary.json", "report.html"
"""Of a folder of results; the last is written by `hshjax fit`."""

STATUSES = ("done", "failed", "missing", "skipped")
"""Of a file: fitted; not to be read or fitted; not yet fitted; no material."""

ERRORS = (*(f"relative_error_{norm}" for norm in JUDGES), "log_error")
COLUMNS = (
    *("name", "status", "reason", "format", "model", "channels", "coefficients", "samples"),
    *ERRORS,
    *("largest_albedo", "seconds"),
)
"""Of a row. Errors are means over channels; the albedo is the largest directional one of any channel at 0, 45 and 75
degrees; seconds are those of reading, fitting and judging."""


def line(format: str, model: str, fit: MaterialFit, errors: Comparison, seconds: float) -> dict[str, Any]:
    """What the row of a fitted material says of the fit."""
    assert errors.albedo is not None  # a fit is a model
    means = {f"relative_error_{norm}": float(np.mean(value)) for norm, value in errors.errors.items()}
    return plain({
        "format": format, "model": model, "channels": fit.samples.channels, "coefficients": numbers_of(fit.model),
        "samples": errors.samples, **means, "log_error": float(np.mean(errors.log_error)),
        "largest_albedo": float(np.max(errors.albedo)), "seconds": round(seconds, 3),
    })  # fmt: skip


def row(name: str, status: str, reason: str = "", figures: Mapping[str, Any] = {}) -> dict[str, Any]:
    """A row with all columns; what is not known is None."""
    return dict.fromkeys(COLUMNS) | {"name": name, "status": status, "reason": _told(reason)} | dict(figures)


def _told(words: str) -> str:
    """What a file in UTF-8 can hold: paths may have other bytes."""
    return words.encode("utf-8", "backslashreplace").decode("utf-8")


def summary(folder: Path, settings: dict[str, Any], rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What summary.json holds: counts of every status, totals of the figures of what is done, and all rows."""
    done = [one for one in rows if one["status"] == "done"]
    count = Counter(one["status"] for one in rows)
    return {
        "kind": KIND, "folder": _told(str(folder)), **settings,
        "counts": {status: count[status] for status in STATUSES},
        "totals": {column: _total(done, column) for column in (*ERRORS, "largest_albedo", "seconds")},
        "materials": list(rows),
    }  # fmt: skip


def _total(rows: Sequence[dict[str, Any]], column: str) -> dict[str, Any] | None:
    """Mean, median and the largest, with the file that has it; None where no file has such a figure."""
    known = [(one[column], one["name"]) for one in rows if one[column] is not None]
    if not known:
        return None
    values = [value for value, _ in known]
    worst, name = max(known)
    return {"mean": float(np.mean(values)), "median": float(np.median(values)), "worst": worst, "worst_name": name}


def write_summary(out: Path, content: dict[str, Any]) -> None:
    """Both files; summary.json, which says whose the others are, gets its name first."""
    with ExitStack() as last:
        table, totals = (last.enter_context(replacing(out / name)) for name in (TABLE, TOTALS))
        with table.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(content["materials"])
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        totals.write_text(text + "\n", encoding="utf-8")


def foreign_summary(out: Path) -> str:
    """What lies where a summary is to be written and is none; "" where nothing does."""
    if (out / TOTALS).exists():
        try:
            found = json.loads((out / TOTALS).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            found = None
        ours = isinstance(found, dict) and found.get("kind") == KIND
        return "" if ours else f"{out / TOTALS} is there, and no summary of a folder of materials"
    if (out / TABLE).exists():
        return f"{out / TABLE} is there without {TOTALS} of a folder of materials"
    return ""
