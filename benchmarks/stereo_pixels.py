"""Photometric stereo against the number of pixels: time and memory, photographs mapped from a file.

    python -m benchmarks.stereo_pixels [--sides 256 512 1024 2256] [--lights 24]

A sphere of plastic that fills the image, grey, noise of 0.5 % of white; a process for each size, which compiles. 2256
pixels a side are four megapixels.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._smoke import parser
from hshjax import GGX, DirectionalLight, Lambert, reflect
from hshjax.photographs import Photographs
from hshjax.stereo import angular_errors, solve_calibrated

BLOCK = 2**16
NOISE = 0.005


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--sides", type=int, nargs="+", default=[256, 512, 1024, 2256], help="pixels along a side")
    options.add_argument("--lights", type=int, default=24)
    options.add_argument("--one", type=int, help="of this side, in this process; figures as JSON")
    given = options.parse_args()
    if given.smoke:
        given.one, given.lights = 8, 6
    if given.one is not None:
        print(json.dumps(solved(given.one, given.lights)))
        return
    print(f"{'pixels':>9} {'seconds':>8} {'µs a pixel':>10} {'peak':>8} {'photographs':>11} {'error':>6}")
    for side in given.sides:
        command = [sys.executable, "-m", "benchmarks.stereo_pixels", "--one", str(side), "--lights", str(given.lights)]
        row = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
        print(
            f"{row['pixels']:9d} {row['seconds']:8.1f} {1e6 * row['seconds'] / row['pixels']:10.1f} "
            f"{row['peak'] / 2**30:5.2f} GB {row['bytes'] / 2**30:8.2f} GB {row['error']:6.3f}  {row['stages']}",
            flush=True,
        )


def solved(side: int, count: int) -> dict:
    """Time [s], largest resident memory [bytes] and mean angular error [degrees] of one size."""
    axis = (np.arange(side) + 0.5) / side * 2 - 1
    x, y = np.meshgrid(axis, -axis)
    mask = x**2 + y**2 < 0.98
    normals = np.stack([x[mask], y[mask], np.sqrt(1 - x[mask] ** 2 - y[mask] ** 2)], axis=1).astype(np.float32)
    turn, tilt = 2.4 * np.arange(count), np.radians(45 * np.sqrt((np.arange(count) + 0.5) / count))
    towards = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
    lights = jax.vmap(DirectionalLight)(jnp.asarray(towards, jnp.float32), jnp.full(count, jnp.pi, jnp.float32))
    with tempfile.TemporaryDirectory() as folder:
        shape = len(normals), count, 1
        values = np.memmap(Path(folder) / "values", np.float32, "w+", shape=shape)
        _render(values, normals, lights)
        values.flush()
        photographs = Photographs(np.memmap(values.filename, np.float32, "r", shape=shape), mask, lights, truth=normals)
        del values
        begin = time.perf_counter()
        result = solve_calibrated(photographs)
        seconds = time.perf_counter() - begin
        size = photographs.values.nbytes
    unit = 1 if sys.platform == "darwin" else 1024
    return {
        "pixels": len(normals), "seconds": seconds, "bytes": size,
        "peak": unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "error": float(angular_errors(result.normals, normals).mean()),
        "stages": " ".join(f"{stage.name} {stage.seconds:.1f}" for stage in result.history),
    }  # fmt: skip


def _render(values: np.ndarray, normals: np.ndarray, lights: DirectionalLight) -> None:
    plastic, view = Lambert(0.5) + 0.2 * GGX(1.0, 0.25), jnp.asarray([0, 0, 1], jnp.float32)
    block = eqx.filter_jit(lambda normal: jax.lax.map(lambda light: reflect(plastic, light, normal, view), lights))
    random = np.random.default_rng(0)
    for begin in range(0, len(normals), BLOCK):
        part = normals[begin : begin + BLOCK]
        whole = np.pad(part, ((0, BLOCK - len(part)), (0, 0)), mode="edge")
        shown = np.moveaxis(np.asarray(block(jnp.asarray(whole))), 0, 1)[: len(part)]
        values[begin : begin + BLOCK] = shown + NOISE * random.normal(size=shown.shape).astype(np.float32)


if __name__ == "__main__":
    main()
