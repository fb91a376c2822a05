"""Scenes and variants that Mitsuba's scripts share. Runs inside Mitsuba's environment."""

from typing import Any

import mitsuba as mi
import numpy as np


def choose(variant: str) -> None:
    """`scalar_rgb`, which needs nothing else, or `llvm_ad_rgb`, which needs LLVM. Before anything else of Mitsuba."""
    mi.set_variant(variant)


def bsdf(inputs: dict[str, Any]) -> dict[str, Any]:
    """Mitsuba's description of `inputs["bsdf"]`.

    - `lambert`: `reflectance` `(3,)`.
    - `ggx`: `alpha`; no Fresnel term (material `none` reflects everything), no diffuse part.
    - `glossy`: `reflectance` `(3,)`, `alpha`; the lobe of `ggx` with the weight `share`, `lambert` with the rest of 1.
    - `measured`: `path`, of an RGL `*.bsdf`.
    - `hshjax`: `path`, of a saved model; `sampling`, see `hshjax.io.mitsuba`. Negative values stay. The one material
      that takes an environment with `hshjax` in it.
    """
    match inputs["bsdf"]:
        case "lambert":
            return {"type": "diffuse", "reflectance": {"type": "rgb", "value": inputs["reflectance"].tolist()}}
        case "ggx":
            return {"type": "roughconductor", "distribution": "ggx", "material": "none", "alpha": inputs["alpha"]}
        case "glossy":
            return {
                "type": "blendbsdf",
                "weight": inputs["share"],
                "body": bsdf(inputs | {"bsdf": "lambert"}),
                "lobe": bsdf(inputs | {"bsdf": "ggx"}),
            }
        case "measured":
            return {"type": "measured", "filename": inputs["path"]}
        case "hshjax":
            import hshjax.io.mitsuba

            hshjax.io.mitsuba.register()
            return {
                "type": "hshjax", "filename": inputs["path"], "sampling": inputs["sampling"], "clamp": False,
            }  # fmt: skip
    raise ValueError(f"bsdf must be lambert, ggx, glossy, measured or hshjax, got {inputs['bsdf']!r}")


def lit_sphere(inputs: dict[str, Any]) -> dict[str, Any]:
    """A unit sphere at the origin under `environment` `(height, width, 3)` [W m^-2 sr^-1], +y up."""
    image = np.ascontiguousarray(inputs["environment"], np.float32)
    return {
        "type": "scene",
        "sphere": {"type": "sphere", "bsdf": bsdf(inputs)},
        # In RGB variants the values stay as they are: nothing is taken for sRGB.
        "environment": {"type": "envmap", "bitmap": mi.Bitmap(image)},
    }
