"""Where a gradient-based fit of a positive BRDF starts: a projection in the numbers of its link."""

from typing import TypeVar

import jax
import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.bases import AbstractPairBasis
from hshjax.brdfs._positive import AbstractPositiveBRDF, SquaredBRDF
from hshjax.fitting._project import project
from hshjax.samples import Samples

Positive = TypeVar("Positive", bound=AbstractPositiveBRDF)

FLOOR = 1e-2
"""Darkest value that a link is asked to stand for, over the mean of the samples: log ρ has no bottom."""

EVERYWHERE = 0.1
"""Weight of all directions alike, over the weight by what they mean for ρ."""


def positive_start(
    kind: type[Positive], basis: AbstractPairBasis, samples: Samples, *, ridge: float = 1e-6, squares: int = 1
) -> Positive:
    """`ExpBRDF`, `SoftplusBRDF` or `SquaredBRDF` near the samples, in closed form.

    The series is the projection of link⁻¹(ρ) under the weight (z_i z_o dρ/ds)², s the series: to first order the
    cosine-weighted least squares of ρ itself, averaged over the channels; with a tenth of a flat weight, so that no
    direction is left to itself. Values below 1 % of the mean count as that.

    - `samples`: see `project`. - `ridge`: of the spectral prior, for weights of mean 1.
    - `squares`: how many of a `SquaredBRDF`; those after the first start as small ripples, since at 0 none has a slope.

    Runs under jit and vmap. **Raises:** what `project` does; ValueError for `squares` of any other kind.
    """
    if squares < 1 or (squares > 1 and kind is not SquaredBRDF):
        raise ValueError(f"squares must be at least 1, and 1 for a {kind.__name__}, got {squares}")
    samples = samples.cleared()
    value, weight = samples.value, samples.weight
    used = jnp.sum(weight > 0).astype(value.dtype)
    mean = jnp.sum(jnp.maximum(value, 0)) / (used * samples.channels)
    mean = jnp.where(mean > 0, mean, 1)  # of black samples: something finite, from where a fit goes down
    series = kind.inverse_link(jnp.maximum(value, FLOOR * mean))
    _, slope = jax.jvp(kind.link, (series,), (jnp.ones_like(series),))
    importance = jnp.mean((samples.wi[:, 2:] * samples.wo[:, 2:] * slope) ** 2, axis=1)
    # Dark and grazing directions, which hardly count, still hold the series: a link makes much of what it does there.
    importance = weight * (importance / jnp.sum(weight * importance) + EVERYWHERE / jnp.sum(weight))
    linked = Samples(samples.wi, samples.wo, series, used * importance, None, samples.isotropic)
    found = project(basis, linked, norm="C", ridge=ridge, prior="spectral", reciprocity=False)
    coefficients = found.model.coefficients
    return kind(basis, _squares(coefficients, squares) if issubclass(kind, SquaredBRDF) else coefficients)


def _squares(first: Float[Array, "modes channels"], squares: int) -> Float[Array, "modes squares channels"]:
    """`first` and ripples of 1 % of its size, no two alike."""
    k, s = jnp.meshgrid(jnp.arange(first.shape[0]), jnp.arange(1, squares), indexing="ij")
    ripple = 0.01 * jnp.max(jnp.abs(first)) * jnp.cos((k * s + k).astype(first.dtype))[:, :, None]
    return jnp.concatenate([first[:, None], jnp.broadcast_to(ripple, (*ripple.shape[:2], first.shape[1]))], axis=1)
