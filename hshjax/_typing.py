"""Array aliases of the whole library.

Shapes are jaxtyping strings. `Real` is a floating array of either precision: results follow the dtype of the
directions that come in, and nothing in the library touches jax's configuration.
"""

from collections.abc import Callable

from jaxtyping import Array, Bool, Float, Int

__all__ = ["Array", "Bool", "Directions", "Float", "Int", "PairFunction", "Real"]

Real = Float[Array, "..."]

Directions = Float[Array, "*batch 3"]
"""Unit vectors in the local frame (normal +z), pointing away from the surface."""

PairFunction = Callable[[Directions, Directions], Real]
"""Anything called as `rho(wi, wo)`: a BRDF [sr^-1, cosine not included], `(*batch, channels)`."""
