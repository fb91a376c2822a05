"""Time of the reflectance equation beside Mitsuba 3 and beside its own quadrature: python -m benchmarks.reflectance

A sphere of `--size` pixels, an isotropic BRDF of order 8 fitted to a GGX lobe, a harmonic light of order 8, three
channels, float32. The rows, one line of JSON each:

- `value` and `gradient` (value and gradient by the light and the BRDF) of Mitsuba 3 (llvm_ad_rgb, 64 samples a pixel,
  the same light as a map of 64 x 32 pixels) and of `reflect`, medians over rounds in which each takes its turn;
- the closed form against quadrature of the degree that reaches 1e-3 of it, relative and root mean square;
- time and peak memory of the closed form against the number of pixels, drawn into `--figure`;
- memory that quadrature takes for 1024 x 1024 normals under a map of 256 x 128, as the compiler counts it.

`--mitsuba no` leaves the peer out. Its noise is stated beside its times: what it would take to have as little.
"""

import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import hshjax
from benchmarks._smoke import parser
from experiments import peers

ORDER = 8
ALPHA = 0.4
"""Roughness of the material: what an isotropic series of order 8 holds to some percent."""

SIZES = (256, 512, 1024, 2048)


def light() -> hshjax.HarmonicLight:
    """Order 8, positive: smooth light from above, with a window."""
    empty = hshjax.EnvironmentMap(jnp.zeros((64, 128, 1), jnp.float32), up="y")
    w = empty.direction
    window = np.exp(6 * (w @ np.array([0.5, 0.6, 0.62]) - 1))
    radiance = 0.5 + 0.3 * w[..., 1:2] + window[..., None] * np.array([3.0, 2.5, 2.0])
    return hshjax.HarmonicLight.from_environment(
        hshjax.EnvironmentMap(jnp.asarray(radiance, jnp.float32), up="y"), ORDER
    )


def light_map(rows: int) -> hshjax.EnvironmentMap:
    """The same light as a map."""
    empty = hshjax.EnvironmentMap(jnp.zeros((rows, 2 * rows, 1), jnp.float32), up="y")
    radiance = jnp.maximum(light()(jnp.asarray(empty.direction, jnp.float32)), 0)
    return hshjax.EnvironmentMap(radiance, up="y")


def material() -> hshjax.LinearBRDF:
    """GGX in norm D, three channels that differ in their albedo."""
    samples = hshjax.Samples.from_function(
        hshjax.GGX(jnp.asarray([1.0, 0.8, 0.6], jnp.float32), jnp.float32(ALPHA)),
        hshjax.isotropic_pair_rule(32, dtype=jnp.float32),
    )
    return hshjax.project(hshjax.IsotropicBasis(hshjax.HSH(ORDER)), samples).model


def sphere(size: int) -> jax.Array:
    camera = hshjax.OrthographicCamera(
        jnp.asarray([0, 0, 1], jnp.float32), jnp.asarray([0, 1, 0], jnp.float32), resolution=(size, size)
    )
    return hshjax.sphere(camera).normal


def seconds(call: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - begin


def calls(size: int, degree: int | None = None, *, far: bool = True) -> dict[str, Callable[[], Any]]:
    """Compiled value, and value with its gradient by light and BRDF."""
    normals, eye = sphere(size), jnp.asarray([0, 0, 1], jnp.float32)
    view = eye if far else jnp.broadcast_to(eye, normals.shape)
    model = material(), hshjax.HarmonicLight(light().coefficients, degree=degree)

    @eqx.filter_jit
    def value(model, normals, view):
        return hshjax.reflect(*model, normals, view)

    @eqx.filter_jit
    @eqx.filter_value_and_grad
    def gradient(model, normals, view):
        return jnp.mean(hshjax.reflect(*model, normals, view))

    return {"value": lambda: value(model, normals, view), "gradient": lambda: gradient(model, normals, view)}


def beside_mitsuba(size: int, spp: int, rounds: int) -> dict[str, Any]:
    """Medians [ms] of rounds in turn, one process of the peer a round; and the peer's relative noise."""
    inputs = {
        "environment": np.asarray(light_map(32).radiance), "bsdf": "ggx", "alpha": ALPHA, "variant": "llvm_ad_rgb",
        "size": size, "spp": spp, "repeats": 5,
    }  # fmt: skip
    ours = {"far": calls(size), "near": calls(size, far=False)}
    for group in ours.values():
        for call in group.values():
            seconds(call)
    times: dict[str, list[float]] = {}
    images = []
    for _ in range(rounds):
        for integrator in ("direct", "prb"):
            found = peers.run("mitsuba", "mitsuba_timing", inputs | {"integrator": integrator}, llvm=True)
            images.append(found["image"])
            for kind in ("value", "gradient"):
                times.setdefault(f"mitsuba {integrator} {kind}", []).extend(found[kind])
        for name, group in ours.items():
            for kind, call in group.items():
                times.setdefault(f"closed form, eye {name}, {kind}", []).extend(seconds(call) for _ in range(5))
    row = {name: round(1e3 * float(np.median(values)), 1) for name, values in times.items()}
    for kind in ("value", "gradient"):
        best = min(row[f"mitsuba {integrator} {kind}"] for integrator in ("direct", "prb"))
        row |= {
            f"times faster, eye {name}, {kind}": round(best / row[f"closed form, eye {name}, {kind}"], 1)
            for name in ours
        }
    inside = np.asarray(sphere(size)).any(-1)
    noise = np.std([image[inside] for image in images], axis=0) / np.mean(images, axis=0)[inside]
    return {"pixels": size**2, "spp": spp, "median relative noise of a pixel": round(float(np.median(noise)), 4)} | row


def beside_quadrature(size: int, rounds: int) -> dict[str, Any]:
    """The lowest degree of a rule that is within 1e-3 of the closed form, and what it costs."""
    exact = np.asarray(calls(size)["value"]())
    for degree in (4, 6, 8, 10, 12, 16, 20, 24, 28, 32, 40, 48):
        call = calls(size, degree)["value"]
        error = float(np.sqrt(np.mean((np.asarray(call()) - exact) ** 2) / np.mean(exact**2)))
        if error < 1e-3:
            break
    else:
        raise ValueError(f"no rule up to degree {degree} comes within 1e-3 of the closed form: {error:.2g}")
    names = {"far": calls(size)["value"], "near": calls(size, far=False)["value"], "quadrature": call}
    times = {name: [] for name in names}
    for one in names.values():
        seconds(one)
    for _ in range(rounds):
        for name, one in names.items():
            times[name].append(seconds(one))
    row = {f"{name} [ms]": round(1e3 * float(np.median(values)), 1) for name, values in times.items()}
    ratios = {
        f"times faster, eye {name}": round(row["quadrature [ms]"] / row[f"{name} [ms]"], 1) for name in ("far", "near")
    }
    return {"pixels": size**2, "degree": degree, "error": error} | row | ratios


def of_pixels(size: int, kind: str, far: bool) -> dict[str, Any]:
    """Time a pixel and the peak of this process."""
    call = calls(size, far=far)[kind]
    seconds(call)
    median = float(np.median([seconds(call) for _ in range(5)]))
    with open("/proc/self/status") as status:
        peak = next(int(line.split()[1]) / 1e6 for line in status if line.startswith("VmHWM"))
    return {
        "eye": "far" if far else "near", "kind": kind, "pixels": size**2, "ms": round(1e3 * median, 1),
        "ns a pixel": round(1e9 * median / size**2, 1), "peak [GB]": round(peak, 2),
    }  # fmt: skip


def of_quadrature(size: int = 1024, rows: int = 128) -> dict[str, Any]:
    """Inputs, results and temporaries [MB] of value and gradient, for all pixels under all emitters."""
    environment = light_map(rows)
    normals, eye = sphere(size), jnp.asarray([0, 0, 1], jnp.float32)
    row: dict[str, Any] = {"pixels": size**2, "emitters": 2 * rows**2}
    for name, brdf in {"GGX": hshjax.GGX(jnp.ones(3, jnp.float32), jnp.float32(ALPHA)), "series": material()}.items():

        def value(model, normals):
            return hshjax.reflect(*model, normals, eye)

        def loss(model, normals):
            return jnp.mean(value(model, normals))

        model = brdf, environment
        for kind, function in {"value": value, "gradient": eqx.filter_value_and_grad(loss)}.items():
            found = eqx.filter_jit(function).lower(model, normals).compile().compiled.memory_analysis()
            bytes_ = found.temp_size_in_bytes + found.argument_size_in_bytes + found.output_size_in_bytes
            row[f"{name}, {kind} [MB]"] = round(bytes_ / 1e6)
    return row


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Time a pixel and peak of memory against the number of pixels."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    for (eye, kind), style in {
        ("far", "value"): "C0-", ("far", "gradient"): "C0--", ("near", "value"): "C1-", ("near", "gradient"): "C1--",
    }.items():  # fmt: skip
        chosen = [row for row in rows if (row["eye"], row["kind"]) == (eye, kind)]
        pixels = [row["pixels"] for row in chosen]
        label = {"far": "eye far away", "near": "a direction for each pixel"}[eye] + f", {kind}"
        axes[0].loglog(pixels, [row["ns a pixel"] / 1e3 for row in chosen], style, marker="o", label=label)
        axes[1].semilogx(pixels, [row["peak [GB]"] for row in chosen], style, marker="o")
    axes[0].set(xlabel="pixels", ylabel="time [µs a pixel]", ylim=(0.1, 10))
    axes[1].set(xlabel="pixels", ylabel="peak of the process [GB]", ylim=(0, 1))
    axes[0].legend(fontsize=7)
    figure.savefig(path, dpi=120)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--size", type=int, default=256)
    options.add_argument("--spp", type=int, default=64)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--mitsuba", choices=("yes", "no"), default="yes")
    options.add_argument("--figure", type=Path, help="a picture of the times against the number of pixels")
    options.add_argument("--only", nargs=3, metavar=("SIZE", "KIND", "EYE"), help="one row of the last table")
    chosen = options.parse_args()
    if chosen.smoke:
        chosen.only = "4", "value", "far"
    if chosen.only:
        size, kind, eye = chosen.only
        print(json.dumps(of_pixels(int(size), kind, eye == "far")), flush=True)
        return
    common = {"load": round(os.getloadavg()[0], 1)}
    if chosen.mitsuba == "yes":
        print(
            json.dumps({"benchmark": "mitsuba"} | common | beside_mitsuba(chosen.size, chosen.spp, chosen.rounds)),
            flush=True,
        )
    print(
        json.dumps({"benchmark": "quadrature"} | common | beside_quadrature(chosen.size // 4, chosen.rounds)),
        flush=True,
    )
    print(json.dumps({"benchmark": "memory of quadrature"} | of_quadrature()), flush=True)
    rows = []
    for eye, kind, size in itertools.product(("far", "near"), ("value", "gradient"), SIZES):
        # A process each, for its peak of memory is its own.
        command = [sys.executable, "-m", "benchmarks.reflectance", "--only", str(size), kind, eye]
        rows.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
        print(json.dumps(rows[-1]), flush=True)
    if chosen.figure:
        draw(rows, chosen.figure)


if __name__ == "__main__":
    main()
