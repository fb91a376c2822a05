"""How far two materials are from one another, in the figures that papers state."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array, Float, PairFunction
from hshjax.brdfs._isotropy import is_isotropic
from hshjax.brdfs._known import known
from hshjax.fitting._misfit import ratio
from hshjax.fitting._norms import NORMS
from hshjax.geometry import direction
from hshjax.metrics import albedo, with_channels
from hshjax.quadrature import ANISOTROPIC_DEGREE, isotropic_pair_rule, pair_rule
from hshjax.samples import Samples

ANGLES = (0.0, 45.0, 75.0)
"""Of incidence, at which albedos are compared [degrees]."""

JUDGES = ("A", "D", "E")
"""Norms that differ in how they judge."""

LOG_LIMIT = 80.0
"""Angle to the normal up to which the log error looks [degrees]: nearer the horizon measurements err most."""


class Comparison(NamedTuple):
    """A candidate beside a reference.

    - `errors`: relative errors `(channels,)` by the name of the norm: A (B and C judge alike), D and E.
    - `log_error` `(channels,)`: mean |Δ ln(1 + ρ z)| over samples and their two cosines z, weighted by the samples' own
      weights, of pairs up to 80 degrees; ρ below 0 counts as 0.
    - `largest` `(channels,)`: the largest |Δρ| z_i z_o [sr^-1] at a sample.
    - `reference_albedo`, `albedo` `(3, channels)`: directional ones at 0, 45, 75 degrees; None of samples.
    - `samples`: how many were compared.
    """

    errors: dict[str, Float[Array, " channels"]]
    log_error: Float[Array, " channels"]
    largest: Float[Array, " channels"]
    reference_albedo: Float[Array, "angles channels"] | None
    albedo: Float[Array, "angles channels"] | None
    samples: int


def compare(reference: Samples | PairFunction, candidate: Samples | PairFunction, *, degree: int = 64) -> Comparison:
    """`candidate` against `reference`, on the samples of whichever has some, else on an isotropic rule of `degree`;
    on a `pair_rule` of degree 16 where one of them is anisotropic.

    Errors are relative to the reference. Samples of weight 0 do not count.

    **Raises:** ValueError for samples on both sides, different channels, or no sample that counts.
    """
    if isinstance(reference, Samples) and isinstance(candidate, Samples):
        raise ValueError("both sides are scattered samples: one of the two must be a table or a model; fit one of them")
    # Where the candidate is the measured one, the reference's values at its directions are what errors relate to.
    if isinstance(reference, Samples):
        rule = reference
    elif isinstance(candidate, Samples):
        rule = candidate
    else:
        isotropic = is_isotropic(reference) and is_isotropic(candidate)
        rule = Samples.from_function(
            reference, isotropic_pair_rule(degree) if isotropic else pair_rule(ANISOTROPIC_DEGREE)
        )
    rule = rule.cleared()
    for side in (reference, candidate):  # where a table has no value, there is nothing to compare
        if not isinstance(side, Samples):
            there = known(side, rule.wi, rule.wo)
            rule = eqx.tree_at(lambda s: s.weight, rule, jnp.where(there, rule.weight, 0))
    here, there = (_at(side, rule) for side in (reference, candidate))
    if here.channels != there.channels:
        raise ValueError(f"the reference has {here.channels} channels, the candidate {there.channels}")
    used = rule.weight > 0
    if not bool(jnp.any(used)):
        raise ValueError(f"none of the {rule.size} samples has a weight above 0")
    errors = {name: _relative(here, there, name) for name in JUDGES}
    cosines = rule.wi[:, 2] * rule.wo[:, 2]
    inside = jnp.where(jnp.minimum(rule.wi[:, 2], rule.wo[:, 2]) >= jnp.cos(jnp.radians(LOG_LIMIT)), rule.weight, 0)
    differences = [
        jnp.abs(jnp.log1p(jnp.maximum(there.value, 0) * w[:, 2:]) - jnp.log1p(jnp.maximum(here.value, 0) * w[:, 2:]))
        for w in (rule.wi, rule.wo)
    ]
    total = jnp.sum(inside)
    mean = jnp.sum(inside[:, None] * (differences[0] + differences[1]), axis=0) / 2
    largest = jnp.max(jnp.where(used[:, None], jnp.abs(there.value - here.value) * cosines[:, None], 0), axis=0)
    return Comparison(
        errors, jnp.where(total > 0, mean / jnp.where(total > 0, total, 1), jnp.nan), largest,
        _albedo(reference), _albedo(candidate), int(jnp.sum(used)),
    )  # fmt: skip


def _at(side: Samples | PairFunction, rule: Samples) -> Samples:
    """One side at the directions of `rule`."""
    if isinstance(side, Samples):
        return rule
    value = with_channels(jnp.asarray(side(rule.wi, rule.wo)), 1)
    return Samples(rule.wi, rule.wo, value, rule.weight, rule.degree, rule.isotropic)


def _relative(here: Samples, there: Samples, norm: str) -> Float[Array, " channels"]:
    weight = here.weight * NORMS[norm].judge_weight(here.wi, here.wo)
    error, size = (jnp.sqrt(jnp.sum(weight[:, None] * v**2, axis=0)) for v in (there.value - here.value, here.value))
    return jnp.where(jnp.any(weight > 0), ratio(error, size), jnp.nan)


def _albedo(side: Samples | PairFunction) -> Float[Array, "angles channels"] | None:
    if isinstance(side, Samples):
        return None
    theta = jnp.radians(jnp.asarray(ANGLES))
    return albedo(side, direction(theta, jnp.zeros_like(theta)))
