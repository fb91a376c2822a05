"""Photographs of known shapes and materials under known lights, made by this library's renderer.

- `scenes(names)`: by names "shape/material", see `_stereo_shapes.SHAPES` and `_stereo_materials`.
- `photographs(shape, material, lights)`: of one.

`_stereo_mitsuba` makes the same scenes with light from one part of a surface to another; `_stereo_corruption` spoils
photographs as cameras do.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments.recipes._stereo_lights import directional, separate
from experiments.recipes._stereo_materials import Layer, Material, material
from experiments.recipes._stereo_meshes import Shape, aimed, seen, visible
from experiments.recipes._stereo_shapes import SHAPES
from hshjax import (
    DirectionalLight,
    MaskedLight,
    OrthographicCamera,
    PerspectiveCamera,
    PointLight,
    Scene,
    Surface,
    render,
)
from hshjax.camera import AbstractCamera
from hshjax.photographs import Photographs

NAMES = (
    "sphere/lambert", "sphere/glossy:0.2", "blob/cook_torrance:0.25", "blob/textured:0.3", "vase/glossy:0.15",
    "bowl/lambert", "grooves/lambert", "corner/glossy:0.4", "folds/two:0.2", "pillars/metal:0.3",
)  # fmt: skip
"""Scenes that need no data."""

MEASURED = (
    "sphere/rgl:paper_white", "blob/rgl:golden_yellow", "vase/rgl:satin_rosaline", "folds/rgl:napoli",
    "sphere/merl:gold-metallic-paint", "blob/merl:red-fabric", "bowl/merl:yellow-phenolic", "head/merl:pink-felt",
    "head/merl:dark-blue-paint", "head/lambert",
)  # fmt: skip
"""Scenes that need HSHJAX_DATA."""


class View(NamedTuple):
    """What the camera sees of a shape: `mask` `(size, size)`; unit `normal` and `position` `(pixels, 3)`."""

    mask: np.ndarray
    normal: np.ndarray
    position: np.ndarray


def scenes(
    names: Sequence[str] = NAMES,
    *,
    size: int = 96,
    lights: int | DirectionalLight = 32,
    layout: str = "patch",
    spread: float = 0.0,
    shadows: bool = True,
    seed: int = 0,
) -> dict[str, Photographs]:
    """Photographs by name, "shape/material"; the same for the same seed, whatever others are made beside them.

    - `size`: pixels along a side. - `lights`: how many, or which; `layout`, `spread`: of those that are made, see
      `directional`.
    - `shadows`: cast ones; attached ones are always there.

    **Raises:** ValueError for unknown names, and for missing data where names ask for them.
    """
    chosen = directional(lights, layout, spread, seed) if isinstance(lights, int) else lights
    return {
        name: photographs(*parts(name, seed), chosen, size=size, shadows=shadows, seed=seed, note=name)
        for name in names
    }


def parts(name: str, seed: int) -> tuple[Shape, Material]:
    """Shape and material of a name.

    **Raises:** ValueError for unknown ones.
    """
    shape, _, surface = name.partition("/")
    if shape not in SHAPES:
        raise ValueError(f"a scene is a shape, one of {', '.join(SHAPES)}, / and a material, got {name!r}")
    return SHAPES[shape](seed), material(surface)


def photographs(
    shape: Shape,
    material: Material,
    lights: DirectionalLight | PointLight,
    *,
    camera: OrthographicCamera | PerspectiveCamera | None = None,
    off: float = 0.0,
    size: int = 96,
    shadows: bool = True,
    seed: int = 0,
    note: str = "",
) -> Photographs:
    """Radiance at the centres of pixels, without light from one part of the shape to another.

    `seed` is that of colours and patches, `note` what the scene is called. `camera`: one nearby, or one that tells
    where pixels are, as lights nearby ask for; None: far away. That of the photographs tells the mean depth, but for
    an error: `off` farther away than it is.
    """
    view = View(*seen(shape, size, camera))
    lamps = separate(lights)
    if shadows and not shape.convex:
        if isinstance(lights, DirectionalLight):
            towards = np.asarray(lights.direction)
        else:
            towards = np.asarray(lights.position) - view.position[:, None]
        lit = jnp.asarray(visible(shape, view.normal, view.position, towards), jax.tree.leaves(lights)[0].dtype)
        lamps = [MaskedLight(lamp, lit[:, k : k + 1]) for k, lamp in enumerate(lamps)]
    values = sum(_layer(layer, lamps, view, camera, seed) for layer in material.layers)
    told = None if camera is None else aimed(camera, view.position, off)
    cast = "with cast shadows" if shadows else "without cast shadows"
    notes = (f"synthetic, {note}: rendered {cast}, without interreflection",)
    return Photographs(np.moveaxis(values, 0, 1), view.mask, lights, told, view.normal, notes)


def _layer(layer: Layer, lamps: list, view: View, camera: AbstractCamera | None, seed: int) -> np.ndarray:
    """What a layer adds to the radiance, `(lights, pixels, channels)`."""
    surface = Surface(view.normal, view.position)
    eye = jnp.asarray([0.0, 0.0, 1.0]) if camera is None else camera
    radiance = np.asarray(render(Scene(layer.brdf, lamps, surface, eye)))
    if layer.share is None:
        return radiance
    # One generator for all layers of a material: their shares belong together.
    return radiance * layer.share(view.position, np.random.default_rng([seed, 2]))
