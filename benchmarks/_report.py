"""What a benchmark writes: JSON, a Markdown table and a plot."""

import json
import os
import platform
from pathlib import Path
from typing import Any

import jax


def machine(cores: list[int], rates: dict[str, float]) -> dict[str, Any]:
    """What the figures of a run belong to."""
    return {
        "processor": processor(), "cores": len(cores), "load": round(os.getloadavg()[0], 1),
        "time": "of the processor" if len(cores) == 1 else "on the wall", "python": platform.python_version(),
        "jax": jax.__version__, "bandwidth [GB/s]": rates["bandwidth"] / 1e9,
        "float32 [multiply-adds/ns]": rates["float32"] / 1e9, "float64 [multiply-adds/ns]": rates["float64"] / 1e9,
    }  # fmt: skip


def processor() -> str:
    """Its name, or the system's word for its kind."""
    info = Path("/proc/cpuinfo")
    names = [line for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    return names[0].split(":", 1)[1].strip() if names else platform.processor() or platform.machine()


def line(row: dict[str, Any]) -> str:
    """Of one row, while others are measured."""
    ratio = f"{row['ratio'][1]:7.3f} of {row['peer']}" if "ratio" in row else ""
    name = f"{row['verb']}, {row['basis']} {row['order']}, {row['points']} x {row['channels']}, {row['dtype']}"
    return f"{name:60s}{row['ns']:9.3f} ns {ratio}"


def table(machine: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """Markdown: the machine, and a line for every row."""
    stated = ", ".join(
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in machine.items()
    )
    head = (
        "| verb | basis | order | points | channels | dtype | ns a point and function | of the peer (quartiles) | "
        "peer | of the limit | compile [s] | peak [MB] | largest error |"
    )
    lines = [f"{stated}.", "", head, "|" + "---|" * (head.count("|") - 1)]
    for row in rows:
        low, middle, high = row.get("ratio", (None,) * 3)
        cells = (
            row["verb"], row["basis"], row["order"], f"{row['points']:.0e}".replace("e+0", "e"), row["channels"],
            row["dtype"], f"{row['ns']:.3g}", f"{middle:.3g} ({low:.3g}-{high:.3g})" if middle else "",
            row.get("peer", ""), f"{row['limit']:.3g}, {row['limited by']}", f"{row['compile ours [s]']:.2f}",
            f"{row['peak ours [MB]']:.0f}", "" if row["error"] is None else f"{row['error']:.1e}",
        )  # fmt: skip
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


def write(folder: Path, name: str, machine: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    """`name` with .json, .md and .png in the folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(
        json.dumps({"machine": machine, "rows": rows}, indent=1) + "\n", encoding="utf-8"
    )
    (folder / f"{name}.md").write_text(table(machine, rows), encoding="utf-8")
    draw(rows, folder / f"{name}.png")


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Time a point and function against order, points and channels; all but one as in the first case of order 8."""
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained", sharey=True)
    held = {"order": 8, "points": 100_000, "channels": 3}
    colours = {label: f"C{k}" for k, label in enumerate(sorted({_label(row) for row in rows}))}
    drawn = {}
    for axis, name in zip(axes, held, strict=True):
        others = {key: value for key, value in held.items() if key != name}
        series: dict[str, dict[int, float]] = {}
        for row in sorted(rows, key=lambda row: row["points"]):  # of an order, the row of most points stays
            # Higher orders have fewer points, for memory's sake.
            alike = all(row[key] == value for key, value in others.items() if (name, key) != ("order", "points"))
            if alike and (name == "points" or 10_000 <= row["points"] <= held["points"]):
                series.setdefault(_label(row), {})[row[name]] = row["ns"]
        for label, points in sorted(series.items()):
            if len(points) > 1:
                found = axis.plot(*zip(*sorted(points.items()), strict=True), colours[label], marker="o", markersize=3)
                drawn[label] = found[0]
        axis.set(xlabel=name, yscale="log")
        if name != "order":
            axis.set_xscale("log")
    axes[0].set_ylabel("time [ns a point and function]")
    if drawn:
        figure.legend(drawn.values(), drawn, loc="outside right center", fontsize=7)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _label(row: dict[str, Any]) -> str:
    return f"{row['basis']}, {row['verb']}, {row['dtype']}"
