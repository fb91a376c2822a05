"""Peak memory and time of `project` on many scattered samples: python -m benchmarks.project_scale --samples 10000000

165 unknowns (`IsotropicBasis(HSH(8))`), three channels, float32, norm A, so that the streamed QR does the work. With
`--blocks`, the samples lie in files, of which `project_blocks` maps a block at a time. Prints one line of JSON. The
peak is that of the whole process: samples, libraries, compilation and the mapped part of files included.
"""

import json
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._serve import peak_bytes
from benchmarks._smoke import parser
from hshjax.bases import HSH, IsotropicBasis
from hshjax.fitting import SampleBlocks, project, project_blocks
from hshjax.samples import Samples

CHANNELS = 3
PART = 1_000_000
"""Samples drawn at a time: what numpy needs on the way stays small."""


def uniform_directions(rng: np.random.Generator, n: int) -> jax.Array:
    """Uniform on the hemisphere, `(n, 3)` float32."""
    w = np.empty((n, 3), np.float32)
    for start in range(0, n, PART):
        part = w[start : start + PART]
        part[:, 2] = rng.random(len(part), np.float32)
        phi = rng.random(len(part), np.float32) * np.float32(2 * np.pi)
        rim = np.sqrt((1 - part[:, 2]) * (1 + part[:, 2]))
        part[:, 0], part[:, 1] = rim * np.cos(phi), rim * np.sin(phi)
    return jnp.asarray(w)


def random_samples(n: int, seed: int = 0) -> Samples:
    """Noise: time and memory do not depend on the values."""
    rng = np.random.default_rng(seed)
    wi, wo = uniform_directions(rng, n), uniform_directions(rng, n)
    return Samples.scattered(wi, wo, jnp.asarray(rng.random((n, CHANNELS), np.float32)))


def mapped_samples(n: int, folder: Path) -> SampleBlocks:
    """The same kind in files, written a part at a time."""
    shapes = {"wi": (n, 3), "wo": (n, 3), "value": (n, CHANNELS)}
    files = {name: folder / f"{name}.npy" for name in shapes}
    mapped = {name: np.lib.format.open_memmap(files[name], "w+", np.float32, shape) for name, shape in shapes.items()}
    for start in range(0, n, PART):
        part = random_samples(min(PART, n - start), seed=start)
        for name, array in mapped.items():
            array[start : start + PART] = getattr(part, name)
    mapped.clear()
    return SampleBlocks(**{name: np.load(file, mmap_mode="r") for name, file in files.items()})


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--samples", type=int, default=10_000_000)
    options.add_argument("--blocks", action="store_true", help="from files, block by block")
    arguments = options.parse_args()
    n, basis = arguments.samples, IsotropicBasis(HSH(8))
    if arguments.smoke:
        n, basis = 500, IsotropicBasis(HSH(2))
    with tempfile.TemporaryDirectory() as folder:
        samples = mapped_samples(n, Path(folder)) if arguments.blocks else jax.block_until_ready(random_samples(n))
        before = peak_bytes()
        start, start_cpu = time.perf_counter(), time.process_time()
        if isinstance(samples, Samples):
            fit = project(basis, samples, norm="A", reciprocity=False)
        else:
            fit = project_blocks(basis, samples, norm="A")
        fit = jax.block_until_ready(fit)
    figures = {
        "samples": n,
        "blocks": arguments.blocks,
        "unknowns": fit.unknowns,
        "channels": CHANNELS,
        "dtype": str(fit.model.coefficients.dtype),
        "seconds": round(time.perf_counter() - start, 1),
        "cpu_seconds": round(time.process_time() - start_cpu, 1),
        "peak_gigabytes": round(peak_bytes() / 1e9, 3),
        "peak_before_gigabytes": round(before / 1e9, 3),
        "condition": float(fit.condition),
        "relative": [round(float(x), 6) for x in fit.relative],
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
