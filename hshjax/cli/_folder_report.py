"""report.html of `hshjax fit FOLDER`: the spheres of every result beside its figures, on one page without a script."""

from pathlib import Path
from typing import Any, NamedTuple

from hshjax.cli._page import Picture, environment
from hshjax.fitting._folder_summary import REPORT
from hshjax.io._replace import replacing

FIGURES = {
    "coefficients": "coefficients",
    "relative_error_A": "error, norm A",
    "relative_error_D": "error, norm D",
    "relative_error_E": "error, norm E",
    "log_error": "log error",
    "largest_albedo": "largest albedo",
    "seconds": "seconds",
}
"""Columns of the summary that the page shows, and what it calls them."""

WIDTH = 320
"""Of a picture of two spheres on the page [CSS pixels]."""


class Card(NamedTuple):
    """A fitted material on the page."""

    name: str
    figures: list[str]
    picture: Picture | None


def write_report(out: Path, content: dict[str, Any]) -> None:
    """The page of what summary.json holds, beside it."""
    rows = content["materials"]
    cards = [_card(out, row) for row in rows if row["status"] == "done"]
    others = {
        title: [row for row in rows if row["status"] == status]
        for status, title in (("failed", "Not fitted"), ("missing", "Missing"), ("skipped", "No materials"))
    }
    totals = [
        (FIGURES.get(name, name), *(f"{total[key]:.4g}" for key in ("mean", "median", "worst")), total["worst_name"])
        for name, total in content["totals"].items()
        if total is not None
    ]
    options = {name: value for name, value in content["options"].items() if value not in (None, [])}
    page = environment(__file__).get_template("folder.html").render(
        content=content, options=options, headings=list(FIGURES.values()), cards=cards, totals=totals, others=others,
    )  # fmt: skip
    with replacing(out / REPORT) as beside:
        beside.write_text(page, encoding="utf-8")


def _card(out: Path, row: dict[str, Any]) -> Card:
    values = (row[name] for name in FIGURES)
    figures = ["–" if v is None else f"{v:.4g}" if isinstance(v, float) else str(v) for v in values]
    path = out / row["name"] / "spheres.png"  # not there where Python made the result
    if not path.exists():
        return Card(row["name"], figures, None)
    picture = Picture(path.read_bytes())
    return Card(row["name"], figures, picture._replace(scale=min(1.0, WIDTH / 2 / picture.size[1])))
