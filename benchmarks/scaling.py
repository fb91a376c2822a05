"""Time and memory against samples, unknowns, materials, pixels and devices: python -m benchmarks.scaling --out DIR

Every point is a fresh process, which warms up (compilation), then measures twice and keeps the better run: seconds of
the wall, seconds of all cores, and the largest resident memory of the process, libraries included. Exponents are the
slopes of least squares in the logarithms, of the seconds of cores: other work on the machine moves those least. Devices
are parts of one processor (`jax_num_cpu_devices`): they show what is lost on the way, not what more cores would gain.
Prints a table and one line of JSON; `--out` also draws them. `--smoke` takes tiny points, all in one process.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

AXES = {
    "samples": (2**18, 2**19, 2**20, 2**21),
    "unknowns": (4, 6, 8, 10),
    "materials": (4, 8, 16, 32),
    "pixels": (2**17, 2**18, 2**19, 2**20),
    "devices": (1, 2, 4, 8),
}
"""What is varied. Of unknowns: the order of the basis."""

SMOKE = {
    "samples": (2**16, 2**17),
    "unknowns": (2, 3),
    "materials": (1, 2),
    "pixels": (2**12, 2**13),
    "devices": (1, 2),
}

WORDS = {
    "samples": "`project_blocks`, 165 unknowns, 3 channels, float32, norm A, from mapped files",
    "unknowns": "`project_blocks`, 2^18 samples, otherwise the same",
    "materials": "`fit_compact_all`, 60 coefficients, 3 channels, on the grid of `half_vector_samples`",
    "pixels": "`project_pixels`, 64 lights, 16 functions, 3 channels, float32, from and to files",
    "devices": "`project_blocks` as for samples, 2^20 of them",
}

LIGHTS = 64


def measured(work: Callable[[], Any], repeats: int = 2) -> dict[str, float]:
    """Of the better of some runs."""
    runs = []
    for _ in range(repeats):
        start, cores = time.perf_counter(), time.process_time()
        work()
        runs.append((time.process_time() - cores, time.perf_counter() - start))
    best = min(runs)
    return {"core_seconds": best[0], "seconds": best[1]}


def of_blocks(samples: int, order: int, devices: int) -> tuple[int, dict[str, float]]:
    """Unknowns, and figures of a fit in blocks."""
    import jax

    from benchmarks.project_scale import mapped_samples
    from hshjax import HSH, IsotropicBasis, device_mesh, project_blocks

    basis, mesh = IsotropicBasis(HSH(order)), device_mesh(devices) if devices > 1 else None
    with tempfile.TemporaryDirectory() as folder:
        blocks = mapped_samples(samples, Path(folder))

        def work():
            jax.block_until_ready(project_blocks(basis, blocks, norm="A", mesh=mesh, ridge=1e-6))

        project_blocks(basis, blocks[:1], norm="A", mesh=mesh, ridge=1e-6)
        return basis.count, measured(work)


def of_materials(count: int) -> dict[str, float]:
    """Figures of compact fits of GGX over a diffuse part, of as many slopes."""
    import jax.numpy as jnp
    import numpy as np

    from hshjax import GGX, Lambert, fit_compact_all, half_vector_samples

    slopes = np.linspace(0.1, 0.6, count)
    materials = [
        half_vector_samples(Lambert(jnp.asarray([0.1, 0.2, 0.3])) + GGX(jnp.full(3, 0.04), jnp.asarray(slope)))
        for slope in slopes
    ]
    fit_compact_all(materials[:1], 60)
    return measured(lambda: fit_compact_all(materials, 60), repeats=1)


class FromFile:
    """Slices of a .npy file, read and not mapped: what is mapped counts as memory of the process."""

    def __init__(self, path: str):
        import numpy as np

        mapped = np.load(path, mmap_mode="r")
        self.path, self.shape, self.dtype, self.offset = path, mapped.shape, mapped.dtype, mapped.offset

    def __getitem__(self, rows: slice):
        import numpy as np

        start, stop, _ = rows.indices(self.shape[0])
        size = self.shape[1] * self.shape[2]
        offset = self.offset + start * size * self.dtype.itemsize
        return np.fromfile(self.path, self.dtype, (stop - start) * size, offset=offset).reshape(-1, *self.shape[1:])


def of_pixels(pixels: int, missing: float = 0.0) -> dict[str, float]:
    """Figures of a relightable image, in which a share of all values is missing here and there."""
    import numpy as np

    from benchmarks.project_scale import uniform_directions
    from hshjax import HSH, project_pixels

    lights, rng = np.asarray(uniform_directions(np.random.default_rng(0), LIGHTS)), np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        shape = pixels, LIGHTS, 3
        with open(f"{folder}/in.npy", "wb") as file:
            header = {"descr": "<f4", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(file, header)
            for start in range(0, pixels, 2**15):
                values = rng.random((min(2**15, pixels - start), *shape[1:]), np.float32)
                values[rng.random(values.shape[:2]) < missing] = np.nan
                values.tofile(file)
        source = FromFile(f"{folder}/in.npy")
        project_pixels(HSH(3), lights, source[: 2**15])
        return measured(lambda: project_pixels(HSH(3), lights, source, out=f"{folder}/out.npy"))


def point(axis: str, value: int, *, smoke: bool) -> dict[str, Any]:
    """What one process measures."""
    if axis == "devices" and not smoke:
        import jax

        jax.config.update("jax_num_cpu_devices", value)
    if axis == "materials":
        return {"value": value, **of_materials(value), "peak_gigabytes": peak()}
    if axis == "pixels":
        return {"value": value, **of_pixels(value), "peak_gigabytes": peak()}
    samples = value if axis == "samples" else 2**14 if smoke else 2**20 if axis == "devices" else 2**18
    order = value if axis == "unknowns" else 3 if smoke else 8
    unknowns, figures = of_blocks(samples, order, value if axis == "devices" else 1)
    return {"value": unknowns if axis == "unknowns" else value, **figures, "peak_gigabytes": peak()}


def peak() -> float:
    from benchmarks.project_scale import peak_bytes

    return peak_bytes() / 1e9


def exponent(points: list[dict[str, Any]], of: str) -> float:
    """Slope of a figure in the logarithms."""
    import numpy as np

    x, y = (np.log([one[name] for one in points]) for name in ("value", of))
    return float(np.polyfit(x, y, 1)[0])


def drawn(found: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Seconds and memory, a column for every axis."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, len(found), figsize=(3 * len(found), 5), layout="constrained", sharex="col")
    for column, (axis, points) in zip(panels.T, found.items(), strict=True):
        x = [one["value"] for one in points]
        for name, mark in (("core_seconds", "o-"), ("seconds", "x--")):
            column[0].loglog(x, [one[name] for one in points], mark, label=name.replace("_", " "))
        column[1].semilogx(x, [one["peak_gigabytes"] for one in points], "s-", color="0.4")
        column[1].set_ylim(bottom=0)
        column[1].set_xticks(x, [f"{value:.2g}" for value in x], fontsize=8)
        column[1].minorticks_off()
        column[1].set_xlabel(axis)
        column[0].set_title(f"{axis}, exponent {exponent(points, 'core_seconds'):.2f}", fontsize=9)
    panels[0, 0].set_ylabel("seconds")
    panels[1, 0].set_ylabel("peak memory [GB]")
    panels[0, 0].legend(fontsize=7)
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder for scaling.json and scaling.png")
    parser.add_argument("--smoke", action="store_true")
    parser.add_argument("--point", nargs=2, metavar=("AXIS", "VALUE"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.point:
        axis, value = arguments.point
        print(json.dumps(point(axis, int(value), smoke=False)))
        return
    if arguments.smoke:
        import jax

        jax.config.update("jax_num_cpu_devices", 2)
    found = {}
    for axis, values in (SMOKE if arguments.smoke else AXES).items():
        found[axis] = []
        print(
            f"\n{axis}: {WORDS[axis]}\n\n| {axis} | core seconds | seconds | peak GB |\n|---|---|---|---|", flush=True
        )
        for value in values:
            command = [sys.executable, "-m", "benchmarks.scaling", "--point", axis, str(value)]
            if arguments.smoke:
                one = point(axis, value, smoke=True)
            else:
                done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
                one = json.loads(done.stdout.splitlines()[-1])
            found[axis].append(one)
            figures = f"{one['core_seconds']:.3g} | {one['seconds']:.3g} | {one['peak_gigabytes']:.3g}"
            print(f"| {one['value']} | {figures} |", flush=True)
        print(f"\nexponent of core seconds {exponent(found[axis], 'core_seconds'):.2f}")
    report = {
        "cores": os.cpu_count(),
        "exponents": {axis: round(exponent(points, "core_seconds"), 3) for axis, points in found.items()},
        "points": found,
    }
    print(json.dumps(report))
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / "scaling.json").write_text(json.dumps(report, indent=1), encoding="utf-8")
        drawn(found, arguments.out / "scaling.png")


if __name__ == "__main__":
    main()
