"""report.html: one file that needs no other, no script and no network."""

import dataclasses
import math
from typing import Any

from markdown_it import MarkdownIt
from markupsafe import Markup, escape

from hshjax.cli._page import Picture, environment

DIGITS = 4


@dataclasses.dataclass(frozen=True)
class Heading:
    text: str


@dataclasses.dataclass(frozen=True)
class Paragraph:
    text: str


@dataclasses.dataclass(frozen=True)
class Table:
    """Cells by row, in the order of `columns`."""

    file: str
    caption: str
    columns: list[str]
    cells: list[list[float | int | str | bool | None]]

    @property
    def numeric(self) -> list[bool]:
        """Whether a column holds numbers only: those are aligned to the right."""
        return [
            all(
                row[k] is None or (isinstance(row[k], int | float) and not isinstance(row[k], bool))
                for row in self.cells
            )
            for k in range(len(self.columns))
        ]


@dataclasses.dataclass(frozen=True)
class Figure:
    file: str
    caption: str
    picture: Picture


@dataclasses.dataclass(frozen=True)
class Metric:
    name: str
    value: float | int | str | bool | None
    unit: str
    note: str


def number(value: Any) -> str | Markup:
    """A value as the report shows it: floats with four significant digits, None as a dash."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value).replace("-", "\N{MINUS SIGN}")
    if not isinstance(value, float):
        return str(value)
    if not math.isfinite(value):
        return str(value).replace("inf", "∞").replace("-", "\N{MINUS SIGN}")
    if value == 0:
        return "0"
    mantissa, power = f"{value:.{DIGITS - 1}e}".split("e")  # the power after rounding: 0.99999 is 1.000
    exponent = int(power)
    if -3 <= exponent < 6:
        return f"{value:.{max(DIGITS - 1 - exponent, 0)}f}".replace("-", "\N{MINUS SIGN}")
    return Markup(f"{mantissa} × 10<sup>{exponent}</sup>".replace("-", "\N{MINUS SIGN}"))


def _markdown() -> MarkdownIt:
    # Neither raw HTML nor images: nothing in a paragraph can load anything or run.
    return MarkdownIt("commonmark", {"html": False}).disable("image")


def render(
    manifest: dict[str, Any],
    config_toml: str,
    summary: str,
    blocks: list[Heading | Paragraph | Table | Figure],
    metrics: list[Metric],
) -> str:
    """The report as HTML."""
    page = environment(__file__)
    markdown = _markdown()
    page.filters["number"] = number
    page.filters["markdown"] = lambda text: Markup(markdown.render(text))
    page.filters["inline"] = lambda text: Markup(markdown.renderInline(text))
    page.filters["breakable"] = lambda text: Markup(str(escape(text)).replace("_", "_<wbr>").replace("/", "/<wbr>"))
    page.tests["block"] = lambda block, kind: type(block).__name__ == kind
    return page.get_template("report.html").render(
        manifest=manifest, config=config_toml, summary=summary, blocks=blocks, metrics=metrics
    )
