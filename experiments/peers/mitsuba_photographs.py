"""Photographs of a mesh under distant lights, one after another, by path tracing. Runs inside Mitsuba's environment."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from exchange import answer
from mitsuba_scenes import bsdf, choose
from mitsuba_sphere import RAYS, samples


def work(inputs: dict[str, Any]) -> dict[str, np.ndarray]:
    """Inputs: those of `mitsuba_scenes.bsdf`, and

    - `variant`: of Mitsuba. - `depth`: of paths; 2 is direct light. - `spp`: samples. - `seed`: of them.
    - `vertices`, `normals` `(vertices, 3)`, `faces` `(faces, 3)`. - `points` `(n, 2)`: x and y of the rays of an eye
      that looks along -z from z = 2.
    - `directions` `(lights, 3)`: towards the lights. - `irradiance` `(lights, 3)`: of a surface that faces them.

    Returns `mean` `(n, lights, 3)`, the radiance, and `error`, its standard error; `normal` `(n, 3)`, as shaded.
    """
    choose(inputs["variant"])
    scene = mi.load_dict(
        {
            "type": "scene",
            "embree_use_robust_intersections": True,  # otherwise rays that meet an edge exactly pass through
            "shape": mesh(inputs),
            "light": {"type": "directional", "direction": [0, 0, -1], "irradiance": {"type": "rgb", "value": 1.0}},
        }
    )
    light = mi.traverse(scene)
    # Paths end by chance only far beyond the lengths that are asked for.
    integrator = mi.load_dict({"type": "path", "max_depth": inputs["depth"], "rr_depth": 1000})
    points, spp = inputs["points"], inputs["spp"]
    lights = list(zip(inputs["directions"], inputs["irradiance"], strict=True))
    mean, error = np.zeros((2, len(points), len(lights), 3))
    for k, (towards, irradiance) in enumerate(lights):
        light["light.to_world"] = turned(towards)
        light["light.irradiance.value"] = mi.Color3f(irradiance.tolist())
        light.update()
        mean[:, k], error[:, k] = estimate(scene, integrator, points, spp, (inputs["seed"], k))
    return {"mean": mean, "error": error, "normal": normals(scene, points)}


def mesh(inputs: dict[str, Any]) -> Any:
    """The shape with its material; normals are interpolated between vertices."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf(inputs))
    vertices, faces = inputs["vertices"], inputs["faces"]
    shape = mi.Mesh("shape", len(vertices), len(faces), has_vertex_normals=True, props=properties)
    fields = mi.traverse(shape)
    for field, values in (("vertex_positions", vertices), ("vertex_normals", inputs["normals"])):
        fields[field] = values.ravel().astype(np.float32)
    fields["faces"] = faces.ravel().astype(np.uint32)
    fields.update()
    return shape


def turned(towards: np.ndarray) -> Any:
    """The frame of parallel light, which goes along its z."""
    up = [1, 0, 0] if abs(towards[0]) < 0.5 else [0, 1, 0]
    return mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=(-towards).tolist(), up=up)


def estimate(
    scene: Any, integrator: Any, points: np.ndarray, spp: int, seeds: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard error `(n, 3)` at points; the error of a single sample is 0, of light without chance."""
    together = max(1, RAYS // spp)
    values = []
    for start in range(0, len(points), together):
        seed = int(np.random.SeedSequence([*seeds, start]).generate_state(1)[0])
        values.append(samples(scene, integrator, points[start : start + together], spp, seed))
    value = np.concatenate(values).astype(np.float64)
    return value.mean(1), value.std(1, ddof=min(1, spp - 1)) / np.sqrt(spp)


def normals(scene: Any, points: np.ndarray) -> np.ndarray:
    """Of the shading frame at what the eye sees, `(n, 3)`."""
    if not dr.is_array_v(mi.Float):
        return np.array([scene.ray_intersect(mi.Ray3f([*point, 2], [0, 0, -1])).sh_frame.n for point in points])
    x, y = (mi.Float(axis.astype(np.float32)) for axis in points.T)
    rays = mi.Ray3f(mi.Point3f(x, y, 2), mi.Vector3f(0, 0, -1))
    return np.array(scene.ray_intersect(rays).sh_frame.n).T


if __name__ == "__main__":
    answer(work)
