"""What the material of `hshjax.io.mitsuba` costs: loading, the first use (compilation), and values after that.

    python -m benchmarks.mitsuba_material [--smoke]

Needs the extra `mitsuba` and LLVM. 2^18 pairs in `llvm_ad_rgb`, beside Mitsuba's own `roughconductor`; one in
`scalar_rgb`. Dr.Jit's cache of compiled programs is a fresh one.
"""

import importlib.util
import os
import tempfile
import time
from pathlib import Path

import numpy as np

import hshjax
import hshjax.io.mitsuba
from benchmarks._smoke import parser
from hshjax.io import save_model

PAIRS = 2**18
ROUNDS = 5


def models() -> dict:
    bases = {
        "HSH 4, isotropic": hshjax.IsotropicBasis(hshjax.HSH(4)),
        "HSH 8, isotropic": hshjax.IsotropicBasis(hshjax.HSH(8)),
        "HSH 16, isotropic": hshjax.IsotropicBasis(hshjax.HSH(16)),
        "HSH 4, Helmholtz": hshjax.HelmholtzBasis(hshjax.HSH(4)),
        "HSH 6, Helmholtz": hshjax.HelmholtzBasis(hshjax.HSH(6)),
    }
    found = {}
    for name, basis in bases.items():
        coefficients = 0.01 * np.random.default_rng(0).normal(size=(basis.count, 3))
        coefficients[0] += 1
        found[name] = hshjax.LinearBRDF(basis, coefficients)
    compact = hshjax.HalfVectorBasis(100)
    parts = [0.05 * np.random.default_rng(k).normal(size=n) for k, n in enumerate((100, 25, 25))]
    return found | {"compact, 150 numbers": hshjax.LogLinearBRDF(compact, parts)}


def main() -> None:
    smoke = parser(__doc__).parse_args().smoke
    if importlib.util.find_spec("mitsuba") is None:
        print('needs the extra: pip install ".[mitsuba]"')
        return
    with tempfile.TemporaryDirectory() as folder:
        os.environ["HOME"] = folder  # of Dr.Jit's cache, which outlives processes
        path = Path(folder) / "model.hshjax"
        if smoke:
            tiny(path)
        else:
            measure(path)


def tiny(path: Path) -> None:
    """One value of one model in the variant that needs no LLVM."""
    import mitsuba as mi

    hshjax.io.mitsuba.register()
    save_model(path, hshjax.LinearBRDF(hshjax.IsotropicBasis(hshjax.HSH(1)), np.ones((4, 3))))
    print(f"{scalar(mi, path):.0f} us a value")


def measure(path: Path) -> None:
    import drjit as dr
    import mitsuba as mi

    hshjax.io.mitsuba.register()
    random = np.random.default_rng(1)
    mi.set_variant("llvm_ad_rgb")
    eye, light = (mi.warp.square_to_cosine_hemisphere(mi.Point2f(random.uniform(size=(2, PAIRS)))) for _ in range(2))
    interaction = dr.zeros(mi.SurfaceInteraction3f, PAIRS)
    interaction.wi = eye
    context = mi.BSDFContext()

    def seconds(bsdf) -> float:
        begin = time.perf_counter()
        dr.eval(bsdf.eval(context, interaction, light))
        dr.sync_thread()
        return time.perf_counter() - begin

    print(f"{'':22s} loading [s]  first use [s]  a value [ns]  a value, scalar [us]")
    rough = mi.load_dict({"type": "roughconductor", "distribution": "ggx", "alpha": 0.2})
    first, later = seconds(rough), min(seconds(rough) for _ in range(ROUNDS))
    print(f"{'roughconductor':22s} {'':11s} {first:14.2f} {1e9 * later / PAIRS:13.1f}")
    for name, model in models().items():
        mi.set_variant("llvm_ad_rgb")
        save_model(path, model)
        begin = time.perf_counter()
        bsdf = mi.load_dict({"type": "hshjax", "filename": str(path)})
        loading = time.perf_counter() - begin
        first, later = seconds(bsdf), min(seconds(bsdf) for _ in range(ROUNDS))
        print(
            f"{name:22s} {loading:11.1f} {first:14.2f} {1e9 * later / PAIRS:13.1f} {scalar(mi, path):21.0f}", flush=True
        )


def scalar(mi, path: Path) -> float:
    """Microseconds of a value."""
    mi.set_variant("scalar_rgb")
    bsdf, context = mi.load_dict({"type": "hshjax", "filename": str(path)}), mi.BSDFContext()
    interaction = mi.SurfaceInteraction3f()
    interaction.wi = mi.Vector3f(0.6, 0, 0.8)
    times = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        bsdf.eval(context, interaction, mi.Vector3f(0, 0.28, 0.96))
        times.append(time.perf_counter() - begin)
    return 1e6 * min(times)


if __name__ == "__main__":
    main()
