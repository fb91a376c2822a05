"""A BRDF whose logarithm is a series: positive by construction, and compact over half-vector bases."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hshjax._fields import floating
from hshjax._typing import Array, Float, Int
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
    """ρ_k = exp(clip(Σ_t mixing_jk c_t B_a(wi, wo), low_k, high_k)) [sr^-1], a term t for a function a and a component
    j: positive everywhere, and reciprocal.

    - `basis`: of functions B_a, a reciprocal one.
    - `coefficients` `(terms,)`: the c_t; `terms` `(terms, 2)`: their (a, j). Without `terms`, coefficients are several
      arrays `(n_j,)`, of the first n_j functions for each component: shape takes more of them than colour.
    - `mixing` `(components, channels)`: what a component adds to ln ρ of each channel; None: `contrasts`.
    - `low`, `high` `(channels,)`: bounds of ln ρ, by default none. They hold the exponential where nothing was
      measured, and are no parameters: their derivative is 0.

    `terms` are integers: take derivatives by `eqx.filter_grad`, or those of `coefficients` by `jax.grad`.

    **Raises:** ValueError for a basis that is not reciprocal, terms that do not exist, or shapes that do not fit.
    """

    basis: AbstractPairBasis
    coefficients: Float[Array, " terms"]
    mixing: Float[Array, "components channels"]
    low: Float[Array, " channels"]
    high: Float[Array, " channels"]
    terms: Int[Array, "terms 2"]

    def __init__(
        self,
        basis: AbstractPairBasis,
        coefficients: Any,
        mixing: Any = None,
        low: Any = None,
        high: Any = None,
        *,
        terms: Any = None,
    ):
        if terms is None:
            coefficients, terms = _leading(coefficients)
        self.basis = basis
        self.coefficients = floating(coefficients)
        self.terms = jnp.asarray(terms, jnp.int32)
        self.mixing = floating(contrasts(int(np.max(terms, axis=0)[1]) + 1) if mixing is None else mixing)
        channels = self.mixing.shape[-1:]
        self.low = jnp.full(channels, -jnp.inf) if low is None else floating(low)
        self.high = jnp.full(channels, jnp.inf) if high is None else floating(high)

    def __check_init__(self):
        if not self.basis.reciprocal:
            raise ValueError(f"a LogLinearBRDF needs a reciprocal basis, got {self.basis}")
        if self.mixing.ndim != 2:
            raise ValueError(f"mixing must have shape (components, channels), got {self.mixing.shape}")
        count = self.coefficients.shape[:1]
        if self.coefficients.ndim != 1 or self.terms.shape != (*count, 2):
            got = f"{self.coefficients.shape} and {self.terms.shape}"
            raise ValueError(f"coefficients and terms must have shapes (terms,) and (terms, 2), got {got}")
        if not isinstance(self.terms, Tracer):
            self._check_terms(np.asarray(self.terms))
        for name in ("low", "high"):
            if getattr(self, name).shape != (self.channels,):
                raise ValueError(f"{name} must have shape ({self.channels},), got {getattr(self, name).shape}")

    def _check_terms(self, terms: np.ndarray) -> None:
        limits = self.basis.count, self.mixing.shape[0]
        if np.any((terms < 0) | (terms >= limits)):
            got = np.max(terms, axis=0).tolist()
            raise ValueError(f"terms are of {limits[0]} functions and {limits[1]} components, got numbers up to {got}")
        if len(np.unique(terms, axis=0)) < len(terms):
            raise ValueError("a function stands twice in the terms of a component")

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.mixing.shape[1]

    @property
    def count(self) -> int:
        """Number of coefficients, of all components."""
        return self.coefficients.size

    @property
    def matrix(self) -> Float[Array, "modes components"]:
        """The coefficient of every function in every component, 0 where there is no term."""
        zeros = jnp.zeros((self.basis.count, self.mixing.shape[0]), self.coefficients.dtype)
        return zeros.at[self.terms[:, 0], self.terms[:, 1]].set(self.coefficients)

    def formula(self, wi, wo):
        logarithm = matmul(self.basis.evaluate(self.matrix, wi, wo), self.mixing)
        low, high = jax.lax.stop_gradient((self.low, self.high))
        return jnp.exp(jnp.clip(logarithm, per_channel(low, wi), per_channel(high, wi)))


def leading_terms(sizes: Sequence[int]) -> np.ndarray:
    """The terms `(terms, 2)`, (function, component), of so many leading functions in each component. Host array."""
    return np.concatenate([np.stack([np.arange(n), np.full(n, j)], axis=1) for j, n in enumerate(sizes)])


def _leading(components: Any) -> tuple[Array, np.ndarray]:
    """Coefficients and terms of the first functions of each component."""
    parts = [floating(part) for part in components]
    if not parts or any(part.ndim != 1 for part in parts):
        shapes = [part.shape for part in parts]
        raise ValueError(f"without terms, coefficients are an array (n_j,) for each component, got shapes {shapes}")
    return jnp.concatenate(parts), leading_terms([part.size for part in parts])
