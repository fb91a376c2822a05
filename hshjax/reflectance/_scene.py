"""Images of a scene: what `reflect` says of every pixel, under one light after another."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float, PairFunction
from hshjax.camera import AbstractCamera
from hshjax.lighting import AbstractLighting
from hshjax.reflectance._reflect import reflect
from hshjax.surface import Surface


def _lights(lights: Any) -> tuple[AbstractLighting, ...]:
    lights = (lights,) if isinstance(lights, AbstractLighting) else tuple(lights)
    if not lights:
        raise ValueError("a scene needs at least one light")
    for light in lights:
        if not isinstance(light, AbstractLighting):
            hint = "; an image becomes one by EnvironmentMap(image, up=...)" if eqx.is_array_like(light) else ""
            raise ValueError(f"lights of a scene must be lights, got a {type(light).__name__}{hint}")
    return lights


class Scene(eqx.Module):
    """A surface of one material, seen by a camera, under lights that are switched on one after another.

    - `brdf`: a BRDF, or any function of pairs of directions [sr^-1].
    - `lights`: one for each image, or one for a single image; a light that is the sum of several is one.
    - `surface`: what the camera sees of the shape.
    - `camera`: or, for an eye far away, the unit vector towards it `(3,)`.

    **Raises:** ValueError for no lights, or something else among them; for another kind of BRDF or surface.
    """

    brdf: PairFunction
    lights: tuple[AbstractLighting, ...] = eqx.field(converter=_lights)
    surface: Surface
    camera: AbstractCamera | Float[Array, " 3"]

    def __check_init__(self):
        if not callable(self.brdf):
            hint = ", use its .model" if hasattr(self.brdf, "model") else ""
            raise ValueError(f"a scene needs a function of pairs of directions, got a {type(self.brdf).__name__}{hint}")
        if not isinstance(self.surface, Surface):
            raise ValueError(f"a scene needs a Surface, got a {type(self.surface).__name__}")


def render(scene: Scene, *, chunk: int | None = None) -> Float[Array, "lights *pixels channels"]:
    """Radiance `(lights, *pixels, channels)` [W m^-2 sr^-1] that reaches the camera; black where there is no surface.

    Attached shadows only, and no light from one part of a surface to another; a `ShadowedLight` or `MaskedLight` adds
    cast shadows. `chunk`: see `reflect`.

    **Raises:** ValueError for a camera or lights that do not fit the surface.
    """

    def image(light):
        surface = scene.surface
        return reflect(scene.brdf, light, surface.normal, scene.camera, positions=surface.position, chunk=chunk)

    structure, *others = (jax.tree.structure(light) for light in scene.lights)
    leaves = list(zip(*(jax.tree.leaves(light) for light in scene.lights), strict=False))
    if all(other == structure for other in others) and all(len({jnp.shape(x) for x in same}) == 1 for same in leaves):
        # Lights of one kind are one program, run over and over. What they share, such as a horizon, is held once.
        shared = [same[0] if all(x is same[0] for x in same) else None for same in leaves]
        own = [jnp.stack(same) for same, one in zip(leaves, shared, strict=True) if one is None]

        def of_own(values):
            values = iter(values)
            return image(structure.unflatten([next(values) if one is None else one for one in shared]))

        return jax.lax.map(of_own, own) if own else jnp.stack([of_own(())] * len(scene.lights))
    images = [image(light) for light in scene.lights]
    channels = max(one.shape[-1] for one in images)
    return jnp.stack([jnp.broadcast_to(one, (*one.shape[:-1], channels)) for one in images])
