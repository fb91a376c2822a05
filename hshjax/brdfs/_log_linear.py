"""A BRDF whose logarithm is a series: positive by construction, and compact over half-vector bases."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._fields import floating
from hshjax._typing import Array, Float
from hshjax.bases import AbstractPairBasis
from hshjax.bases._base import matmul
from hshjax.brdfs._base import AbstractBRDF, per_channel


def contrasts(channels: int) -> np.ndarray:
    """What components of a `LogLinearBRDF` add to its channels by default, `(channels, channels)`. Host array.

    All channels alike first; then, orthonormal, the first against the second, both against the third, and so on
    (Helmert's contrasts): for red, green and blue the shape of the BRDF and two chromas.
    """
    if channels < 1:
        raise ValueError(f"a BRDF has at least one channel, got {channels}")
    rows = [np.ones(channels)]
    for k in range(1, channels):
        row = np.r_[np.ones(k), -k, np.zeros(channels - k - 1)]
        rows.append(row / np.linalg.norm(row))
    return np.stack(rows)


class LogLinearBRDF(AbstractBRDF):
    """ρ_k = exp(clip(Σ_j mixing_jk Σ_a c_ja B_a(wi, wo), low_k, high_k)) [sr^-1]: positive everywhere, and reciprocal.

    - `basis`: of functions B_a, a reciprocal one. - `coefficients`: an array `(n_j,)` for each component, of the first
      n_j functions: shape takes more of them than colour.
    - `mixing` `(components, channels)`: what a component adds to ln ρ of each channel; None: `contrasts`.
    - `low`, `high` `(channels,)`: bounds of ln ρ, by default none. They hold the exponential where nothing was
      measured, and are no parameters: their derivative is 0.

    **Raises:** ValueError for a basis that is not reciprocal, or shapes that do not fit.
    """

    basis: AbstractPairBasis
    coefficients: tuple[Float[Array, " modes"], ...]
    mixing: Float[Array, "components channels"]
    low: Float[Array, " channels"]
    high: Float[Array, " channels"]

    def __init__(
        self,
        basis: AbstractPairBasis,
        coefficients: Sequence[Any],
        mixing: Any = None,
        low: Any = None,
        high: Any = None,
    ):
        self.basis = basis
        self.coefficients = tuple(floating(part) for part in coefficients)
        self.mixing = floating(contrasts(len(self.coefficients)) if mixing is None else mixing)
        channels = self.mixing.shape[-1:]
        self.low = jnp.full(channels, -jnp.inf) if low is None else floating(low)
        self.high = jnp.full(channels, jnp.inf) if high is None else floating(high)

    def __check_init__(self):
        if not self.basis.reciprocal:
            raise ValueError(f"a LogLinearBRDF needs a reciprocal basis, got {self.basis}")
        for part in self.coefficients:
            if part.ndim != 1 or part.size > self.basis.count:
                raise ValueError(f"coefficients must have shapes (at most {self.basis.count},), got {part.shape}")
        if self.mixing.ndim != 2 or self.mixing.shape[0] != len(self.coefficients):
            expected = f"({len(self.coefficients)}, channels)"
            raise ValueError(f"mixing must have shape {expected}, a row for each component, got {self.mixing.shape}")
        for name in ("low", "high"):
            if getattr(self, name).shape != (self.channels,):
                raise ValueError(f"{name} must have shape ({self.channels},), got {getattr(self, name).shape}")

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.mixing.shape[1]

    @property
    def count(self) -> int:
        """Number of coefficients, of all components."""
        return sum(part.size for part in self.coefficients)

    def formula(self, wi, wo):
        size = self.basis.count
        columns = jnp.stack([jnp.pad(part, (0, size - part.size)) for part in self.coefficients], axis=1)
        logarithm = matmul(self.basis.evaluate(columns, wi, wo), self.mixing)
        low, high = jax.lax.stop_gradient((self.low, self.high))
        return jnp.exp(jnp.clip(logarithm, per_channel(low, wi), per_channel(high, wi)))
