"""Shape from shading: heights and normals from one photograph of a known material under a known light."""

from collections.abc import Sequence
from typing import Any, Literal, get_args

import equinox as eqx
import numpy as np

from hshjax._typing import Bool, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.camera import AbstractCamera
from hshjax.lighting import DirectionalLight
from hshjax.photographs import Photographs, placed
from hshjax.stereo._axes import far_axes
from hshjax.stereo._contour import silhouette
from hshjax.stereo._corners import Corners
from hshjax.stereo._history import History, Progress, Stage
from hshjax.stereo._known import check_brdf, check_channels, known_albedo
from hshjax.stereo._relief_energy import ReliefEnergy, State, Target, Weights
from hshjax.stereo._relief_levels import dome, finer, levels
from hshjax.stereo._relief_solve import nearest_minimum
from hshjax.stereo._slope_shading import normals_of
from hshjax.stereo._strength import strengths, unit_directions

Start = Literal["smooth", "convex", "concave", "flat"]

BRIGHT = 0.95
"""Quantile of values above 0 that counts as bright."""

STARTS = {
    "smooth": (1, (1e4, 1e3, 1e2, 1e1)),
    "convex": (1, (1e2, 1e1)),
    "concave": (-1, (1e2, 1e1)),
    "flat": (0, (1e2, 1e1)),
}
"""By what a round hill is multiplied, and factors of the smoothness, one after the other, on the coarsest level. The
first begins so smooth that little is left of the hill but what the outline holds."""

FINE = (1e1, 1.0)
"""Factors of the smoothness on all other levels."""

WIDER = 3.0
"""Of what fits badly, while surfaces are smoother than they are to be."""


class SingleImage(eqx.Module):
    """A surface from its shading. Host arrays; pixels are those of the mask, row by row.

    - `normals` `(pixels, 3)`: unit, in the world: where `camera` is None, x right, y up, z towards it. Those of
      `corners`.
    - `heights` `(rows, columns)`: towards the camera [pixels], the means of the corners of each pixel; NaN outside.
      Their mean over each piece is 0; pieces that touch at a corner are one.
    - `corners` `(rows + 1, columns + 1)`: heights at the corners of pixels, likewise; the slope of a pixel in x is the
      mean of those of its upper and lower edge, likewise in y. NaN where no pixel is.
    - `prediction` `(pixels, lights, channels)`: the photographs, as the result has them.
    - `shadows` `(pixels, lights)`: where the surface turns away from the light, so that nothing but smoothness tells
      its normal. `outliers` `(pixels, lights)`: known values that count for less than a half, as they do not fit.
    - `determined` `(pixels,)`: whether any value is known that is neither. `contour` `(pixels,)`: whether the outline
      was told to hold the normal.
    - `scale`: by which BRDF times albedo is multiplied; 1 where it is known. - `start`: the one that led here.
    - `mask` `(rows, columns)`. - `history`: a stage for each start, with `energy` (a pixel), `misfit` (median, of a
      bright value) and `steps`. - `lights`, `camera`: those of the photographs.
    """

    normals: Float[np.ndarray, "pixels 3"]
    corners: Float[np.ndarray, "rows_and_1 columns_and_1"]
    heights: Float[np.ndarray, "rows columns"]
    prediction: Float[np.ndarray, "pixels lights channels"]
    shadows: Bool[np.ndarray, "pixels lights"]
    outliers: Bool[np.ndarray, "pixels lights"]
    determined: Bool[np.ndarray, " pixels"]
    contour: Bool[np.ndarray, " pixels"]
    scale: float
    start: str
    mask: Bool[np.ndarray, "rows columns"]
    history: tuple[Stage, ...]
    lights: DirectionalLight
    camera: AbstractCamera | None

    def image(self, values: Float[np.ndarray, "pixels ..."]) -> Float[np.ndarray, "rows columns ..."]:
        """Values of the pixels in their places, 0 elsewhere."""
        return placed(values, self.mask)


def solve_single_image(
    photographs: Photographs,
    brdf: AbstractBRDF,
    *,
    albedo: Any = None,
    scaled: bool = False,
    contour: bool = True,
    smoothness: float = 1.0,
    starts: Sequence[Start] = ("smooth", "convex", "concave", "flat"),
    progress: Progress | None = None,
) -> SingleImage:
    """A height field whose shading is that of a photograph, under a known light far away.

    Heights at the corners of pixels are moved until Eq. 1 gives the photograph, normals bend evenly (as those of planes
    and spheres do), and those of the outline look out of the mask. Gauss-Newton steps by sparse factors, from coarse to
    fine while smoothness decreases, from several starts, of which the one with the least energy is kept.

    - `photographs`: one; or several under different lights, which then determine more. `camera`: far away,
      turned in the world as it may be.
    - `brdf`: isotropic, of one channel or as many as photographs have. Times `albedo`, `(pixels,)` or `(pixels,
      channels)`, and times the irradiance of the light it gives the radiance of photographs.
    - `scaled`: whether one factor of all of `brdf` is unknown, and found.
    - `contour`: whether the mask ends where the surface turns away from the camera. Its border is not always that: it
      may be a cut, or an edge behind which the object goes on. The border of the photographs never counts.
    - `smoothness`: how much bending counts, relative to what suits photographs with little noise.
    - `starts`: what is tried: a smooth surface, round hills, round hollows, flat ground. A light near the camera tells
      no hills from hollows, and one aside hardly does where shadows are cast: name what is known, as in `("convex",)`.
    - `progress`: called with a stage, what is done and to do.

    Attached shadows are told from what the surface predicts; there normals are filled in smoothly (`shadows`). Cast
    shadows and light from other parts are not modelled. Values that are not finite are unknown.

    Source: Horn & Brooks, The Variational Approach to Shape from Shading, CVGIP 33(2), 1986, for the idea; heights as
    unknowns by Leclerc & Bobick, The Direct Computation of Height from Shading, CVPR 1991; even bending and outline by
    Barron & Malik, Shape, Illumination, and Reflectance from Shading, PAMI 37(8), 2015.

    **Raises:** ValueError for lights that are unknown, near or behind the object, a camera nearby, black photographs, a
    BRDF that is not isotropic, reflects nothing or has other channels, a mask without outline where `contour` is asked
    for, and arguments out of range.
    """
    if not (np.isfinite(smoothness) and smoothness > 0):
        raise ValueError(f"smoothness must be a finite number above 0, got {smoothness}")
    if not starts or not set(starts) <= set(get_args(Start)):
        raise ValueError(f"starts must be some of {', '.join(get_args(Start))}, got {tuple(starts)!r}")
    axes = far_axes(photographs.camera)
    lights, directions, irradiance = _lights(photographs, axes)
    check_brdf(brdf, directions, photographs.channels)
    albedo = known_albedo(albedo, photographs.pixels, photographs.channels)
    target = _target(photographs, irradiance, albedo[:, None])
    bright = float(np.quantile(target.values[target.values > 0], BRIGHT))
    target = target._replace(values=target.values / bright, albedo=target.albedo / bright)
    if contour and not len(silhouette(photographs.mask)[0]):
        raise ValueError("the mask has no outline inside of the photographs: ask for contour=False")
    energies = [ReliefEnergy(level, brdf, directions, contour) for level in levels(target)]
    weights, history = Weights(smoothness), History(progress)
    found: dict[str, State] = {}
    for name in starts:
        with history.stage(name, len(energies)) as done:
            found[name], steps = from_start(name, energies, weights, scaled, done)
            known = energies[0].target.known > 0
            done.figures |= {
                "energy": found[name].energy / photographs.pixels,
                "misfit": float(np.median(np.abs(found[name].misfit[known]))),
                "steps": float(steps),
            }
    start = min(found, key=lambda name: found[name].energy)
    state, energy = found[start], energies[0]
    dark = np.all(state.shading.value <= 0, axis=2)
    fits = 2 * energy.trust(state, weights) >= energy.share
    known = energy.target.known > 0
    outliers = np.any(known & ~fits, axis=2)
    held = np.zeros(photographs.pixels, bool)
    held[energy.rim] = True
    corners, heights = _placed_heights(energy.corners, state.heights)
    normals = normals_of(energy.corners.slopes(state.heights)) @ axes
    return SingleImage(
        normals=normals, corners=corners, heights=heights,
        prediction=state.shading.value * bright * irradiance, shadows=dark, outliers=outliers,
        determined=np.any(np.any(known, axis=2) & ~dark & ~outliers, axis=1), contour=held,
        scale=float(np.exp(state.scale)), start=start, mask=photographs.mask, history=tuple(history.stages),
        lights=lights, camera=photographs.camera,
    )  # fmt: skip


def from_start(name: str, energies: list[ReliefEnergy], weights: Weights, scaled: bool, done) -> tuple[State, int]:
    """The minimum that a start leads to, and how many steps it took."""
    coarsest = energies[-1]
    hill = dome(coarsest.corners)
    sign, coarse = STARTS[name]
    heights = sign * hill
    scale, steps = _first_scale(coarsest, hill) if scaled else 0.0, 0
    state = coarsest.at(heights, scale, weights)
    for number, energy in reversed(list(enumerate(energies))):
        factors = coarse if energy is coarsest else FINE
        factors = (*factors, 1.0) if energy is coarsest and number == 0 else factors
        for factor in factors:
            now = weights.times(factor, WIDER if factor > 1 else 1.0)
            state, more = nearest_minimum(energy, energy.at(state.heights, state.scale, now), now, scaled)
            steps += more
        if number:
            below = energies[number - 1]
            heights = finer(state.heights, energy.corners, below.corners)
            state = below.at(heights, state.scale, weights)
        done()
    return state, steps


def _first_scale(energy: ReliefEnergy, hill: Float[np.ndarray, " corners"]) -> float:
    """Logarithm of what makes a hill as bright as the photographs."""
    shading = energy.at(hill, 0.0, Weights(1.0)).shading.value
    bright = [float(np.quantile(values[values > 0], BRIGHT)) for values in (energy.target.values, shading)]
    return float(np.log(bright[0] / bright[1]))


def _placed_heights(
    corners: Corners, heights: Float[np.ndarray, " corners"]
) -> tuple[Float[np.ndarray, "rows_and_1 columns_and_1"], Float[np.ndarray, "rows columns"]]:
    """Heights of corners and of pixels in their places; the mean over the pixels of each piece is 0."""
    from scipy import ndimage

    labels = np.zeros(corners.mask.shape, int)
    ndimage.label(corners.mask, np.ones((3, 3)), output=labels)
    piece = labels[corners.mask]
    pixels = corners.middle @ heights
    means = np.bincount(piece, pixels) / np.maximum(np.bincount(piece), 1)
    of_corner = np.zeros(corners.count, int)
    of_corner[corners.middle.indices] = np.repeat(piece, 4)
    placed_corners, placed_pixels = np.full(corners.used.shape, np.nan), np.full(corners.mask.shape, np.nan)
    placed_corners[corners.used] = heights - means[of_corner]
    placed_pixels[corners.mask] = pixels - means[piece]
    return placed_corners, placed_pixels


def _lights(photographs: Photographs, axes: np.ndarray) -> tuple[DirectionalLight, np.ndarray, np.ndarray]:
    """Lights, unit directions in the axes of the camera `(lights, 3)`, irradiance `(lights, 1 or channels)`."""
    lights = photographs.lights
    if not isinstance(lights, DirectionalLight):
        kind = "none" if lights is None else type(lights).__name__
        raise ValueError(f"shape from shading needs known lights far away (DirectionalLight), got {kind}")
    directions = unit_directions(lights) @ axes.T
    if not np.all(directions[:, 2] > 0):
        raise ValueError(f"lights must be on the camera's side of the object, z > 0, got {directions[:, 2].min()}")
    irradiance = strengths(lights).astype(float)
    check_channels("lights", irradiance.shape[1], photographs.channels)
    if not np.all(np.isfinite(irradiance) & (irradiance > 0)):
        raise ValueError("the irradiance of every light must be a finite number above 0")
    return lights, directions, irradiance


def _target(photographs: Photographs, irradiance: np.ndarray, albedo: np.ndarray) -> Target:
    values = np.asarray(photographs.values, float) / irradiance
    known = np.isfinite(values)
    values = np.where(known, values, 0)
    black = (np.flatnonzero(~np.any(values > 0, axis=(0, 2))) + 1).tolist()
    if black:
        raise ValueError(f"photographs {black} are black: no known value is above 0")
    return Target(values, known.astype(float), np.broadcast_to(albedo, values.shape), photographs.mask)
