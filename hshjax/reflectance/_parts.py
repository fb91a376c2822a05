"""Lights and BRDFs as the sums that they are."""

import jax.numpy as jnp

from hshjax._typing import PairFunction
from hshjax.bases import HSH, AbstractProductBasis, IsotropicBasis
from hshjax.brdfs import Lambert, LinearBRDF
from hshjax.brdfs._base import ScaledBRDF, SumBRDF
from hshjax.geometry import common_dtype
from hshjax.lighting import AbstractLighting, SumLighting


def lights_of(lighting: AbstractLighting) -> list[AbstractLighting]:
    """The lights that make up a sum."""
    if isinstance(lighting, SumLighting):
        return lights_of(lighting.a) + lights_of(lighting.b)
    return [lighting]


def brdfs_of(brdf: PairFunction) -> list:
    """The BRDFs that make up a sum; a multiple of a sum is a sum of multiples."""
    if isinstance(brdf, SumBRDF):
        return brdfs_of(brdf.a) + brdfs_of(brdf.b)
    if isinstance(brdf, ScaledBRDF) and isinstance(brdf.brdf, SumBRDF | ScaledBRDF):
        return [ScaledBRDF(part, brdf.scale) for part in brdfs_of(brdf.brdf)]
    return [brdf]


def products(series: LinearBRDF) -> AbstractProductBasis:
    """The basis of what `as_series` has found."""
    assert isinstance(series.basis, AbstractProductBasis)
    return series.basis


def as_series(brdf: PairFunction) -> LinearBRDF | None:
    """The same BRDF as a series in a pair basis, or None if it is not one in products of two directions."""
    if isinstance(brdf, LinearBRDF):
        return brdf if isinstance(brdf.basis, AbstractProductBasis) else None
    if isinstance(brdf, Lambert):
        # Order 0 is the constant 1 / 2π.
        return LinearBRDF(IsotropicBasis(HSH(0)), 2 * jnp.reshape(brdf.albedo, (1, -1)))
    if isinstance(brdf, ScaledBRDF):
        series = as_series(brdf.brdf)
        if series is not None:
            coefficients, scale = common_dtype(series.coefficients, jnp.reshape(brdf.scale, (1, -1)))
            return LinearBRDF(series.basis, coefficients * scale, series.target)
    return None
