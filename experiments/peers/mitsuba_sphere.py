"""Radiance of a sphere under an environment map by Mitsuba 3, with its standard error. Runs inside its environment.

The estimate is made at points, the centres of pixels, where a camera of Mitsuba would average over pixels: rays are
laid by hand and given to the integrator.
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from exchange import answer
from mitsuba_scenes import choose, lit_sphere

RAYS = 2**20
"""Rays that are traced together: about 100 MB with what they return."""


def work(inputs: dict[str, Any]) -> dict[str, np.ndarray]:
    """Inputs: those of `mitsuba_scenes.lit_sphere`, and

    - `variant`: of Mitsuba. - `size`: pixels along a side. - `spp`: samples at each point. - `seed`: of them, < 2^16.
    - `strategy`: `both` draws directions from the light and from the BSDF, weighted by the balance heuristic; `light`
      from the light only, which asks the BSDF for nothing but its value; `bsdf` from the BSDF only.
    - `directions` `(n, 3)`, unit.

    The eye looks along -z, orthographically, x to the right and y up; the image is [-1, 1]², its rows from the top.
    Returns `mean` and `error` `(size, size, 3)` [W m^-2 sr^-1], the radiance at the pixels' centres and its standard
    error; `inside` `(size, size)`, where the sphere is; `radiance` `(n, 3)`, of the light from the directions.
    """
    choose(inputs["variant"])
    scene = mi.load_dict(lit_sphere(inputs))
    from_light, from_bsdf = {"both": (1, 1), "light": (1, 0), "bsdf": (0, 1)}[inputs["strategy"]]
    integrator = mi.load_dict(
        {"type": "direct", "emitter_samples": from_light, "bsdf_samples": from_bsdf, "hide_emitters": True}
    )
    size, spp = inputs["size"], inputs["spp"]
    step = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(step, -step)
    inside = x * x + y * y < 1
    points = np.stack([x[inside], y[inside]], -1)

    # Sums of differences from a value near the mean: variances far below the square of the mean keep their digits.
    together = max(1, RAYS // len(points))
    done, centre, total, square = 0, None, 0.0, 0.0
    for part in range(-(-spp // together)):
        count = min(together, spp - done)
        value = samples(scene, integrator, points, count, (inputs["seed"] << 16) + part).astype(np.float64)
        centre = value.mean(1, keepdims=True) if centre is None else centre
        total += (value - centre).sum(1)
        square += ((value - centre) ** 2).sum(1)
        done += count
    variance = (square - total**2 / spp) / (spp - 1)
    mean, error = np.full((2, size, size, 3), np.nan)
    mean[inside] = centre[:, 0] + total / spp
    error[inside] = np.sqrt(variance / spp)
    light = scene.emitters()[0]
    return {"mean": mean, "error": error, "inside": inside, "radiance": radiance_from(light, inputs["directions"])}


def samples(scene: Any, integrator: Any, points: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Independent estimates of the radiance towards the eye at points `(n, 2)` of the image, `(n, count, 3)`."""
    sampler = mi.load_dict({"type": "independent"})
    rays = len(points) * count
    if not dr.is_array_v(mi.Float):
        sampler.seed(seed)
        value = [
            integrator.sample(scene, sampler, mi.RayDifferential3f([*point, 2], [0, 0, -1]))[0]
            for point in points
            for _ in range(count)
        ]
        return np.array(value).reshape(len(points), count, 3)
    sampler.seed(seed, rays)
    x, y = (mi.Float(np.repeat(axis, count).astype(np.float32)) for axis in points.T)
    value, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(mi.Point3f(x, y, 2), mi.Vector3f(0, 0, -1)))
    return np.array(value).T.reshape(len(points), count, 3)


def radiance_from(light: Any, directions: np.ndarray) -> np.ndarray:
    """Radiance of the light from directions `(n, 3)`, `(n, 3)`."""
    if not dr.is_array_v(mi.Float):
        return np.array([_from_one(light, w) for w in directions]).reshape(-1, 3)
    interaction = dr.zeros(mi.SurfaceInteraction3f, len(directions))
    interaction.wi = -mi.Vector3f(directions.T.astype(np.float32))
    return np.array(light.eval(interaction)).T


def _from_one(light: Any, w: np.ndarray) -> np.ndarray:
    interaction = mi.SurfaceInteraction3f()
    interaction.wi = -mi.Vector3f(w.tolist())
    return np.array(light.eval(interaction))


if __name__ == "__main__":
    answer(work)
