"""Heights and depths of surfaces with given normals."""

import abc
from typing import Any

import numpy as np

from hshjax._typing import Bool, Float
from hshjax.camera import AbstractCamera, PerspectiveCamera
from hshjax.stereo._axes import camera_axes, far_axes
from hshjax.stereo._poisson import Edges, differences, solve

TOLERANCE, ROUGHLY = 1e-10, 1e-6
"""Of residuals, beside the right-hand side; and while shares are not settled."""

ROUNDS, SETTLED, STEEPNESS = 100, 1e-2, 2.0
"""With jumps: the most solutions, the change of any share that ends them, and how sharply residuals decide."""


def height_from_normals(
    normals: Any,
    mask: Any = None,
    *,
    camera: AbstractCamera | None = None,
    spacing: float = 1.0,
    jumps: bool = False,
    horizon: float = 0.01,
) -> Float[np.ndarray, "rows columns"]:
    """Heights `(rows, columns)` towards the viewer of a surface with these normals, seen from far away: float64, on the
    host.

    - `normals` `(rows, columns, 3)`: in the world, as results have them. Their length does not count.
    - `mask` `(rows, columns)`: where there is a surface; None: everywhere.
    - `camera`: far away, turned in the world as it may be; of it nothing else counts, `height` neither. None: x is to
      the right, y up, z towards the viewer; row 0 has the largest y, as in `height_field`.
    - `spacing`: between neighbouring pixels; heights are in its unit.
    - `jumps`: whether the surface may be torn. If not, heights bend where it is. If so, each pixel shares its belief
      between its two neighbours in a row and in a column, by how well they fit its normal, until shares settle: up to
      a hundred solutions. Source: Cao et al., Bilateral Normal Integration, ECCV 2022; shares are by residuals.
    - `horizon`: pixels with a smaller n_z have no height: a normal there says nothing of a pixel's height.

    NaN outside the mask, where a normal is zero or NaN, and at the horizon. Heights of each piece of what is left
    (neighbours share an edge) have mean 0: normals do not tell how pieces lie to each other.

    Least squares over pairs of neighbours a, b: the chord between them is perpendicular to the mean normal,
    (n_a + n_b) · (P_b - P_a) = 0. That is exact for planes and spheres, and of second order in the spacing for others.
    It weighs a pair by its mean n_z, so that it stays finite at the horizon.

    **Raises:** ValueError for other shapes, a camera nearby, no pixel with a normal, a spacing that is not above 0, and
    a horizon outside [0, 1); RuntimeError where the solver does not converge.
    """
    vectors, inside = _checked(normals, mask, spacing, "spacing")
    vectors = vectors @ far_axes(camera).T
    inside = _seen(inside, vectors[..., 2], horizon)
    values = _integrated(vectors, inside, _Far(float(spacing)), jumps)
    return np.where(inside, values - _means(values, inside), np.nan)


def depth_from_normals(
    normals: Any,
    camera: PerspectiveCamera,
    mask: Any = None,
    *,
    distance: float = 1.0,
    jumps: bool = False,
    horizon: float = 0.01,
) -> Float[np.ndarray, "rows columns"]:
    """Depths `(rows, columns)` of a surface with these normals, seen by a pinhole: from the eye, along its axis.

    As `height_from_normals`, but for these:

    - `distance`: the geometric mean of the depths of each piece, which normals do not tell.
    - `horizon`: is about the cosine between normal and ray.

    For points P = eye + t d, where d has length 1 along the axis, the equation of a chord gives the difference of ln t.
    Source of the logarithm: Quéau, Durou and Aujol, Normal Integration: A Survey, JMIV 60(4), 2018.

    **Raises:** as `height_from_normals`; ValueError for normals of another resolution than the camera's, and a distance
    that is not above 0.
    """
    vectors, inside = _checked(normals, mask, distance, "distance")
    if inside.shape != camera.resolution:
        raise ValueError(f"normals must have the resolution of the camera, {camera.resolution}, got {inside.shape}")
    vectors = vectors @ camera_axes(camera).T
    rows, columns = inside.shape
    apart = 2 * np.tan(float(camera.field_of_view) / 2) / rows
    ray = np.empty((rows, columns, 3))
    ray[..., 0] = apart * (np.arange(columns) - (columns - 1) / 2)
    ray[..., 1] = apart * ((rows - 1) / 2 - np.arange(rows))[:, None]
    ray[..., 2] = -1
    facing = -np.sum(vectors * ray, axis=-1) / np.linalg.norm(ray, axis=-1)
    inside = _seen(inside, facing, horizon)
    values = _integrated(vectors, inside, _Near(ray, apart), jumps)
    return np.where(inside, distance * np.exp(values - _means(values, inside)), np.nan)


class _AbstractView(abc.ABC):
    """What a normal says of two neighbours, along axis 0 (to the right) or 1 (up)."""

    @abc.abstractmethod
    def equation(self, normal: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
        """Of normals on the edges of an axis: weight, and the difference of values that it asks for."""

    @abc.abstractmethod
    def residual(self, normal: np.ndarray, change: np.ndarray, axis: int) -> np.ndarray:
        """Height of the other end above the plane of a normal, in pixels, given the difference of values."""


class _Far(_AbstractView):
    """From far away: values are heights."""

    def __init__(self, spacing: float):
        self.spacing = spacing

    def equation(self, normal, axis):
        seen = normal[..., 2] > 0
        return normal[..., 2], -self.spacing * np.where(seen, normal[..., axis], 0) / np.where(seen, normal[..., 2], 1)

    def residual(self, normal, change, axis):
        return normal[..., 2] * change / self.spacing + normal[..., axis]


class _Near(_AbstractView):
    """Through a pinhole: values are logarithms of depths along rays `(rows, columns, 3)`, `apart` at depth 1."""

    def __init__(self, ray: np.ndarray, apart: float):
        self.ends, self.apart = [(ray[a], ray[b]) for a, b in _ends(ray.shape[:2])], apart

    def equation(self, normal, axis):
        first, second = (-np.sum(normal * ray, axis=-1) for ray in self.ends[axis])
        seen = (first > 0) & (second > 0)
        return np.where(seen, (first + second) / 2, 0), np.log(np.where(seen, first, 1) / np.where(seen, second, 1))

    def residual(self, normal, change, axis):
        first, second = (np.sum(normal * ray, axis=-1) for ray in self.ends[axis])
        return (np.exp(change) * second - first) / self.apart


def _integrated(
    normals: np.ndarray, inside: np.ndarray, view: _AbstractView, jumps: bool
) -> Float[np.ndarray, "rows columns"]:
    """Values whose differences are what normals say of neighbours; in each piece up to a constant."""
    ends = _ends(inside.shape)
    pairs = [inside[a] & inside[b] for a, b in ends]
    shares = [(np.full(pair.shape, 0.5), np.full(pair.shape, 0.5)) for pair in pairs]  # of the first and second pixel
    values = np.zeros(inside.shape)
    for _ in range(ROUNDS if jumps else 0):
        values = solve(*_equations(normals, pairs, shares, view), values, ROUGHLY)
        before, shares = shares, []
        for axis, ((a, b), pair, change) in enumerate(zip(ends, pairs, differences(values), strict=True)):
            ahead, behind = np.zeros(inside.shape), np.zeros(inside.shape)  # 0 where there is no neighbour
            ahead[a] = np.where(pair, view.residual(normals[a], change, axis), 0) ** 2
            behind[b] = np.where(pair, view.residual(normals[b], change, axis), 0) ** 2
            believed = (1 + np.tanh(STEEPNESS / 2 * (behind - ahead))) / 2
            shares.append((believed[a], 1 - believed[b]))
        moved = max(np.max(np.abs(np.subtract(new, old)), initial=0) for new, old in zip(shares, before, strict=True))
        if moved < SETTLED:
            break
    return solve(*_equations(normals, pairs, shares, view), values, TOLERANCE)


def _equations(normals: np.ndarray, pairs: list, shares: list, view: _AbstractView) -> tuple[Edges, Edges]:
    """Weights, and weights times differences, of all pairs of neighbours."""
    weights, weighted = [], []
    ends = _ends(normals.shape[:2])
    for axis, ((a, b), pair, (of_a, of_b)) in enumerate(zip(ends, pairs, shares, strict=True)):
        weight, target = view.equation(of_a[..., None] * normals[a] + of_b[..., None] * normals[b], axis)
        weights.append(np.where(pair, weight, 0) ** 2)
        weighted.append(weights[-1] * target)
    return Edges(*weights), Edges(*weighted)


def _checked(normals: Any, mask: Any, positive: float, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals, 0 where there is none, and where there is one inside the mask."""
    vectors = np.asarray(normals, float)
    if vectors.ndim != 3 or vectors.shape[-1] != 3 or 0 in vectors.shape:
        raise ValueError(f"normals must have shape (rows, columns, 3), got {vectors.shape}")
    inside = np.ones(vectors.shape[:2], bool) if mask is None else np.asarray(mask, bool)
    if inside.shape != vectors.shape[:2]:
        raise ValueError(f"mask must have the shape of the normals, {vectors.shape[:2]}, got {inside.shape}")
    if not inside.any():
        raise ValueError("the mask is empty: there is no surface")
    if not (np.isfinite(positive) and positive > 0):
        raise ValueError(f"{name} must be a finite number above 0, got {positive}")
    length = np.linalg.norm(vectors, axis=-1)
    known = np.isfinite(length) & (length > 0)
    unit = np.where(known[..., None], vectors / np.where(known, length, 1)[..., None], 0)
    return unit, inside & known


def _seen(inside: np.ndarray, facing: np.ndarray, horizon: float) -> Bool[np.ndarray, "rows columns"]:
    if not 0 <= horizon < 1:
        raise ValueError(f"horizon must be in [0, 1), got {horizon}")
    seen = inside & (facing > horizon)
    if not seen.any():
        raise ValueError(f"no pixel has a normal that is turned to the viewer by more than the horizon, {horizon}")
    return seen


def _ends(shape: tuple[int, ...]) -> tuple[tuple[tuple[slice, slice], tuple[slice, slice]], ...]:
    """First and second pixel of each edge as `differences` has them: left and right, lower and upper."""
    every, most, rest = slice(None), slice(None, -1), slice(1, None)
    return ((every, most), (every, rest)), ((rest, every), (most, every))


def _means(values: np.ndarray, inside: np.ndarray) -> Float[np.ndarray, "rows columns"]:
    """The mean over the piece that each pixel belongs to."""
    from scipy import ndimage

    labels = np.zeros(inside.shape, int)
    ndimage.label(inside, output=labels)
    numbers, result = labels[inside], np.zeros(inside.shape)
    means = np.bincount(numbers, values[inside]) / np.maximum(np.bincount(numbers), 1)
    result[inside] = means[numbers]
    return result
