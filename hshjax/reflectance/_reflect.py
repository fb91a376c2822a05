"""The reflectance equation, Eq. 1 of the paper: radiance that leaves a surface under a light.

    R(n, v) = ∫ L(w) ρ(wi, wo) max(n·w, 0) dω,   wi, wo: w and v in the local frame of n

It is linear in the light and in the BRDF: each pair of their parts goes the way that suits it, in closed form or as a
sum over emitters. Both ways are differentiable in light, BRDF and normals.
"""

from collections.abc import Callable, Iterator
from functools import reduce
from operator import add
from typing import Any

from hshjax._typing import Array, Float, PairFunction, Real
from hshjax.bases import IsotropicBasis
from hshjax.camera import AbstractCamera
from hshjax.lighting import AbstractLighting, HarmonicLight
from hshjax.reflectance._given import Given, given
from hshjax.reflectance._harmonic import harmonic_radiance
from hshjax.reflectance._parts import as_series, brdfs_of, lights_of
from hshjax.reflectance._quadrature import sum_over_emitters
from hshjax.reflectance._reflectance_map import map_radiance


def reflect(
    brdf: PairFunction,
    lighting: AbstractLighting,
    normals: Float[Array, "*batch 3"],
    view: Float[Array, "... 3"] | AbstractCamera,
    *,
    positions: Float[Array, "... 3"] | None = None,
    chunk: int | None = None,
) -> Real:
    """Radiance `(*batch, channels)` [W m^-2 sr^-1] that leaves points towards the eye.

    - `brdf`: a BRDF, or any function of pairs of directions [sr^-1].
    - `normals` `(*batch, 3)`: in the world, of any length. A zero vector marks a pixel without a surface: it is black,
      whatever is said of its position and view.
    - `view`: a camera; or vectors in the world, of any length, from the points TOWARDS the eye, `(3,)` for an eye far
      away or one for each point.
    - `positions` `(*batch, 3)`: in the world; lights and eyes nearby need them.
    - `chunk`: points that are looked at together; None: as many as suit the cache. Memory grows with it, in derivatives
      too: what a chunk computed is computed again instead of being kept. The closed form for an eye far away does not
      need it, and has blocks of its own.

    A `HarmonicLight` without a `degree` is integrated in closed form where the BRDF is a `LinearBRDF` or `Lambert`, or
    a sum or multiple of such; of mixed sums, each part goes its way. All else is a sum over the emitters of the light.

    Light from below the horizon of a point does not reach it (attached shadows). The result has the common dtype of
    normals, view and positions. An anisotropic BRDF is turned as `hshjax.geometry.frame` of the normal says.

    **Raises:** ValueError for a light or camera that needs positions and gets none, and for shapes that do not fit.
    """
    if chunk is not None and chunk < 1:
        raise ValueError(f"chunk must be >= 1, got {chunk}")
    points = given(lighting, normals, view, positions)
    radiance = reduce(add, _contributions(brdf, lighting, points, chunk))
    return radiance.reshape(*points.pixels, radiance.shape[1])


def _contributions(brdf, lighting, points: Given, chunk) -> Iterator[Float[Array, " n #channels"]]:
    """What the pairs of a part of the BRDF and a part of the light add to the radiance."""

    def in_closed_form(series, light):
        if points.eye is not None and isinstance(series.basis, IsotropicBasis):
            return map_radiance(series, light, points.normals, points.eye)
        return harmonic_radiance(series, light, points.normals, points.view, chunk)

    harmonic, lights = _partition(lights_of(lighting), lambda light: isinstance(light, HarmonicLight) and light.closed)
    series, others = _partition(brdfs_of(brdf), lambda part: as_series(part) is not None)
    if not harmonic or not series:
        yield sum_over_emitters(brdf, lighting, points, chunk)
        return
    for part in series:
        for light in harmonic:
            yield in_closed_form(as_series(part), light)
    if others:
        yield sum_over_emitters(reduce(add, others), reduce(add, harmonic), points, chunk)
    if lights:
        yield sum_over_emitters(brdf, reduce(add, lights), points, chunk)


def _partition(parts: list, chosen: Callable[[Any], bool]) -> tuple[list, list]:
    return [part for part in parts if chosen(part)], [part for part in parts if not chosen(part)]
