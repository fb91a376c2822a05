"""What a height field is judged by: its shading, the bending of its normals, its contour.

    E(z, s) = Σ_pixels Σ_lights mean_channels ψ(s R(n) - I; c) + λ Σ φ(L² D² n_xy; b) + γ L Σ_contour ψ(|n_xy - m|; d)

- R: Eq. 1; I: what the photograph holds, 1 where it is bright; s: a common scale.
- D² n_xy: second differences of the normal's x and y, 0 for planes and spheres, up to their rims. L is the root of the
  number of pixels, which makes λ the same for all resolutions.
- m: out of the mask, as long as the normal of a sphere of the mask's area is half a pixel inside of its rim.
- ψ(r; c) = c² ln(1 + r²/c²), Cauchy's: what fits badly counts little; φ(r; b) = 2b² (sqrt(1 + r²/b²) - 1): creases.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from hshjax._typing import Bool, Float
from hshjax.brdfs import AbstractBRDF
from hshjax.stereo._contour import silhouette
from hshjax.stereo._corners import Corners
from hshjax.stereo._slope_shading import Shading, slope_shading

MISFIT = 0.1
"""c, of a bright value."""

BENDING = 3e-7
"""λ, times what is asked for."""

CREASE = 5.0
"""b: of a normal that bends by as much as it does over the whole of a sphere when it crosses a fifth of it."""

CONTOUR, AWAY = 1e-3, 0.3
"""γ and d."""


class Target(NamedTuple):
    """What pixels of a mask should look like: what is known, and 0 elsewhere. Host arrays in float64.

    - `values`, `known`, `albedo` `(pixels, lights, channels)`. - `mask` `(rows, columns)`.
    """

    values: Float[np.ndarray, "pixels lights channels"]
    known: Float[np.ndarray, "pixels lights channels"]
    albedo: Float[np.ndarray, "pixels lights channels"]
    mask: Bool[np.ndarray, "rows columns"]


@dataclass(frozen=True)
class Weights:
    """How much bending counts, times `BENDING`; and `misfit`, c."""

    smoothness: float
    misfit: float = MISFIT

    def times(self, factor: float, wider: float = 1.0) -> "Weights":
        """Smoother, and with a wider c."""
        return replace(self, smoothness=self.smoothness * factor, misfit=self.misfit * wider)


class State(NamedTuple):
    """Heights of corners [pixels] and the logarithm of the scale; energy; shading `(pixels, lights, channels)`."""

    heights: Float[np.ndarray, " corners"]
    scale: float
    energy: float
    shading: Shading
    misfit: Float[np.ndarray, "pixels lights channels"]


class Equations(NamedTuple):
    """Of a Gauss-Newton step: gradient and matrix in heights, those of the scale, and what a step is measured by."""

    gradient: Float[np.ndarray, " corners"]
    matrix: Any
    metric: Any
    scale_gradient: float
    scale_square: float
    coupling: Float[np.ndarray, " corners"]


class ReliefEnergy:
    """E of photographs of a mask. - `contour`: whether normals look out of the mask at its silhouette."""

    def __init__(self, target: Target, brdf: AbstractBRDF, directions: Float[np.ndarray, "lights 3"], contour: bool):
        self.target, self.brdf, self.directions = target, brdf, directions
        self.corners = Corners(target.mask)
        self.length = np.sqrt(self.corners.pixels)
        pixels, outward = silhouette(target.mask)
        self.rim = pixels if contour else pixels[:0]
        # n_z² of a sphere of radius r, half a pixel inside of its rim, is 1/r.
        tilt = min(1 / np.sqrt(self.corners.pixels / np.pi), 0.5)
        self.outward = np.sqrt(1 - tilt) * outward[: len(self.rim)]

    @cached_property
    def share(self) -> Float[np.ndarray, "pixels lights channels"]:
        """Of each value in the mean over channels; 0 where nothing is known."""
        return self.target.known / self.target.values.shape[2]

    def at(self, heights: Float[np.ndarray, " corners"], scale: float, weights: Weights) -> State:
        """The state of heights and a logarithm of the scale."""
        slopes = self.corners.slopes(heights)
        shading = slope_shading(self.brdf, self.directions, slopes)
        shading = Shading(*(np.exp(scale) * self.target.albedo * part for part in shading))
        misfit = shading.value - self.target.values
        square = weights.misfit**2
        energy = square * np.sum(self.share * np.log1p(misfit**2 / square))
        flat = flattened(slopes)
        bend = np.sum(self._bent(flat) ** 2, axis=1)
        energy += weights.smoothness * BENDING * np.sum(2 * CREASE**2 * (np.sqrt(1 + bend / CREASE**2) - 1))
        away = np.sum((flat[self.rim] - self.outward) ** 2, axis=1)
        energy += CONTOUR * self.length * AWAY**2 * np.sum(np.log1p(away / AWAY**2))
        return State(heights, scale, float(energy), shading, misfit)

    def equations(self, state: State, weights: Weights) -> Equations:
        """The gradient, exactly, and the Gauss-Newton matrix of reweighted squares, twice the energy's."""
        from scipy import sparse

        def diagonal(values):
            return sparse.diags_array(values, format="csr")

        right, up, second = self.corners.right, self.corners.up, self.corners.second
        slopes = self.corners.slopes(state.heights)
        value, along_x, along_y = state.shading
        trust = self.trust(state, weights)

        def total(values):
            return np.sum(values, axis=(1, 2))

        # Of the photograph: two by two numbers a pixel.
        pull = np.stack([total(trust * state.misfit * along) for along in (along_x, along_y)], axis=1)
        mixed = right.T @ diagonal(total(trust * along_x * along_y)) @ up
        matrix = right.T @ diagonal(total(trust * along_x**2)) @ right + mixed
        matrix += up.T @ diagonal(total(trust * along_y**2)) @ up + mixed.T
        # Of the normals' x and y: matrices over pixels.
        flat, turn = flattened(slopes), flattening(slopes)
        stiff = weights.smoothness * BENDING * self.length**4
        stiff = stiff / np.sqrt(1 + np.sum(self._bent(flat) ** 2, axis=1) / CREASE**2)
        away = flat[self.rim] - self.outward
        held = np.zeros(self.corners.pixels)
        held[self.rim] = CONTOUR * self.length / (1 + np.sum(away**2, axis=1) / AWAY**2)
        pull_flat = second.T @ (stiff[:, None] * (second @ flat))
        pull_flat[self.rim] += held[self.rim, None] * away
        over_pixels = second.T @ diagonal(stiff) @ second + diagonal(held)
        of_x, of_y = (diagonal(turn[:, k, 0]) @ right + diagonal(turn[:, k, 1]) @ up for k in (0, 1))
        matrix += of_x.T @ over_pixels @ of_x + of_y.T @ over_pixels @ of_y
        pull += np.einsum("nij,ni->nj", turn, pull_flat)

        def on_corners(values):
            return right.T @ values[:, 0] + up.T @ values[:, 1]

        coupled = np.stack([total(trust * value * along) for along in (along_x, along_y)], axis=1)
        return Equations(
            on_corners(pull), matrix, of_x.T @ of_x + of_y.T @ of_y, float(np.sum(trust * value * state.misfit)),
            float(np.sum(trust * value**2)), on_corners(coupled),
        )  # fmt: skip

    def trust(self, state: State, weights: Weights) -> Float[np.ndarray, "pixels lights channels"]:
        """Weights of squares: 1 of what fits, less of what does not, over the number of channels."""
        return self.share / (1 + (state.misfit / weights.misfit) ** 2)

    def _bent(self, flat: Float[np.ndarray, "pixels 2"]) -> Float[np.ndarray, "differences 2"]:
        return self.length**2 * (self.corners.second @ flat)


def flattened(slopes: Float[np.ndarray, "pixels 2"]) -> Float[np.ndarray, "pixels 2"]:
    """x and y of the unit normal."""
    return -slopes / np.sqrt(1 + np.sum(slopes**2, axis=1, keepdims=True))


def flattening(slopes: Float[np.ndarray, "pixels 2"]) -> Float[np.ndarray, "pixels 2 2"]:
    """Derivatives of x and y of the unit normal (axis 1) in the slopes (axis 2)."""
    length = np.sqrt(1 + np.sum(slopes**2, axis=1))[:, None, None]
    return slopes[:, :, None] * slopes[:, None, :] / length**3 - np.eye(2) / length
