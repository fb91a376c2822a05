"""Quadratic priors on coefficients: the Γ of the closed form."""

import math
from collections.abc import Callable
from typing import Literal

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float
from hshjax.bases import AbstractPairBasis

Prior = Literal["spectral"] | Float[Array, " modes"] | np.ndarray


def penalty(basis: AbstractPairBasis, ridge: float, prior: Prior | None) -> Float[Array, " modes"] | None:
    """The diagonal of Γ = ridge x prior, or None for no penalty at all; see `penalty_of`.

    **Raises:** TypeError for what is no basis of pairs, which every linear fit asks for its penalty first.
    """
    check_kind(basis, AbstractPairBasis, "a basis of pairs of directions, such as IsotropicBasis(HSH(8))")
    return penalty_of(basis.count, basis.degrees, ridge, prior)


def check_kind(basis: object, kind: type, words: str) -> None:
    """TypeError for a basis of another kind than a fit takes."""
    if not isinstance(basis, kind):
        raise TypeError(f"basis must be {words}, got {basis}")


def penalty_of(
    count: int, degrees: Callable[[], np.ndarray], ridge: float, prior: Prior | None
) -> Float[Array, " modes"] | None:
    """The diagonal of Γ = ridge x prior for `count` modes, or None for no penalty at all.

    `degrees()`: the orders of every mode, one or two directions each. None is 1 for every mode; "spectral" is
    (n(n+1) + p(p+1))², the squared Laplacian of a function of order n in one direction and p in the other, if there is
    one: 0 for the constant, growing with the fourth power of the order.

    **Raises:** ValueError for a ridge that is negative or not finite, a prior of the wrong shape or sign or not finite,
    or a prior that a ridge of 0 mutes.
    """
    if not 0 <= ridge < math.inf:
        raise ValueError(f"ridge must be finite and >= 0, got {ridge}")
    if prior is None:
        diagonal = np.ones(count)
    elif isinstance(prior, str):
        if prior != "spectral":
            raise ValueError(f'prior must be None, "spectral" or an array (modes,), got {prior!r}')
        orders = np.asarray(degrees(), np.float64)
        diagonal = np.sum(orders * (orders + 1), axis=1) ** 2
    else:
        diagonal = np.asarray(prior, np.float64)
        if diagonal.shape != (count,):
            raise ValueError(f"prior must hold one number for each of the {count} modes, got shape {diagonal.shape}")
        bad = ~((diagonal >= 0) & np.isfinite(diagonal))
        if bad.any():
            raise ValueError(f"prior must be finite and >= 0, got {diagonal[np.argmax(bad)]} for mode {np.argmax(bad)}")
    if ridge == 0:
        if prior is not None:
            raise ValueError("a prior acts through its ridge: give ridge > 0 with it")
        return None
    return jnp.asarray(ridge * diagonal)
