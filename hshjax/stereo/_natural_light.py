"""Natural illumination from photographs of a known shape and material: linear, and honest about what it cannot tell."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.brdfs import AbstractBRDF, Lambert
from hshjax.geometry import normalized
from hshjax.lighting import HarmonicLight
from hshjax.reflectance import reflect
from hshjax.stereo._known import check_brdf, known_albedo

ROUNDS = 20
"""Of telling what is determined, which depends on the light that is found."""

ALL_AROUND = np.array([[0, 0, 1], [0.8, 0, 0.6], [-0.48, 0.64, -0.6]])
"""Lights in which a BRDF is looked at before it is used: from the camera, from aside, from behind."""


class NaturalLight(eqx.Module):
    """A light from all around, as a photograph of a known object tells it.

    - `light`: the series of least norm among those that fit as well; what is not determined is 0 in it.
    - `deviation` `(modes, channels)`: standard deviation of what is determined of each coefficient, by `noise`.
    - `seen` `(modes, channels)`: the share of each coefficient that is determined, 0 to 1: one of 0.5 is known in a sum
      with others alone.
    - `determined` `(channels,)`: how many combinations of coefficients are, of all `modes`. - `condition`
      `(channels,)`: largest over least singular value of all, infinite where the least is rounding.
    - `noise` `(channels,)`: standard deviation of what is not explained [radiance].
    """

    light: HarmonicLight
    deviation: Float[np.ndarray, "modes channels"]
    seen: Float[np.ndarray, "modes channels"]
    determined: np.ndarray
    condition: Float[np.ndarray, " channels"]
    noise: Float[np.ndarray, " channels"]


def light_from_shape(
    values: Float[np.ndarray | Array, "pixels channels"],
    normals: Float[np.ndarray | Array, "pixels 3"],
    *,
    brdf: AbstractBRDF | None = None,
    albedo: Any = None,
    order: int = 2,
    tolerance: float = 0.1,
) -> NaturalLight:
    """The light that an object of known shape and reflectance was photographed in, a series of some order.

    - `values`: radiance; pixels with a NaN are not looked at. - `normals`: unit, in the world of a camera far away on
      +z. - `brdf`: isotropic; None: `Lambert(1)`. - `albedo`: factors, `(pixels,)` or `(pixels, channels)`; None: 1.
    - `order`: of the series. What light has beyond it is taken for what it has below: an order higher than material and
      noise let through does no harm, for what is not determined is left out.
    - `tolerance`: a combination of coefficients is determined where its standard deviation is below this share of the
      norm of the light that is found.

    Least squares by singular values. Radiance is linear in light; Eq. 1 for each harmonic is a column, by `reflect`. Of
    Lambert's law order 2 holds 98 % of all there is, and odd orders above 1 leave no trace.

    **Raises:** ValueError for shapes that do not fit, a BRDF that is not isotropic, reflects nothing or has other
    channels, a negative order, a tolerance that is not above 0, and fewer known pixels than coefficients.
    """
    image, points = np.asarray(values, float), np.asarray(normals, float)
    if image.ndim != 2 or points.shape != (len(image), 3):
        raise ValueError(
            f"values must be (pixels, channels) and normals (pixels, 3), got {image.shape} and {points.shape}"
        )
    if order < 0 or not tolerance > 0:
        raise ValueError(f"order must be at least 0 and tolerance above 0, got {order} and {tolerance}")
    factors = known_albedo(albedo, *image.shape)
    known = np.isfinite(image).all(axis=1) & np.isfinite(points).all(axis=1)
    modes = (order + 1) ** 2
    if known.sum() <= modes:
        raise ValueError(f"{modes} coefficients need more pixels than that, of which both are known; got {known.sum()}")
    dtype = jnp.result_type(float)
    brdf = Lambert(jnp.ones(())) if brdf is None else brdf
    check_brdf(brdf, ALL_AROUND, image.shape[1])
    columns = light_columns(brdf, order, jnp.asarray(points[known], dtype))
    design = np.asarray(columns, float) * factors[known][:, None]
    found = [_channel(design[..., c], image[known, c], tolerance) for c in range(image.shape[1])]
    value, deviation, seen, count, condition, noise = (np.stack(part, axis=-1) for part in zip(*found, strict=True))
    return NaturalLight(HarmonicLight(jnp.asarray(value, dtype)), deviation, seen, count, condition, noise)


def light_columns(
    brdf: AbstractBRDF, order: int, normals: Float[Array, "pixels 3"]
) -> Float[Array, "pixels modes channels"]:
    """Radiance towards +z under each harmonic by itself."""
    return _columns(brdf, (order + 1) ** 2, normalized(normals))


@eqx.filter_jit
def _columns(brdf, modes, normals):
    view = jnp.asarray([0, 0, 1], normals.dtype)

    def under(mode):
        return reflect(brdf, HarmonicLight(mode[:, None]), normals, view)

    return jnp.moveaxis(jax.lax.map(under, jnp.eye(modes, dtype=normals.dtype)), 0, 1)


def _channel(design: np.ndarray, values: np.ndarray, tolerance: float) -> tuple[Any, ...]:
    """Of one channel: coefficients, deviations, shares that are seen, how many are, condition, noise."""
    left, singular, right = np.linalg.svd(design, full_matrices=False)
    moment = left.T @ values
    rounding = singular > singular[0] * len(singular) * np.finfo(np.float32).eps
    kept, noise = rounding, 0.0
    for _ in range(ROUNDS):
        found = np.where(kept, moment / np.where(kept, singular, 1), 0)
        residual = values - left @ (singular * found)
        noise = np.sqrt(np.sum(residual**2) / (len(values) - kept.sum()))
        before, kept = kept, rounding & (noise <= tolerance * np.linalg.norm(found) * singular)
        if not kept.any():
            kept = np.arange(len(singular)) == 0
        if np.array_equal(before, kept):
            break
        kept = kept & before  # from all downwards: it ends
    found = np.where(kept, moment / np.where(kept, singular, 1), 0)
    rows = right[kept]
    deviation = noise * np.sqrt(np.sum((rows / singular[kept, None]) ** 2, axis=0))
    condition = singular[0] / singular[-1] if rounding[-1] else np.inf
    return right.T @ found, deviation, np.sum(rows**2, axis=0), kept.sum(), np.asarray(condition), noise
