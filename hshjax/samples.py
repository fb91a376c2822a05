"""Samples: the one data type that readers make and fitters take."""

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array, Float, PairFunction
from hshjax.metrics import with_channels
from hshjax.quadrature import PairRule


class Samples(eqx.Module):
    """Values of a BRDF at pairs of directions.

    - `wi`, `wo`: unit directions `(n, 3)`, local frame (normal +z), both away from the surface.
    - `value`: the BRDF `(n, channels)` [sr^-1], cosine not included.
    - `weight`: `(n,)`, solid angle of a quadrature node [sr²] or a confidence; 0 masks a sample.
    - `degree`: set where the samples are the nodes of a rule that is exact to this degree (see `hshjax.quadrature`),
      None for scattered samples. `reweighted` clears it. What maps over the arrays (`jax.tree.map`) keeps it: make a
      part of a rule by `Samples.scattered`.
    - `isotropic`: whether only φ_i - φ_o matters; a rule with wi at φ = 0 is exact for such functions only.

    **Raises:** ValueError where the shapes disagree.
    """

    wi: Float[Array, "n 3"] = eqx.field(converter=jnp.asarray)
    wo: Float[Array, "n 3"] = eqx.field(converter=jnp.asarray)
    value: Float[Array, "n channels"] = eqx.field(converter=jnp.asarray)
    weight: Float[Array, " n"] = eqx.field(converter=jnp.asarray)
    degree: int | None = eqx.field(static=True, default=None)
    isotropic: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        n = self.wi.shape[0]
        expected = {"wi": (n, 3), "wo": (n, 3), "value": (n, *self.value.shape[1:2]), "weight": (n,)}
        for name, shape in expected.items():
            got = getattr(self, name).shape
            if got != shape or (name == "value" and len(got) != 2):
                raise ValueError(
                    "Samples needs wi (n, 3), wo (n, 3), value (n, channels), weight (n,); "
                    f"got n = {n} from wi and {name} of shape {got}"
                )

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.wi.shape[0]

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.value.shape[1]

    @classmethod
    def from_function(cls, brdf: PairFunction, rule: PairRule) -> "Samples":
        """`brdf(wi, wo)` at the nodes of a pair rule, weighted by solid angle. A result `(n,)` becomes one channel."""
        value = with_channels(jnp.asarray(brdf(rule.wi, rule.wo)), 1)
        return cls(rule.wi, rule.wo, value, rule.weight, rule.degree, rule.isotropic)

    @classmethod
    def scattered(
        cls,
        wi: Float[Array, "n 3"],
        wo: Float[Array, "n 3"],
        value: Float[Array, "n channels"],
        weight: Float[Array, " n"] | None = None,
        *,
        isotropic: bool = False,
    ) -> "Samples":
        """Samples at arbitrary pairs; every weight 1 unless given.

        `isotropic` says that only φ_i - φ_o matters: reciprocity is then compared up to a common rotation.
        """
        wi = jnp.asarray(wi)
        weight = jnp.ones(wi.shape[0], wi.dtype) if weight is None else weight
        return cls(wi, wo, value, weight, None, isotropic)

    def cleared(self) -> "Samples":
        """The same samples, with what is masked replaced: black, in the direction of the normal, at weight exactly 0.

        What is masked may be NaN in its values and directions; 0 times NaN is NaN, and so are its derivatives. They are
        no longer the nodes of an exact rule.
        """
        used = (self.weight > 0)[:, None]
        pole = jnp.zeros_like(self.wi).at[:, 2].set(1)
        wi, wo = jnp.where(used, self.wi, pole), jnp.where(used, self.wo, pole)
        value, weight = jnp.where(used, self.value, 0), jnp.where(used[:, 0], self.weight, 0)
        return Samples(wi, wo, value, weight, None, self.isotropic)

    def reweighted(self, weight: Float[Array, " n"]) -> "Samples":
        """The same samples under other weights: no longer the nodes of an exact rule."""
        return Samples(self.wi, self.wo, self.value, weight, None, self.isotropic)
