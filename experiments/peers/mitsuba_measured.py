"""BRDF values of Mitsuba 3's `measured` plugin. Runs inside its environment."""

from typing import Any

import mitsuba as mi
import numpy as np
from exchange import answer


def work(inputs: dict[str, Any]) -> dict[str, np.ndarray]:
    """Inputs: `variant`; `path` of a `.bsdf` file; `wi`, `wo` `(n, 3)` in the local frame; of a spectral variant
    `wavelengths` `(n, 4)` [nm], four for each pair.

    Returns `value` `(n, channels)` [sr^-1], the cosine of wo taken off.
    """
    mi.set_variant(inputs["variant"])
    bsdf = mi.load_dict({"type": "measured", "filename": inputs["path"]})
    values = []
    for k, (wi, wo) in enumerate(zip(inputs["wi"].tolist(), inputs["wo"].tolist(), strict=True)):
        si = mi.SurfaceInteraction3f()
        si.wi = wi
        if "wavelengths" in inputs:
            si.wavelengths = inputs["wavelengths"][k].tolist()
        values.append(np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo)), np.float64).ravel() / wo[2])
    return {"value": np.stack(values)}


if __name__ == "__main__":
    answer(work)
