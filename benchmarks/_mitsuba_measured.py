"""The worker of Mitsuba's `measured`: `python _mitsuba_measured.py CORES`, inside Mitsuba's environment.

A case is `{"path": a .bsdf file, "pairs": n}`; a call evaluates n pairs in `llvm_ad_rgb` and waits for them.
"""

import sys
import time

from _serve import Prepared, claim, clock, cores_of, serve

CORES = cores_of(sys.argv[1])
claim(CORES)

import drjit as dr  # noqa: E402  after the cores have been claimed, which it counts
import mitsuba as mi  # noqa: E402
import numpy as np  # noqa: E402


def prepare(case):
    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(len(CORES))
    bsdf = mi.load_dict({"type": "measured", "filename": case["path"]})
    random = np.random.default_rng(0).uniform(size=(2, 2, case["pairs"])).astype(np.float32)
    eye, light = (mi.warp.square_to_cosine_hemisphere(mi.Point2f(*one)) for one in random)
    interaction = dr.zeros(mi.SurfaceInteraction3f, case["pairs"])
    interaction.wi = eye
    dr.eval(light, interaction)
    context = mi.BSDFContext()

    def call():
        dr.eval(bsdf.eval(context, interaction, light))
        dr.sync_thread()

    begin = time.process_time()
    call()
    return Prepared(call, {"compile": time.process_time() - begin}, dict)


if __name__ == "__main__":
    serve(prepare, clock(CORES))
