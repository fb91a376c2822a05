"""Claim 5, its second half: is HSH cheaper to evaluate than Zernike, at equal order and at equal count?"""

import json
import os
import platform
import statistics
import time
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

from experiments import stages
from experiments.config import RecipeConfig
from experiments.recipes._paper import BLUE, RED, plain
from experiments.record import Record
from hshjax import HSH, IsotropicBasis, Zernike, direction

Orders = Annotated[tuple[Annotated[int, Field(ge=1, le=32)], ...], Field(min_length=1)]


class Config(RecipeConfig):
    recipe: Literal["paper_cost"]
    orders: Annotated[Orders, Field(description="orders of HSH")] = (4, 8, 16)
    points: Annotated[int, Field(ge=1, description="directions, or pairs of directions, a call")] = 20_000
    repeats: Annotated[int, Field(ge=1, description="timed calls, the contestants in turn")] = 15


def run(config: Config, record: Record) -> None:
    cases = [case for order in config.orders for case in _cases(order)]
    calls = {}
    rng = record.rng("directions")
    wi, wo = (_random_directions(rng, config.points) for _ in range(2))
    for label, _, basis, work in record.progress(cases, "compile"):
        calls[label, work] = _call(basis, work, rng, wi, wo)

    times: dict[tuple[str, str], list[float]] = {key: [] for key in calls}
    for _ in record.progress(range(config.repeats), "repeats"):
        # In turn, so that whatever else the machine does hits all contestants alike.
        for key, call in calls.items():
            start = time.perf_counter()
            call()
            times[key].append(time.perf_counter() - start)
    rows = []
    for label, order, basis, work in cases:
        seconds = times[label, work]
        rows.append({
            "work": work, "HSH order": order, "contestant": label.split(" | ")[1], "coefficients": basis.count,
            "median [ns a point]": 1e9 * statistics.median(seconds) / config.points,
            "least [ns a point]": 1e9 * min(seconds) / config.points,
        })  # fmt: skip
    machine = {
        "processor": _processor(), "cores": os.cpu_count(), "device": str(jax.devices()[0]),
        "load at the end": [round(load, 2) for load in os.getloadavg()], "dtype": config.dtype,
    }  # fmt: skip
    content = {"machine": machine, "points": config.points, "seconds": {f"{a}, {b}": t for (a, b), t in times.items()}}
    stages.write_text(record.folder / "times.json", json.dumps(content, indent=2) + "\n")

    def ratio(work, order, contestant):
        median = {
            row["contestant"]: row["median [ns a point]"]
            for row in rows
            if (row["work"], row["HSH order"]) == (work, order)
        }
        return median[contestant] / median["HSH"]

    top = max(config.orders)
    said = "; ".join(
        f"{work}: {ratio(work, top, 'Zernike, equal order'):.2f} at equal order, "
        f"{ratio(work, top, 'Zernike, equal count'):.2f} at equal count"
        for work in WORKS
    )
    record.paragraph(
        "The paper says that HSH avoids the high computational complexity of Zernike polynomials. That holds against "
        "the factorial sum for the radial polynomials, whose cost grows with the order for each of them; by three-term "
        "recurrences both bases take one step a function, and what counts is the number of functions. "
        f"Time of Zernike over that of HSH at HSH order {top}, medians of {config.repeats} in turn: {said}. "
        f"Below 1, Zernike is the faster one. Machine: {machine['processor']}, {machine['cores']} cores, "
        f"{machine['device']}, load {machine['load at the end'][0]} when the run ended; on a shared machine "
        "differences of some ten per cent mean nothing."
    )
    record.figure("times", _draw(config, rows), "Median time of one direction or pair against the order of HSH.")
    record.table("times", rows, f"{config.points} points a call, {config.dtype}; all repeats are in `times.json`.")
    # No times among the metrics: those are what the same seed repeats.
    for label, _, basis, work in cases:
        record.metric(f"{work}, {label}", basis.count, note="coefficients")


WORKS = ("sum", "rows", "isotropic pair sum")


def _cases(order: int) -> list[tuple[str, int, Any, str]]:
    """(label, order of HSH, basis, work); the Zernike basis of equal count is the largest that is not larger."""
    cases = []
    for work in WORKS:
        wrap = IsotropicBasis if work == "isotropic pair sum" else (lambda basis: basis)
        hsh = wrap(HSH(order))
        equal = order
        while wrap(Zernike(equal + 1)).count <= hsh.count:
            equal += 1
        cases += [
            (f"order {order} | HSH", order, hsh, work),
            (f"order {order} | Zernike, equal order", order, wrap(Zernike(order)), work),
            (f"order {order} | Zernike, equal count", order, wrap(Zernike(equal)), work),
        ]
    return cases


def _call(basis, work: str, rng: np.random.Generator, wi, wo):
    """A compiled call that has run once."""
    coefficients = jnp.asarray(rng.standard_normal(basis.count), wi.dtype)
    if work == "rows":
        compiled, arguments = jax.jit(lambda w: basis(w)), (wi,)
    elif work == "sum":
        compiled, arguments = jax.jit(lambda c, w: basis.evaluate(c, w)), (coefficients, wi)
    else:
        compiled, arguments = jax.jit(lambda c, i, o: basis.evaluate(c, i, o)), (coefficients, wi, wo)

    def call():
        compiled(*arguments).block_until_ready()

    call()
    return call


def _random_directions(rng: np.random.Generator, n: int):
    return direction(jnp.asarray(np.arccos(rng.uniform(0, 1, n))), jnp.asarray(rng.uniform(-np.pi, np.pi, n)))


def _processor() -> str:
    """Name of the processor where the system tells it."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
    except OSError:  # not Linux
        names = []
    return names[0] if names else platform.processor() or platform.machine()


def _draw(config: Config, rows):
    figure, axes = plt.subplots(1, len(WORKS), figsize=(3.3 * len(WORKS), 3.4))
    for ax, work in zip(axes, WORKS, strict=True):
        for contestant, color, marker, dashes in (
            ("HSH", RED, "o", "-"), ("Zernike, equal order", BLUE, "s", "-"), ("Zernike, equal count", BLUE, "D", "--"),
        ):  # fmt: skip
            chosen = [row for row in rows if (row["work"], row["contestant"]) == (work, contestant)]
            ax.loglog(
                [row["HSH order"] for row in chosen], [row["median [ns a point]"] for row in chosen],
                color=color, marker=marker, markersize=4, linestyle=dashes, linewidth=1.2, label=contestant,
            )  # fmt: skip
        ax.set_title(work, fontsize=10)
        ax.set_xticks(config.orders, [str(order) for order in config.orders])
        ax.minorticks_off()
        ax.set_xlabel("order of HSH")
        plain(ax)
    axes[0].set_ylabel("ns a point")
    axes[0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    return figure
