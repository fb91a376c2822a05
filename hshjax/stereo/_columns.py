"""What a learned BRDF is made of: the columns of a linear combination, and the models that it starts from."""

from collections.abc import Sequence
from functools import reduce
from operator import add

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Bool, Float
from hshjax.bases import HSH, AbstractPairBasis, IsotropicBasis
from hshjax.brdfs import GGX, AbstractBRDF, Lambert, LinearBRDF

Column = AbstractPairBasis | AbstractBRDF


def default_columns() -> tuple[Column, ...]:
    """Ten broad reciprocal functions and three highlights."""
    return (IsotropicBasis(HSH(2)), *(_highlight(roughness) for roughness in (0.1, 0.2, 0.4)))


def _highlight(roughness: float) -> GGX:
    return GGX(jnp.ones(()), jnp.asarray(roughness))


def column_brdfs(columns: Sequence[Column]) -> tuple[AbstractBRDF, ...]:
    """A BRDF for each entry, whose channels are the columns: all functions of a basis, the one channel of a BRDF.

    **Raises:** ValueError for what is neither, is not isotropic or reciprocal, or has several channels.
    """
    if not columns:
        raise ValueError("a BRDF is made of at least one column, got none")
    found = []
    for column in columns:
        if isinstance(column, AbstractPairBasis):
            if not (column.reciprocal and column.isotropic):
                raise ValueError(f"bases of a learned BRDF are reciprocal and isotropic, got {column}")
            found.append(LinearBRDF(column, jnp.eye(column.count)))
        elif isinstance(column, AbstractBRDF):
            found.append(column)
        else:
            raise ValueError(f"columns are bases of pairs or BRDFs, got {column!r}")
    return tuple(found)


def positive_columns(columns: Sequence[Column]) -> Bool[np.ndarray, " columns"]:
    """Which columns have no negative coefficient: BRDFs. Functions of a basis have either sign."""
    each = [np.full(c.count, False) if isinstance(c, AbstractPairBasis) else np.array([True]) for c in columns]
    return np.concatenate(each)


def combined(columns: Sequence[Column], coefficients: Float[Array, "materials columns"]) -> AbstractBRDF:
    """The BRDF whose channels are the materials: Σ over columns, coefficient times column [sr^-1]."""
    parts, begin = [], 0
    for column in columns:
        count = column.count if isinstance(column, AbstractPairBasis) else 1
        block = coefficients[:, begin : begin + count]
        begin += count
        if isinstance(column, AbstractPairBasis):
            parts.append(LinearBRDF(column, block.T))
        else:
            parts.append(column * block[:, 0])
    return reduce(add, parts)


def first_guess(materials: int) -> tuple[AbstractBRDF, ...]:
    """Materials to begin with: Lambert's, and highlights ever narrower; of one material, their mixture."""
    lambert = Lambert(jnp.ones(()))
    if materials == 1:
        return (0.8 * lambert + 0.2 * _highlight(0.25),)
    roughness = [0.25] if materials == 2 else np.geomspace(0.4, 0.1, materials - 1)
    return (lambert, *(_highlight(float(alpha)) for alpha in roughness))
