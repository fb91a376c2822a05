"""`hshjax fit FOLDER`: every material of a folder, in resumable results, a summary and a page of spheres."""

import json
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from hshjax.cli._console import BAD_INPUT, INTERRUPTED, Figures, Misuse, complaints, console, failure, typer
from hshjax.cli._devices import threads_on_devices
from hshjax.cli._fit_figures import describe_data, describe_fit
from hshjax.cli._folder_report import write_report
from hshjax.cli._spheres import save_spheres, shown
from hshjax.fitting._folder_summary import REPORT, TABLE, TOTALS


def fit_all(folder: Path, out: Path | None, settings: dict[str, Any], *, devices: int, as_json: bool) -> None:
    """The command on a folder. `settings`: those of `hshjax.fitting.fit_folder`."""
    from hshjax.fitting import fit_folder

    if out is None:
        raise Misuse(f"{folder} is a folder: say by --out where results go")
    if out.suffix == ".hshjax":
        raise Misuse(f"{folder} is a folder, and has more than one model: --out takes a folder, got {out}")
    if not out.absolute().parent.is_dir():
        raise failure(f"{out}: there is no folder {out.absolute().parent}")
    if (out / REPORT).exists() and not (out / TOTALS).exists() and not settings["force"]:
        raise failure(f"{out / REPORT} is there already: --force replaces it")
    several = threads_on_devices(devices) if devices > 1 else None
    before = _stamp(out)
    try:
        with _Bars() as bars:
            fit_folder(folder, out, **settings, devices=several, finish=_finish, watch=bars.watch)
    except KeyboardInterrupt:
        if _stamp(out) == before:  # not one was begun
            raise
        counts = _reported(out)["counts"]
        done = f"{counts['done']} of {counts['done'] + counts['missing']} materials are done"
        raise failure(f"interrupted: {done}, {out / TABLE} says which; the same command goes on", INTERRUPTED) from None
    content = _reported(out)
    if as_json:
        typer.echo((out / TOTALS).read_text(encoding="utf-8"), nl=False)
    else:
        _show(content, out)
    _complain(content, out)


def _stamp(out: Path) -> int:
    """When the last summary was written; 0 where there is none."""
    return (out / TOTALS).stat().st_mtime_ns if (out / TOTALS).exists() else 0


def _reported(out: Path) -> dict[str, Any]:
    """What the summary says, after a page of it has been written."""
    content = json.loads((out / TOTALS).read_text(encoding="utf-8"))
    with complaints.status("writing the report"):
        write_report(out, content)
    return content


def _finish(beside: Path, item: Any) -> dict[str, Any]:
    """What a result has beside the model: spheres.png, and the figures of a single fit."""
    figures = Figures()
    beyond = describe_data(figures, item.data, item.findings)
    describe_fit(figures, item.model, item.fit, item.errors, beyond)
    save_spheres(beside / "spheres.png", *shown(item.data, item.fit.model))
    return figures.values


class _Bars:
    """A bar over files with the time that is left, and a line for each that fails; without a terminal a line a file."""

    def __init__(self) -> None:
        columns = (
            TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            TextColumn("left"), TimeRemainingColumn(),
        )  # fmt: skip
        self._bars = Progress(*columns, console=complaints, transient=True, speed_estimate_period=3600)

    def __enter__(self) -> "_Bars":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars.live.is_started:  # to stop what has not begun prints an empty line
            self._bars.stop()

    def watch(self, count: int, total: int, row: dict[str, Any] | None) -> None:
        if row is None:
            if total and complaints.is_terminal:
                self._bars.start()
                self._bars.add_task("materials", total=total)
            return
        if complaints.is_terminal:
            self._bars.update(self._bars.task_ids[-1], completed=count)
        if row["status"] == "failed":
            complaints.print(Text(f"{row['name']}: {row['reason']}", style="red"), soft_wrap=True)
        elif not complaints.is_terminal:
            complaints.print(f"{count}/{total} {row['name']}: {row['seconds']:.1f} s", soft_wrap=True)


def _show(content: dict[str, Any], out: Path) -> None:
    """Totals and the worst materials, and where everything is."""
    table = Table(title=Text(f"{content['folder']}: {content['options']['model']}"), title_justify="left")
    for name in ("", "mean", "median", "worst", "of"):
        table.add_column(name, justify="left" if name in ("", "of") else "right", overflow="fold")
    for name, total in content["totals"].items():
        if total is not None:
            numbers = (f"{total[key]:.4g}" for key in ("mean", "median", "worst"))
            table.add_row(name.replace("_", " "), *numbers, Text(total["worst_name"]))
    counts = content["counts"]
    console.print(", ".join(f"{count} {status}" for status, count in counts.items() if count))
    if counts["done"]:
        console.print(table)
    console.print(f"folder: {out} ({TABLE}, {TOTALS}, {REPORT})", soft_wrap=True)


def _complain(content: dict[str, Any], out: Path) -> None:
    """What was passed over, in a line; exits with 1 where a material failed."""
    skipped = [row for row in content["materials"] if row["status"] == "skipped"]
    if skipped:
        names = "; ".join(f"{row['name']} ({row['reason']})" for row in skipped[:3])
        more = f"; and {len(skipped) - 3} more" if len(skipped) > 3 else ""
        complaints.print(f"skipped: {names}{more}", soft_wrap=True)
    counts = content["counts"]
    if counts["failed"]:
        of = counts["failed"] + counts["done"]
        raise failure(f"{counts['failed']} of {of} materials were not fitted: {out / TABLE} says why", BAD_INPUT)
