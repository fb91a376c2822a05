"""What the race of compact models shows: medians, classes of materials, random pairs, the picture of all models."""

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from experiments.recipes._paper import BLUE, GREEN, ORANGE, PURPLE, RED, plain

Row = dict[str, Any]

BLACK, GREY = "black", "0.5"
LOOKS = {
    "compact": (BLUE, "o", True),
    "half-vector, linear": (PURPLE, "D", True), "half-vector, no warp": (PURPLE, "D", False),
    "HSH": (RED, "s", True), "HSH, log": (RED, "s", False),
    "Zernike": (ORANGE, "h", True), "Zernike, log": (ORANGE, "h", False),
    "GGX": (GREY, "^", True),
    "ABC": (BLACK, "v", True), "ABC, published": (BLACK, "v", False), "SGD, published": (GREY, "P", False),
    "network": (GREEN, "X", True), "network, both ways": (GREEN, "X", False),
}  # fmt: skip
"""Colour, marker, and whether it is full."""

LINEAR, LOGARITHMIC = ("HSH", "Zernike"), ("HSH, log", "Zernike, log")
PRODUCTS = LINEAR + LOGARITHMIC
GIVEN = ("network", "network, both ways", "ABC, published", "SGD, published")
"""Not fitted here, or not to every material."""


def summary(rows: list[Row]) -> list[Row]:
    """Medians of every database, model and number of coefficients."""
    groups = defaultdict(list)
    for row in rows:
        groups[row["database"], row["model"], row["n"]].append(row)
    return [
        {
            "database": database, "model": model, "n": n, "materials": len(group), "log": _median(group, "log"),
            "worst decile": float(np.quantile([row["log"] for row in group], 0.9)), "psnr": _median(group, "psnr"),
            "l2": _median(group, "l2"), "random_pairs_log": _median(group, "random_pairs_log"),
            "max_albedo": float(np.max([row["max_albedo"] for row in group])), "seconds": _median(group, "seconds"),
        }
        for (database, model, n), group in groups.items()
    ]  # fmt: skip


def _median(group: list[Row], key: str) -> float | None:
    values = [row[key] for row in group if row[key] is not None]
    return float(np.median(values)) if values else None


def quarters(glosses: dict[str, float]) -> dict[str, list[str]]:
    """The materials with the least gloss and those with the most, a quarter each, at least one."""
    ranked = sorted(glosses, key=lambda name: glosses[name])
    size = max(1, len(ranked) // 4)
    return {"smoothest": ranked[:size], "sharpest": ranked[-size:]}


def classes(rows: list[Row], glosses: dict[str, float]) -> list[Row]:
    """Medians of both quarters, of every model that was fitted to all materials."""
    groups = defaultdict(list)
    members = quarters(glosses)
    for row in rows:
        for quarter, names in members.items():
            if row["material"] in names and row["model"] not in GIVEN:
                groups[quarter, row["model"], row["n"]].append(row)
    found = [
        {
            "quarter": quarter, "model": model, "n": n, "materials": len(group),
            **{key: _median(group, key) for key in ("log", "psnr", "l2")},
        }
        for (quarter, model, n), group in groups.items()
    ]  # fmt: skip
    return sorted(found, key=lambda row: list(members).index(row["quarter"]))


def said_of_classes(classes: list[Row], glosses: dict[str, float]) -> str:
    """The table of both quarters in words."""
    text, pictures = [], {}
    for quarter, names in quarters(glosses).items():
        rows = [row for row in classes if row["quarter"] == quarter]
        reach = [glosses[name] for name in names]
        best = min(_of(rows, *PRODUCTS), key=lambda row: row["log"])
        (series,) = _of(rows, "half-vector, linear")
        small = min(_of(rows, "GGX", "ABC"), key=lambda row: row["log"])
        pictures[quarter] = [_clearest(_of(rows, *models)) for models in (LINEAR, LOGARITHMIC)]
        text.append(
            f"**The {quarter} quarter** ({len(names)} materials, gloss {min(reach):.3g} to {max(reach):.3g}): "
            f"log error and PSNR are, with n in brackets, {_said(_of(rows, *PRODUCTS))}; "
            f"{_said([series])}; {_said(_of(rows, 'compact'))}; of the lobes {_said([small])}. {best['model']} has the "
            f"least log error of the products: {_enough(rows, best)}. Against the linear half-vector series: "
            f"{_enough(rows, series)}."
        )
    text.append(
        f"Products of functions of one direction are for smooth materials ({pictures['smoothest'][0]}, against "
        f"{pictures['sharpest'][0]} on the sharpest) and for harmonic light: linear in ρ, they alone of these models "
        "have Eq. 1 in closed form (`hshjax.reflect`); the others are summed over emitters. As series of ln ρ they "
        f"lose that, and are clipped lest they explode ({pictures['smoothest'][1]}, and {pictures['sharpest'][1]}). "
        "The half-vector warp is for highlights: a linear series over it is found by one solve, and may be negative; "
        "the exponential of one cannot."
    )
    return "\n\n".join(text)


def _enough(rows: list[Row], rival: Row) -> str:
    """From how many numbers on compact models have no larger error than a rival."""
    enough = [row["n"] for row in _of(rows, "compact") if row["log"] <= rival["log"]]
    return f"compact models are at or below it from n = {min(enough)} on" if enough else "no compact model gets there"


def _of(rows: list[Row], *models: str) -> list[Row]:
    return [row for row in rows if row["model"] in models]


def _clearest(rows: list[Row]) -> str:
    best = max(rows, key=lambda row: row["psnr"])
    return f"{best['psnr']:.3g} dB with {best['model']}"


def _said(rows: list[Row]) -> str:
    return ", ".join(f"{row['model']} ({row['n']}) {row['log']:.3g} and {row['psnr']:.3g} dB" for row in rows)


def random_pairs(rows: list[Row], counts: Sequence[int]) -> tuple[list[Row], dict[str, bool]]:
    """Compact models of some sizes beside the networks, material by material and at the median; and what holds."""
    values: dict[str, dict[Any, float]] = defaultdict(dict)
    for row in rows:
        if row["random_pairs_log"] is not None:
            key = row["n"] if row["model"] == "compact" else row["model"]
            values[row["material"]][key] = row["random_pairs_log"]
    keys = ("network", "network, both ways", *counts)
    values = dict(values) | {"median": {key: float(np.median([v[key] for v in values.values()])) for key in keys}}
    table = []
    for material, found in values.items():
        row: Row = {"material": material, "network": found["network"], "both ways": found["network, both ways"]}
        for n in counts:
            row |= {
                f"n = {n}": found[n],
                f"n = {n} below network": found[n] < found["network"],
                f"n = {n} below both ways": found[n] < found["network, both ways"],
            }
        table.append(row)
    most, fewer = counts[-1], counts[0]
    holds = {
        f"random pairs: every material at n = {most} lies below its network": all(
            row[f"n = {most} below network"] for row in table[:-1]
        ),
        f"random pairs: the median at n = {fewer} lies below that of networks both ways": table[-1][
            f"n = {fewer} below both ways"
        ],
    }
    return table, holds


def said_of_pairs(holds: dict[str, bool]) -> str:
    """What holds, in words."""
    claims = "; ".join(f"{claim.removeprefix('random pairs: ')}: {'yes' if v else 'no'}" for claim, v in holds.items())
    return (
        f"{claims[0].upper()}{claims[1:]}. Measurements are not reciprocal, models are: what a material departs from "
        "reciprocity by, none of them can follow; a network can."
    )


def draw(medians: list[Row]) -> Any:
    """Median log error against n, every model, a panel for each database."""
    with plt.rc_context({"font.size": 11}):
        figure, axes = plt.subplots(1, 2, figsize=(10, 4.3), layout="constrained", sharey=True)
        for ax, database in zip(axes, ("MERL", "RGL"), strict=True):
            for model, (color, marker, full) in LOOKS.items():
                line = sorted(
                    (row["n"], row["log"]) for row in medians if (row["database"], row["model"]) == (database, model)
                )
                face = color if full else "white"
                ax.loglog(*np.reshape(line, (-1, 2)).T, marker + "-", color=color, label=model, ms=8, mfc=face, mew=1.5)
                if model == "compact":
                    *inner, last = line
                    for n, log in inner:
                        ax.annotate(f"{n:g}", (n, log), (-5, -13), textcoords="offset points", ha="right", color=color)
                    ax.annotate(f"{last[0]:g}", last, (8, -4), textcoords="offset points", color=color)
            ax.set(title=database, xlabel="numbers for three channels")
            ax.margins(y=0.08)
            ax.set_xlim(5, 1100)
            ax.set_xticks([10, 30, 100, 300, 1000], ["10", "30", "100", "300", "1000"])
            ax.tick_params(axis="x", which="minor", labelbottom=False)
            plain(ax)
        axes[0].set_ylabel("log error x 1000, median")
        axes[0].yaxis.set_major_formatter("{x:g}")
        figure.legend(*axes[1].get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize=10)
    return figure
