"""Record: what a recipe writes down. Artefacts are written at once, the report and metrics.json at the end."""

import csv
import io
import json
import math
import re
import shutil
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import Mesh

from experiments import stages
from experiments.progress import Voice
from experiments.report import Figure, Heading, Metric, Paragraph, Table, render
from hshjax.cli._page import Picture
from hshjax.fitting._by_turns import by_turns

_Item = TypeVar("_Item")
_Scalar = float | int | str | bool | None

FIGURE_DPI = 140
FIGURE_BYTES = 300_000


class Record:
    """The notebook of one run. Names are unique within a kind and become file names.

    - `folder`: where the run's files lie.
    - `seed`: root of `key` and `rng`.
    - `devices`: of JAX, those that the config asks for; `mesh` is made of them.
    """

    def __init__(self, folder: Path, seed: int, voice: Voice, devices: Sequence[jax.Device] | None = None):
        self.folder = folder
        self.seed = seed
        self.devices = tuple(jax.devices()[:1] if devices is None else devices)
        self._voice = voice
        self._blocks: list[Heading | Paragraph | Table | Figure] = []
        self._metrics: dict[str, Metric] = {}
        self._taken: set[tuple[str, str]] = set()

    # Text

    def heading(self, text: str) -> None:
        """A section of the report."""
        self._blocks.append(Heading(text))

    def paragraph(self, text: str) -> None:
        """Markdown, no HTML: what the paper claims, what was measured, and where the two differ."""
        self._blocks.append(Paragraph(text))

    # Results

    def metric(self, name: str, value: Any, unit: str = "", note: str = "") -> None:
        """One number (or string, or boolean) of metrics.json and of the report's last table.

        **Raises:** ValueError where the number is not finite: a study with such a result has failed.
        """
        self._claim("metric", name)
        scalar = _scalar(value, f"metric {name}")
        if isinstance(scalar, float) and not math.isfinite(scalar):
            raise ValueError(f"metric {name} is {scalar}")
        self._metrics[name] = Metric(name, scalar, unit, note)

    def table(self, name: str, rows: list[dict[str, Any]], caption: str, *, printed: bool = False) -> None:
        """Rows with the same columns, written to `name.csv` in full precision; None is an empty cell.

        `printed`: on standard output too, with four digits.

        **Raises:** ValueError where there are no rows, or where their columns differ.
        """
        if not rows:
            raise ValueError(f"table {name} has no rows")
        columns = list(rows[0])
        for index, row in enumerate(rows):
            if row.keys() != rows[0].keys():
                raise ValueError(f"table {name}: row 0 has columns {columns}, row {index} has {list(row)}")
        cells = [[_scalar(row[c], f"table {name}, row {i}, column {c}") for c in columns] for i, row in enumerate(rows)]
        path = self._file("table", name, "csv")
        text = io.StringIO(newline="")
        csv.writer(text, lineterminator="\n").writerows([columns, *cells])
        stages.write_text(path, text.getvalue())
        self._blocks.append(Table(path.name, caption, columns, cells))
        if printed:
            self._voice.show(columns, [[_printed(cell) for cell in row] for row in cells])

    def figure(self, name: str, figure: Any, caption: str) -> None:
        """A matplotlib figure, written to `name.png` and closed. One above 300 kB is written at a lower resolution."""
        import matplotlib.pyplot as plt

        path = self._file("figure", name, "png")
        dpi = FIGURE_DPI
        content = _png(figure, dpi)
        while len(content) > FIGURE_BYTES and dpi > 50:
            dpi = round(dpi * 0.8)
            content = _png(figure, dpi)
        plt.close(figure)
        stages.write_bytes(path, content)
        # CSS pixels are 1/96 inch: on the page the figure has the size it was drawn for.
        self._blocks.append(Figure(path.name, caption, Picture(content, 96 / dpi)))

    def image(self, name: str, array: Any, caption: str) -> None:
        """An image `(height, width)` or `(height, width, 3)`, written pixel by pixel to `name.png`.

        uint8, or display values in [0, 1]: exposure and display curve are the recipe's to choose and to state.

        **Raises:** ValueError where values lie outside [0, 1] or the shape is not that of an image.
        """
        from matplotlib.image import imsave

        pixels = np.asarray(array)
        if pixels.ndim != 2 and pixels.shape[2:] != (3,):
            raise ValueError(f"image {name}: expected (height, width) or (height, width, 3), got {pixels.shape}")
        if pixels.dtype != np.uint8:
            low, high = float(np.min(pixels)), float(np.max(pixels))
            if not 0 <= low <= high <= 1:
                raise ValueError(f"image {name}: expected display values in [0, 1], got [{low:.4g}, {high:.4g}]")
            pixels = np.round(255 * pixels).astype(np.uint8)
        if pixels.ndim == 2:
            pixels = np.repeat(pixels[..., None], 3, axis=-1)
        path = self._file("image", name, "png")
        buffer = io.BytesIO()
        imsave(buffer, pixels, format="png", metadata={"Software": None})
        stages.write_bytes(path, buffer.getvalue())
        self._blocks.append(Figure(path.name, caption, Picture(buffer.getvalue())))

    # Work

    def stage(self, name: str, compute: Callable[..., Any], *args: Any) -> Any:
        """`compute(*args)`, kept on disk: an interrupted run that is started again reads it instead.

        Arrays (read back as NumPy arrays), numbers, strings, and lists and dicts of those; return the coefficients of a
        model, not the model. Every value passes through the disk's form, so that a resumed run continues exactly as an
        uninterrupted one. What a stage depends on must be in the config or in an earlier stage.

        **Raises:** TypeError where the result is something else; ValueError where the name was used before.
        """
        path = self._file("stage", name, "npz")
        if path.exists():
            self._voice.say(f"{name}: finished before")
        else:
            path.parent.mkdir(exist_ok=True)
            start = time.monotonic()
            stages.save(path, compute(*args))
            self._voice.say(f"{name}: {time.monotonic() - start:.1f} s")
        return stages.load(path)

    def stage_each(
        self, arguments: Mapping[str, tuple[Any, ...]], compute: Callable[..., Any], description: str
    ) -> list[Any]:
        """`stage(name, compute, *arguments[name])` for all names, by turns on the devices: results in the same order.

        `compute` is called in several threads where there are several devices; no result may depend on another.
        """
        paths = {name: self._file("stage", name, "npz") for name in arguments}
        missing = [name for name, path in paths.items() if not path.exists()]
        if len(missing) < len(paths):
            self._voice.say(f"{description}: {len(paths) - len(missing)} finished before")
        (self.folder / "stages").mkdir(exist_ok=True)

        def kept(name: str) -> float:
            start = time.monotonic()
            stages.save(paths[name], compute(*arguments[name]))
            return time.monotonic() - start

        # A CPU that counts as several devices is one all the same: on one of them programs are compiled once.
        turns = self.devices[:1] * len(self.devices) if self.devices[0].platform == "cpu" else self.devices
        with closing(by_turns(kept, missing, turns)) as results:
            for k, seconds in self.progress(results, description, len(missing)):
                self._voice.say(f"{missing[k]}: {seconds:.1f} s")
        return [stages.load(path) for path in paths.values()]

    @property
    def mesh(self) -> Mesh:
        """The devices along one axis, for functions that take a mesh."""
        return Mesh(np.asarray(self.devices), ("devices",))

    def progress(self, iterable: Iterable[_Item], description: str, total: int | None = None) -> Iterator[_Item]:
        """The items of a loop, with a sign of progress on standard error."""
        return self._voice.follow(iterable, description, total)

    def key(self, purpose: str) -> jax.Array:
        """A key of `jax.random` that depends on the run's seed and the purpose, and on nothing else."""
        return jax.random.fold_in(jax.random.key(self.seed), zlib.crc32(purpose.encode()))

    def rng(self, purpose: str) -> np.random.Generator:
        """The same for NumPy on the host."""
        return np.random.default_rng([self.seed, zlib.crc32(purpose.encode())])

    # The end

    def finish(self, manifest: dict[str, Any], config_toml: str, summary: str) -> Path:
        """Writes report.html and, last, metrics.json, whose presence means that the run is done; the report's path."""
        report = self.folder / "report.html"
        metrics = list(self._metrics.values())
        stages.write_text(report, render(manifest, config_toml, summary, self._blocks, metrics))
        values = {metric.name: metric.value for metric in metrics}
        stages.write_text(self.folder / "metrics.json", json.dumps(values, indent=2, allow_nan=False) + "\n")
        # Nobody resumes a finished run.
        shutil.rmtree(self.folder / "stages", ignore_errors=True)
        return report

    def _claim(self, kind: str, name: str) -> None:
        if (kind, name) in self._taken:
            raise ValueError(f"{kind} {name!r} exists already in this run")
        self._taken.add((kind, name))

    def _file(self, kind: str, name: str, suffix: str) -> Path:
        """Path of a new artefact; the name in small letters, anything but letters and digits as a hyphen."""
        stem = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")
        if not stem:
            raise ValueError(f"{kind} needs a name with a letter or a digit in it, got {name!r}")
        self._claim(suffix, stem)
        return self.folder / "stages" / f"{stem}.npz" if kind == "stage" else self.folder / f"{stem}.{suffix}"


def _scalar(value: Any, place: str) -> _Scalar:
    """A plain Python scalar; arrays of one element count as one.

    **Raises:** TypeError that names the place.
    """
    if isinstance(value, np.generic | np.ndarray | jax.Array) and np.size(value) == 1:
        value = np.asarray(value).item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{place}: expected a number, a string or None, got {type(value).__name__} {value!r}")


def _printed(cell: _Scalar) -> str:
    if cell is None:
        return "-"
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def _png(figure: Any, dpi: int) -> bytes:
    buffer = io.BytesIO()
    # Without the version of matplotlib inside, the same figure is the same file.
    figure.savefig(buffer, format="png", dpi=dpi, bbox_inches="tight", metadata={"Software": None})
    return buffer.getvalue()
