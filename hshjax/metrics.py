"""Figures that a report states about a BRDF: albedo, negative energy, reciprocity.

They take any function of a pair of directions, `rho(wi, wo)` [sr^-1] without cosine, `(*batch, channels)`; only
`reciprocity_error` also takes samples. Integrals run over a rule of `hshjax.quadrature`, the default one of a stated
degree: enough for diffuse surfaces and broad lobes; raise it for sharp ones until the figure stands still. Nodes of
weight 0 do not count. Beside values and nodes, memory holds some blocks.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._special import blockwise
from hshjax._typing import Array, Float, Int, PairFunction, Real
from hshjax.geometry import as_directions
from hshjax.quadrature import PairRule, Rule, hemisphere_rule, pair_rule

_CHUNK = 2**18
_BLOCK = 2**12
_DEGREE = 64
_PAIR_DEGREE = 16
_SAME = 1e-6
"""Directions are the same when their coordinates agree to this: above float32 rounding, below any instrument's step."""


class Negativity(NamedTuple):
    """`share`: negative part of the cosine-weighted energy, in [0, 1]; `minimum`: the smallest value met [sr^-1]."""

    share: Float[Array, ""]
    minimum: Float[Array, ""]


class ReciprocityError(NamedTuple):
    """How far ρ(wi, wo) is from ρ(wo, wi), all channels together, under the weight z_i z_o.

    - `relative`: sqrt(∫∫ (ρ(i,o) - ρ(o,i))² z_i z_o dω_i dω_o / ∫∫ ρ² z_i z_o dω_i dω_o).
    - `maximum`: the largest z_i z_o |ρ(i,o) - ρ(o,i)| [sr^-1].
    - `pairs`: pairs that entered: nodes with a weight, or samples that another one at the swapped pair was found for.
    """

    relative: Float[Array, ""] | float
    maximum: Float[Array, ""] | float
    pairs: Int[Array, ""] | int


@runtime_checkable
class SampleLike(Protocol):
    """What `reciprocity_error` reads of `hshjax.Samples`, which lives a floor above: see there for shapes."""

    # Any, not Array: a type checker sees a dataclass field with a converter as the converter's descriptor.
    @property
    def wi(self) -> Any: ...
    @property
    def wo(self) -> Any: ...
    @property
    def value(self) -> Any: ...
    @property
    def weight(self) -> Any: ...
    @property
    def isotropic(self) -> bool: ...


def albedo(brdf: PairFunction, wo: Float[Array, "... 3"], rule: Rule | None = None) -> Real:
    """Directional albedo ∫ ρ(wi, wo) z_i dω_i at each `wo` `(*batch, 3)`: `(*batch, channels)`, dimensionless.

    For a reciprocal BRDF, the share of light from `wo` that is reflected at all. Default rule: degree 64.
    """
    (wo,) = as_directions(wo)
    rule = hemisphere_rule(_DEGREE, dtype=wo.dtype) if rule is None else rule
    return _albedo(brdf, wo, rule)


@eqx.filter_jit
def _albedo(brdf: PairFunction, wo: Float[Array, "... 3"], rule: Rule) -> Real:
    wi = rule.w.astype(wo.dtype)
    foreshortened = (rule.weight * rule.w[:, 2]).astype(wo.dtype)[:, None]

    def one(direction):
        return jnp.sum(with_channels(brdf(wi, jnp.broadcast_to(direction, wi.shape)), 1) * foreshortened, axis=0)

    flat = jax.lax.map(one, wo.reshape(-1, 3), batch_size=max(1, _CHUNK // wi.shape[0]))
    return flat.reshape(*wo.shape[:-1], flat.shape[-1])


def hemispherical_albedo(brdf: PairFunction, rule: Rule | None = None) -> Float[Array, " channels"]:
    """White-sky albedo (1/π) ∫∫ ρ z_i z_o dω_i dω_o per channel, `rule` in both directions. Default rule: degree 64."""
    rule = hemisphere_rule(_DEGREE) if rule is None else rule
    directional = albedo(brdf, rule.w, rule)
    return jnp.sum(directional * (rule.weight * rule.w[:, 2])[:, None], axis=0) / jnp.pi


def negativity(brdf: PairFunction, rule: PairRule | None = None) -> Negativity:
    """Share of negative energy, ∫∫ max(-ρ, 0) z_i z_o / ∫∫ |ρ| z_i z_o (0 for ρ = 0), and the minimum over the nodes.

    All channels together. Default rule: `pair_rule(16)`; give an `isotropic_pair_rule` of higher degree where it fits.
    """
    return _negativity(brdf, pair_rule(_PAIR_DEGREE) if rule is None else rule)


@eqx.filter_jit
def _negativity(brdf: PairFunction, rule: PairRule) -> Negativity:
    seen = (rule.weight > 0)[:, None]
    value = _values(brdf, rule.wi, rule.wo)
    energy = jnp.where(seen, (rule.weight * rule.wi[:, 2] * rule.wo[:, 2])[:, None] * value, 0)
    negative, total = jnp.sum(jnp.maximum(-energy, 0)), jnp.sum(jnp.abs(energy))
    some = total > 0
    return Negativity(
        jnp.where(some, negative / jnp.where(some, total, 1), 0), jnp.min(value, where=seen, initial=jnp.inf)
    )


def reciprocity_error(subject: PairFunction | SampleLike, rule: PairRule | None = None) -> ReciprocityError:
    """`ReciprocityError` of a BRDF on a pair rule (default `pair_rule(16)`), or of `Samples` where they allow it.

    Samples: each is compared with the nearest sample at the swapped pair, to 1e-6 in every coordinate, after a common
    rotation about the normal where `isotropic` says that only φ_i - φ_o matters. A pair enters with the geometric mean
    of its two weights, so weight 0 masks. Without any such pair `relative` and `maximum` are NaN. On the host, not
    differentiable; a million samples take seconds.

    **Raises:** ValueError for a rule given along with samples.
    """
    if not callable(subject):
        if rule is not None:
            raise ValueError(
                f"samples bring their own pairs: rule must be None, got a PairRule of degree {rule.degree}"
            )
        return _samples_reciprocity_error(subject)
    relative, maximum, pairs = _reciprocity(subject, pair_rule(_PAIR_DEGREE) if rule is None else rule)
    return ReciprocityError(relative, maximum, pairs)


@eqx.filter_jit
def _reciprocity(subject: PairFunction, rule: PairRule) -> tuple[Array, Array, Array]:
    seen = (rule.weight > 0)[:, None]
    value, swapped = (jnp.where(seen, _values(subject, *pair), 0) for pair in ((rule.wi, rule.wo), (rule.wo, rule.wi)))
    cosines = (rule.wi[:, 2] * rule.wo[:, 2])[:, None]
    mass, difference = rule.weight[:, None] * cosines, value - swapped
    square = jnp.sum(mass * difference**2)
    # Both orders in the denominator: a rule with wi at φ = 0 need not be symmetric node by node.
    power = jnp.sum(mass * (value**2 + swapped**2)) / 2
    some = power > 0
    relative = jnp.where(some, jnp.sqrt(square / jnp.where(some, power, 1)), 0)
    return relative, jnp.max(cosines * jnp.abs(difference), initial=0), jnp.sum(seen)


def _values(brdf: PairFunction, wi: Float[Array, "n 3"], wo: Float[Array, "n 3"]) -> Float[Array, "n channels"]:
    """The BRDF at many pairs, block by block: beside them, memory holds what one block needs."""
    return blockwise(lambda i, o: with_channels(brdf(i, o), 1), _BLOCK, wi, wo)


def with_channels(value: Real, batch: int) -> Real:
    """Values with `batch` leading axes and an axis of channels; a function that returns none has one channel."""
    return value[..., None] if value.ndim == batch else value


def _samples_reciprocity_error(samples: SampleLike) -> ReciprocityError:
    from scipy.spatial import KDTree  # here, to keep `import hshjax` cheap

    weight = np.asarray(samples.weight, np.float64)
    used = weight > 0
    weight = weight[used]
    wi, wo, value = (np.asarray(a, np.float64)[used] for a in (samples.wi, samples.wo, samples.value))
    here, swapped = _pair_key(wi, wo, samples.isotropic), _pair_key(wo, wi, samples.isotropic)
    # A nearest neighbour, not a rounded key: a coordinate on the edge between two cells would lose its partner.
    distance, partner = KDTree(here).query(swapped, p=np.inf, distance_upper_bound=_SAME)
    found = np.flatnonzero(np.isfinite(distance))
    partner = np.asarray(partner)[found]
    # A retro-reflection is its own swap and says nothing; it counts in the norm, as on a rule, but not as a pair.
    pairs = int(np.count_nonzero(partner != found))
    if pairs == 0:
        return ReciprocityError(float("nan"), float("nan"), 0)
    cosines = (wi[found, 2] * wo[found, 2])[:, None]
    mass = np.sqrt(weight[found] * weight[partner])[:, None] * cosines
    a, b = value[found], value[partner]
    power = np.sum(mass * (a**2 + b**2)) / 2
    relative = np.sqrt(np.sum(mass * (a - b) ** 2) / power) if power > 0 else 0.0
    return ReciprocityError(float(relative), float(np.max(cosines * np.abs(a - b))), pairs)


def _pair_key(wi: np.ndarray, wo: np.ndarray, isotropic: bool) -> np.ndarray:
    """Coordinates `(n, 6)` of a pair; in the isotropic case such that a common rotation about z leaves them alone."""
    if not isotropic:
        return np.concatenate([wi, wo], axis=1)
    rim_i, rim_o = np.hypot(wi[:, 0], wi[:, 1]), np.hypot(wo[:, 0], wo[:, 1])
    # min(rim) (cos Δφ, sin Δφ): at the pole, where Δφ has no meaning, both are 0, and rounding there stays small.
    longest = np.maximum(rim_i, rim_o)
    longest = np.where(longest > 0, longest, 1)
    along = (wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]) / longest
    across = (wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0]) / longest
    return np.stack([wi[:, 2], rim_i, wo[:, 2], rim_o, along, across], axis=1)
