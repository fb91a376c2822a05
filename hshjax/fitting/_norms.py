"""In which norm a fit is best, and in which it is judged.

Cook-Torrance with V-cavity shadowing and Oren-Nayar are not square integrable for dω_i dω_o: "the L2 error of a fit"
means nothing before its weight is named. Every result of this library carries the name.
"""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import jax.numpy as jnp

from hshjax._typing import Array, Float
from hshjax.brdfs._linear import EXPONENTS, Target, cosine_power

NormName = Literal["A", "B", "C", "D", "E"]


@dataclass(frozen=True)
class Norm:
    """Fit f = (z_i z_o)^p ρ (p from `target`) under the weight (z_i z_o)^`fit`; judge ρ under (z_i z_o)^`judge`.

    Weights are relative to dω_i dω_o; both count only pairs with θ_i, θ_o <= `max_theta` [radians].
    """

    name: NormName
    meaning: str
    target: Target
    fit: float
    judge: float
    max_theta: float = math.pi / 2

    @property
    def exponent(self) -> float:
        """p of the series' target."""
        return EXPONENTS[self.target]

    @property
    def judge_series(self) -> float:
        """The judge's exponent for errors of the series instead of ρ."""
        return self.judge - 2 * self.exponent

    @property
    def orthonormal(self) -> bool:
        """Whether a basis is orthonormal under the fit's weight, so that its coefficients are inner products."""
        return self.fit == 0 and self.max_theta == math.pi / 2

    def fit_weight(self, wi: Float[Array, "n 3"], wo: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Weight of |f - Σ c B|²."""
        return cosine_power(wi, wo, self.fit) * self._inside(wi, wo)

    def judge_weight(self, wi: Float[Array, "n 3"], wo: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Weight of |ρ - ρ̂|²."""
        return cosine_power(wi, wo, self.judge) * self._inside(wi, wo)

    def _inside(self, wi, wo):
        lowest = jnp.minimum(wi[..., 2], wo[..., 2])
        return (lowest >= math.cos(self.max_theta) - 1e-15).astype(wi.dtype)


NORMS: dict[str, Norm] = {
    norm.name: norm
    for norm in (
        Norm("A", "least squares under cos θi cos θo", "brdf", fit=1.0, judge=1.0),
        Norm("B", "projection of sqrt(cos θi cos θo) ρ", "half_foreshortened", fit=0.0, judge=1.0),
        Norm("C", "projection of ρ, judged under cos θi cos θo", "brdf", fit=0.0, judge=1.0),
        Norm("D", "projection of cos θi cos θo ρ", "foreshortened", fit=0.0, judge=2.0),
        Norm(
            "E", "least squares under cos θi cos θo up to 80°", "brdf", fit=1.0, judge=1.0, max_theta=math.radians(80)
        ),
    )
}
"""The norms A-E by name. D is the default of `project`: z_i z_o ρ is bounded, and z_i ρ is what Eq. 1 integrates."""


def named_norm(name: str) -> Norm:
    """The norm of that name, or a ValueError that lists the names."""
    if name not in NORMS:
        choices = "; ".join(f"{norm.name}: {norm.meaning}" for norm in NORMS.values())
        raise ValueError(f"norm must be one of {', '.join(get_args(NormName))} ({choices}), got {name!r}")
    return NORMS[name]
