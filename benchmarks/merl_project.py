"""Reading a MERL file and projecting it on isotropic HSH, over what numpy needs to read it and transform its angles.

    python -m benchmarks.merl_project [FILE] [--order 8] [--rounds 7]

Without a file, one of 90 x 90 x 180 nodes is written from an analytic material. float64. The shortest of some rounds,
all kinds in turn, wall time and that of all cores; compilation is told apart. `numpy` transforms the angles of every
node, as scripts do that know nothing of grids; `numpy, by axes` takes sines of the three axes only. The peak of memory
is that of a fresh process which reads and projects once, libraries and compilation included.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._serve import peak_bytes
from benchmarks._smoke import parser
from hshjax import GGX, HSH, IsotropicBasis, Lambert
from hshjax.brdfs import AbstractBRDF
from hshjax.fitting import Fit, project_by_moments
from hshjax.io import read_merl, write_merl

SCALES = np.array([[1], [1.15], [1.66]]) / 1500


def read_with_numpy(path: str) -> tuple[tuple[int, int, int], np.ndarray]:
    with open(path, "rb") as file:
        steps = tuple(int(n) for n in np.fromfile(file, "<i4", 3))
        return steps, np.fromfile(file, "<f8").reshape(3, -1) * SCALES


def angles(steps: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    h, d, f = (np.arange(count) / count for count in steps)
    return h**2 * np.pi / 2, d * np.pi / 2, f * np.pi


def with_numpy(path: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, wi, wo of every node."""
    steps, values = read_with_numpy(path)
    h, d, f = (axis.ravel() for axis in np.meshgrid(*angles(steps), indexing="ij"))
    x, y, z = np.sin(d) * np.cos(f), np.sin(d) * np.sin(f), np.cos(d)
    cos, sin = np.cos(h), np.sin(h)
    wi = np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)
    wo = np.stack([sin * z - cos * x, -y, cos * z + sin * x], axis=-1)
    return values, wi, wo


def with_numpy_by_axes(path: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same."""
    steps, values = read_with_numpy(path)
    h, d, f = (axis.reshape(shape) for axis, shape in zip(angles(steps), [(-1, 1, 1), (-1, 1), (-1,)], strict=True))
    x, y, z = np.sin(d) * np.cos(f), np.sin(d) * np.sin(f), np.cos(d)
    cos, sin = np.cos(h), np.sin(h)
    wi = np.stack(np.broadcast_arrays(cos * x + sin * z, y, cos * z - sin * x), axis=-1)
    wo = np.stack(np.broadcast_arrays(sin * z - cos * x, -y, cos * z + sin * x), axis=-1)
    return values, wi, wo


def read_and_project(path: str, order: int) -> Fit:
    return jax.block_until_ready(project_by_moments(IsotropicBasis(HSH(order)), read_merl(path)))


def material() -> AbstractBRDF:
    grey = jnp.asarray([0.3, 0.2, 0.1])
    return Lambert(grey) + GGX(jnp.asarray([0.04, 0.04, 0.04]), 0.2)


def timed(call: Callable[[], object]) -> np.ndarray:
    """Seconds of the wall, and of all cores."""
    begin = np.array([time.perf_counter(), time.process_time()])
    call()
    return np.array([time.perf_counter(), time.process_time()]) - begin


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("file", nargs="?")
    arguments.add_argument("--order", type=int, default=8)
    arguments.add_argument("--rounds", type=int, default=7)
    arguments.add_argument("--peak", action="store_true", help="read and project once, print the peak of memory")
    options = arguments.parse_args()
    steps = (6, 6, 12) if options.smoke else (90, 90, 180)
    if options.smoke:
        options.order, options.rounds = 2, 1
    jax.config.update("jax_enable_x64", True)
    if options.peak:
        read_and_project(options.file, options.order)
        print(peak_bytes())
        return
    with tempfile.TemporaryDirectory() as folder:
        path = options.file or f"{folder}/material.binary"
        if options.file is None:
            write_merl(path, material(), steps=steps)
        calls = {
            "numpy": lambda: with_numpy(path),
            "numpy, by axes": lambda: with_numpy_by_axes(path),
            "read and project": lambda: read_and_project(path, options.order),
        }
        first = {name: timed(call) for name, call in calls.items()}
        best = {name: np.full(2, np.inf) for name in calls}
        for _ in range(options.rounds):
            for name, call in calls.items():
                best[name] = np.minimum(best[name], timed(call))
        fit = read_and_project(path, options.order)
        command = [sys.executable, "-m", "benchmarks.merl_project", path, "--order", str(options.order), "--peak"]
        peak = int(subprocess.run(command, capture_output=True, check=True, text=True, cwd=Path.cwd()).stdout)
    print(f"order {options.order}, {fit.unknowns} unknowns, {fit.samples} samples, by {fit.method}, condition", end=" ")
    print(f"{float(fit.condition):.2f}, relative {np.array2string(np.asarray(fit.relative), precision=4)}")
    print(f"{'':20s}   wall s    ratio   CPU s    ratio")
    for name, (wall, cpu) in best.items():
        ratios = best[name] / best["numpy"]
        print(f"{name:20s} {wall:8.3f} {ratios[0]:8.2f} {cpu:8.3f} {ratios[1]:8.2f}")
    compiling = first["read and project"] - best["read and project"]
    print(f"compilation on top, the first time: {compiling[0]:.2f} s of the wall")
    print(f"peak of memory: {peak / 1e9:.2f} GB")


if __name__ == "__main__":
    main()
