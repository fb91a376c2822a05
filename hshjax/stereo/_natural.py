"""Shape in natural illumination: what a few photographs of one object tell where light comes from all around."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from hshjax._typing import Array, Bool, Float
from hshjax.bases._base import matmul
from hshjax.brdfs import AbstractBRDF, Lambert
from hshjax.brdfs._base import in_dtype
from hshjax.camera import AbstractCamera
from hshjax.fitting import AbstractTerm, fit
from hshjax.lighting import HarmonicLight
from hshjax.photographs import Photographs, placed
from hshjax.reflectance import reflect
from hshjax.stereo._axes import far_axes
from hshjax.stereo._history import History, Progress, Stage
from hshjax.stereo._inflated import Bulge, Inflated, bending
from hshjax.stereo._known import check_brdf, check_channels, known_albedo
from hshjax.stereo._natural_light import ALL_AROUND, light_columns
from hshjax.stereo._result import angular_errors

LIGHT = 5.0
"""Standard deviation of coefficients of light before photographs are seen, over the photographs' root mean square."""

HEIGHTS = (1.0, 0.5, 1.6)
"""Of domes to begin with, over that which is a sphere on a disk."""

NEAR = 1.02
"""Starts agree with the best where their loss is below this times the least."""

RIM = 0.15
"""Error of n_z that pixels of an outline make, times the height of the dome there [pixels]: the outline is known to
half a pixel, and a sphere's n_z at a height z errs by up to 1 / 4z then. Radiance is trusted accordingly."""

STEADY = 1e-5
"""A fit ends where the loss changes by less than this share of it, and fields by less than this."""


class NaturalShape(eqx.Module):
    """Shape and light, from photographs in natural illumination. Host arrays; pixels are those of the mask, row by row.

    - `normals` `(pixels, 3)`: unit, in the world: where `camera` is None, x right, y up, z towards it.
    - `heights` `(rows, columns)`: towards the camera [pixels], above the plane of the outline; NaN outside.
    - `lights`: many in one, as of `jax.vmap(HarmonicLight)`, in the world.
    - `prediction` `(pixels, images, channels)`: the photographs, as the result has them.
    - `residual`: root mean square of what is not explained, over that of the photographs.
    - `losses` `(starts,)`: of all starts; `spread` `(starts,)`: mean angle of their normals with those returned
      [degrees]. Starts of equal loss with a large spread are an ambiguity that was met.
    - `mask`, `history`, `camera`: as of `Stereo`.
    """

    normals: Float[np.ndarray, "pixels 3"]
    heights: Float[np.ndarray, "rows columns"]
    lights: HarmonicLight
    prediction: Float[np.ndarray, "pixels images channels"]
    residual: float
    losses: Float[np.ndarray, " starts"]
    spread: Float[np.ndarray, " starts"]
    mask: Bool[np.ndarray, "rows columns"]
    history: tuple[Stage, ...]
    camera: AbstractCamera | None

    def image(self, values: Float[np.ndarray, "pixels ..."]) -> Float[np.ndarray, "rows columns ..."]:
        """Values of the pixels in their places, 0 elsewhere."""
        return placed(values, self.mask)

    def agreeing(self) -> int:
        """How many starts end as low as the best, within 2 %; one that diverged (NaN) does not."""
        return int(np.sum(self.losses <= NEAR * np.nanmin(self.losses)))


def solve_natural(
    photographs: Photographs,
    *,
    brdf: AbstractBRDF | None = None,
    albedo: Any = None,
    order: int = 2,
    noise: float = 0.01,
    bend: float = 10.0,
    base: bool = False,
    heights: tuple[float, ...] = HEIGHTS,
    steps: int = 500,
    progress: Progress | None = None,
) -> NaturalShape:
    """Shape, and light where it is unknown, from one to a few photographs in light from all around.

    A surface that bulges out of its outline, whose normals look outwards all along it, is fitted by gradients through
    Eq. 1 (`hshjax.fit`), as a sum of coarse and fine forms. Where `photographs.lights` is None, light is a series of
    spherical harmonics that is always the best one for the shape, in closed form (variable projection).

    - `photographs`: each in a light of its own. `lights`: many `HarmonicLight` in one, in the world, known; or None.
      `camera`: far away, turned in the world as it may be.
    - `brdf`: isotropic, known, of one channel or those of the photographs; None: `Lambert(1)`. `albedo`: its factors,
      `(pixels,)` or `(pixels, channels)`; None: 1. - `order`: of light that is to be found.
    - `noise`: of values, relative to the root mean square of their photograph and channel.
    - `bend`: standard deviation of second derivatives of the logarithm of heights, over the object's radius: the
      smaller, the smoother. - `base`: whether the outline need not lie in a plane.
    - `heights`: of the domes to begin with, a start each. - `steps`: of the solver, at most.

    One photograph in one channel has one number a pixel for two of its normal: outline and smoothness decide the rest.
    An isotropic material looks the same on the surface reflected in depth, with light turned half around the view;
    outlines that bulge decide that.

    **Raises:** ValueError for a camera nearby, lights of another kind, shapes that do not fit, a BRDF that is not
    isotropic, reflects nothing or has other channels, a mask of one row or column, arguments out of range, and
    photographs that are black or of which nothing is known.
    """
    _check(photographs, order, noise, bend, heights, steps)
    history = History(progress)
    shape = Inflated.of(photographs.mask, jnp.result_type(float))
    dtype = shape.dome.dtype
    axes = far_axes(photographs.camera)
    brdf = in_dtype(Lambert(jnp.ones(())) if brdf is None else brdf, dtype)
    check_brdf(brdf, ALL_AROUND, photographs.channels)
    term = _term(photographs, shape, brdf, albedo, order, noise)
    objective = {"photographs": term, "bend": Bend(shape, jnp.asarray(bend, dtype))}
    solver, levels, ends = optx.LBFGS(rtol=STEADY, atol=STEADY), shape.levels(), []
    for height in heights:
        with history.stage(f"dome {height:g}") as done:
            start = shape.flat(levels, max(levels - 2, 1) if base else 0, height)
            fitted = fit(start, objective, solver, max_steps=steps, throw=False)
            done.figures |= {name: float(loss) for name, loss in fitted.losses.items()}
            done.figures["steps"] = float(fitted.steps)
            done()
        ends.append((float(fitted.loss), fitted.model))
    losses = np.array([loss for loss, _ in ends])
    if not np.isfinite(losses).any():
        raise ValueError("no start came to a finite loss: are values or lights too large for this precision?")
    best = ends[int(np.nanargmin(losses))][1]
    normals = np.asarray(shape.normals(best), float)
    spread = [angular_errors(np.asarray(shape.normals(bulge), float), normals).mean() for _, bulge in ends]
    coefficients, radiance = term.explained(shape.normals(best))
    radiance = np.asarray(radiance)
    shown = np.where(np.asarray(term.known), np.moveaxis(np.asarray(photographs.values), 0, 1), 0)
    missed = np.where(np.asarray(term.known), radiance - shown, 0)
    return NaturalShape(
        normals=normals @ axes, heights=placed(np.asarray(shape.heights(best), float), photographs.mask, np.nan),
        lights=_turned(coefficients, axes.T), prediction=np.moveaxis(radiance, 0, 1),
        residual=float(np.sqrt(np.sum(missed**2) / np.sum(shown**2))), losses=losses, spread=np.array(spread),
        mask=photographs.mask, history=tuple(history.stages), camera=photographs.camera,
    )  # fmt: skip


class Natural(AbstractTerm):
    """Photographs less Eq. 1, over their noise, for light that is given or the best one for the shape.

    - `values` `(images, pixels, channels)`, 0 where unknown; `known`: 1 or 0 there; `deviation`: of noise and
      of the outline. `level` `(images, 1, channels)`: the photographs' root mean square.
    - `albedo` `(pixels, channels)`. - `light` `(images, modes, channels)`: None where it is to be found.
    """

    shape: Inflated
    brdf: AbstractBRDF
    values: Float[Array, "images pixels channels"]
    known: Float[Array, "images pixels channels"]
    deviation: Float[Array, "images pixels channels"]
    level: Float[Array, "images 1 channels"]
    albedo: Float[Array, "pixels channels"]
    light: Float[Array, "images modes channels"] | None
    order: int = eqx.field(static=True)

    def __call__(self, model: Bulge):
        normals = self.shape.normals(model)
        coefficients, radiance = self.explained(normals)
        residual = self.known * (radiance - self.values) / self.deviation
        if self.light is not None:
            return residual
        # Part of what the light is the best for: without it the gradient would not be that of the loss.
        return residual, coefficients / (LIGHT * self.level)

    def explained(self, normals: Float[Array, "pixels 3"]) -> tuple[Array, Array]:
        """Coefficients of light `(images, modes, channels)` and radiance `(images, pixels, channels)`."""
        held = jax.lax.stop_gradient(normals)
        coefficients = self._best(held) if self.light is None else self.light
        view = jnp.asarray([0, 0, 1], normals.dtype)

        def under(light):
            return self.albedo * reflect(self.brdf, HarmonicLight(light), normals, view)

        return coefficients, jax.lax.map(under, coefficients)

    def _best(self, normals: Float[Array, "pixels 3"]) -> Float[Array, "images modes channels"]:
        """The least squares, with a ridge, of the coefficients for some normals."""
        design = light_columns(self.brdf, self.order, normals)
        design = jnp.broadcast_to(design, (*design.shape[:2], self.values.shape[2])) * self.albedo[:, None]
        unit = jnp.eye(design.shape[1], dtype=design.dtype)

        def channel(design, values, weight, level):
            weighted = weight[:, None] * design
            gram = matmul(weighted.T, design) + unit / (LIGHT * level) ** 2
            return jnp.linalg.solve(gram, matmul(weighted.T, values[:, None])[:, 0])

        def image(given):
            return jax.vmap(channel, (2, 1, 1, 0), 1)(design, *given)

        weight = self.known / self.deviation**2
        return jax.lax.stop_gradient(jax.lax.map(image, (self.values, weight, self.level[:, 0])))


class Bend(AbstractTerm):
    """Second differences of the fields, over `bend` a radius squared; each pixel as its share of the object's area."""

    shape: Inflated
    bend: Float[Array, ""]

    def __call__(self, model: Bulge):
        fields = self.shape.fields(model)
        return [self.shape.radius / self.bend * part for field in fields for part in bending(field)]


def _turned(coefficients: Float[Array, "images modes channels"], turn: np.ndarray) -> HarmonicLight:
    """Lights in one, turned with the world by a rotation; as they are where it is none."""
    lights = jax.vmap(HarmonicLight)(coefficients)
    if np.array_equal(turn, np.eye(3)):
        return lights
    return jax.vmap(lambda light: light.rotated(jnp.asarray(turn, coefficients.dtype)))(lights)


def _term(photographs, shape, brdf, albedo, order, noise) -> Natural:
    dtype = shape.dome.dtype
    values = np.moveaxis(np.asarray(photographs.values, float), 0, 1)
    known = np.isfinite(values)
    albedo = known_albedo(albedo, photographs.pixels, photographs.channels)
    shown = np.where(known, values, 0)
    level = np.sqrt(np.sum(shown**2, axis=1, keepdims=True) / np.maximum(np.sum(known, axis=1, keepdims=True), 1))
    if not np.all(level > 0):
        dark = np.unique(np.nonzero(level[:, 0] == 0)[0] + 1).tolist()
        raise ValueError(f"photographs {dark} are black, or nothing is known of them, in a channel: leave them out")
    light = None if photographs.lights is None else photographs.lights.coefficients
    if light is not None:
        check_channels("lights", light.shape[2], photographs.channels)
        light = jnp.broadcast_to(jnp.asarray(light, dtype), (*light.shape[:2], photographs.channels))
        light = _turned(light, far_axes(photographs.camera)).coefficients  # the world of the term is the camera's
    rim = RIM / np.sqrt(np.asarray(shape.dome))[None, :, None]
    deviation = level * np.sqrt(noise**2 + rim**2)
    shown, known, deviation, level, albedo = (jnp.asarray(a, dtype) for a in (shown, known, deviation, level, albedo))
    return Natural(shape, brdf, shown, known, deviation, level, albedo, light, order)


def _check(photographs: Photographs, order: int, noise: float, bend: float, heights, steps: int) -> None:
    if min(photographs.mask.shape) < 2:
        raise ValueError(f"the mask must have at least 2 rows and 2 columns, got {photographs.mask.shape}")
    if photographs.lights is not None and not isinstance(photographs.lights, HarmonicLight):
        kind = type(photographs.lights).__name__
        raise ValueError(
            f"lights must be None or HarmonicLight, many in one, got {kind}: HarmonicLight.from_environment"
        )
    for name, value, least in (("order", order, 0), ("steps", steps, 1)):
        if value < least:
            raise ValueError(f"{name} must be at least {least}, got {value}")
    for name, value in (("noise", noise), ("bend", bend), *(("heights", height) for height in heights)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be a finite number above 0, got {value}")
    if not heights:
        raise ValueError("heights: at least one dome to begin with")
