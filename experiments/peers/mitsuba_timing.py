"""Times of Mitsuba 3 for a picture of a sphere under an environment map, and for its gradient. Runs inside its
environment.

Mitsuba compiles kernels at the first call and launches them without waiting: every time is taken after a call that is
thrown away, and from a quiet device to a quiet device.
"""

import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from exchange import answer
from mitsuba_scenes import choose, lit_sphere

LIGHT = "environment.data"
ALPHA = "sphere.bsdf.alpha.value"


def work(inputs: dict[str, Any]) -> dict[str, Any]:
    """Inputs: those of `mitsuba_scenes.lit_sphere`, and

    - `variant`: one that differentiates (`llvm_ad_rgb`). - `size`: pixels along a side. - `spp`: samples a pixel.
    - `repeats`: calls that are timed.
    - `integrator`: `direct` (one direction from the light and one from the BSDF) is differentiated as it stands; `prb`
      (path replay, here of one bounce) computes the same light and is made for gradients.

    The view is that of `mitsuba_sphere`, averaged over pixels. Returns

    - `value` `(repeats,)` [s]: the picture, of a scene that has been prepared.
    - `gradient` `(repeats,)` [s]: picture and gradient of its mean with respect to the light's pixels, and to alpha
      where the BSDF is `ggx` (tables are not differentiable), from new parameters on, as in a step of an optimiser.
    - `image` `(size, size, 3)`; `light_gradient` `(height, any width, 3)`; `alpha_gradient`, NaN where there is none;
      `euler`: Σ light · gradient / mean, which is 1 but for noise (the gradient has samples of its own), the picture
      being linear in the light. The light's pixels are those of Mitsuba's tensor, which repeats columns at its ends.
    """
    choose(inputs["variant"])
    size, spp = inputs["size"], inputs["spp"]
    integrator = {
        "direct": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 1, "hide_emitters": True},
        "prb": {"type": "prb", "max_depth": 2, "rr_depth": 1000, "hide_emitters": True},
    }[inputs["integrator"]]
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "component_format": "float32"}
    view = mi.ScalarTransform4f().look_at(origin=[0, 0, 2], target=[0, 0, 0], up=[0, 1, 0])
    scene = mi.load_dict(
        lit_sphere(inputs)
        | {
            "integrator": integrator,
            "sensor": {
                "type": "orthographic",
                "to_world": view,
                "film": film | {"rfilter": {"type": "box"}},
                "sampler": {"type": "independent"},
            },
        }
    )
    parameters = mi.traverse(scene)
    wanted = [LIGHT, ALPHA] if inputs["bsdf"] == "ggx" else [LIGHT]
    start = {name: dr.detach(parameters[name], preserve_type=False) for name in wanted}

    def value(seed: int) -> Any:
        image = mi.render(scene, spp=spp, seed=seed)
        dr.eval(image)
        return image

    def gradient(seed: int) -> Any:
        # Enabling the gradient of a tensor that the scene holds already gives exact zeros for the light, silently: it
        # must be enabled on a new one, before the scene gets it, and asked of that one.
        fresh = [type(parameters[name])(start[name]) for name in wanted]
        for name, parameter in zip(wanted, fresh, strict=True):
            dr.enable_grad(parameter)
            parameters[name] = parameter
        parameters.update()
        mean = dr.mean(mi.render(scene, parameters, spp=spp, seed=seed), axis=None)
        dr.backward(mean)
        found = [dr.grad(parameter) for parameter in fresh]
        dr.eval(mean, *found)
        return mean, found

    seconds, image = timed(value, inputs["repeats"])
    seconds_gradient, (mean, found) = timed(gradient, inputs["repeats"])
    light = found[0].numpy()
    return {
        "value": seconds,
        "gradient": seconds_gradient,
        "image": image.numpy(),
        "light_gradient": light,
        "alpha_gradient": float(np.array(found[1]).item()) if len(found) > 1 else np.nan,
        "euler": float(np.sum(light * np.array(start[LIGHT]), dtype=np.float64) / float(np.array(mean).item())),
    }


def timed(call: Callable[[int], Any], repeats: int) -> tuple[np.ndarray, Any]:
    """Seconds of calls with different seeds `(repeats,)`, and what the last one gave."""
    seconds = []
    for repeat in range(repeats + 1):
        dr.sync_thread()
        start = time.perf_counter()
        result = call(repeat)
        dr.sync_thread()
        seconds.append(time.perf_counter() - start)
    return np.array(seconds[1:]), result


if __name__ == "__main__":
    answer(work)
