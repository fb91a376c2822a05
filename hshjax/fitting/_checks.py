"""What `project` refuses, and how it says so."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array
from hshjax.bases import AbstractPairBasis
from hshjax.fitting._norms import Norm
from hshjax.samples import Samples


class Counts(NamedTuple):
    """Of samples: how many there are, have a weight, count in the norm; and the sum of the weights."""

    size: int
    used: int
    inside: int
    total: float

    def plus(self, other: "Counts") -> "Counts":
        """Of both together."""
        return Counts(
            self.size + other.size, self.used + other.used, self.inside + other.inside, self.total + other.total
        )


def check_samples(samples: Samples, norm: Norm, unknowns: int, *, ridged: bool) -> Counts:
    """How many samples there are of each kind.

    **Raises:** ValueError, naming a count and a remedy, for samples that no fit can use.
    """
    counts = check_values(samples, norm)
    check_enough(counts, norm, unknowns, ridged=ridged)
    return counts


def check_values(samples: Samples, norm: Norm, size: int | None = None) -> Counts:
    """The same without a word about how many there are. Only the first `size` are meant, where others fill them up."""
    size = samples.size if size is None else size
    bad_weights, used, inside, total, faults = jax.device_get(_survey(samples, norm))
    if bad_weights:
        raise ValueError(f"{bad_weights} of {size} weights are negative or not finite")
    for what, (count, first) in zip(FAULTS, faults, strict=True):
        if count:
            raise ValueError(
                f"{count} of {used} samples with a positive weight {what} (the first is sample {first}); "
                "mask them with weight 0"
            )
    return Counts(size, int(used), int(inside), float(total))


def check_isotropy(basis: AbstractPairBasis, samples: Samples) -> None:
    """ValueError for isotropic samples and a basis that is not."""
    if samples.isotropic and not basis.isotropic:
        raise ValueError(
            f"isotropic samples say nothing of how {basis} depends on φ_i + φ_o: fit an IsotropicBasis; "
            "`hshjax.bases.convert` embeds it"
        )


def check_numbers(samples: Samples) -> None:
    """ValueError for samples of no channel, or of a dtype that nothing factorises matrices of."""
    if samples.channels == 0:
        raise ValueError("no sample to fit: values have no channel")
    if samples.value.dtype not in (jnp.float32, jnp.float64):
        raise ValueError(f"samples must be float32 or float64, got {samples.value.dtype}: convert them before the fit")


def check_enough(counts: Counts, norm: Norm, unknowns: int, *, ridged: bool) -> None:
    """ValueError where the samples are too few."""
    if counts.used == 0:
        raise ValueError(f"no sample to fit: all of the {counts.size} samples have weight 0")
    if counts.inside < unknowns and not ridged:
        raise ValueError(
            f"{counts.inside} samples count in norm {norm.name}, but there are {unknowns} unknowns: "
            "lower the order, add samples, or give a ridge > 0"
        )


FAULTS = (
    "hold NaN or infinite values",
    "hold NaN or infinite directions",
    "have directions that are not of unit length",
    "have a direction below the horizon (z < 0)",
)


@partial(jax.jit, static_argnums=1)  # one program, where each of its operations would be compiled by itself
def _survey(samples: Samples, norm: Norm) -> tuple[Array, Array, Array, Array, list[tuple[Array, Array]]]:
    """Bad weights, usable samples, those of them that the norm sees, all weight, and (count, first) of every fault."""
    weight = samples.weight
    used = weight > 0
    directions = jnp.concatenate([samples.wi, samples.wo], axis=1)
    lengths = jnp.stack([jnp.linalg.norm(w, axis=1) for w in (samples.wi, samples.wo)])
    faults = (
        ~jnp.all(jnp.isfinite(samples.value), axis=1),
        ~jnp.all(jnp.isfinite(directions), axis=1),
        # Looser than any rounding, tighter than any angle that was forgotten to be converted.
        jnp.any(jnp.abs(lengths - 1) > 1e-3, axis=0),
        # cos 90° is -4e-8 in float32: a grid that ends there ends on the horizon, not below it.
        (samples.wi[:, 2] < -1e-6) | (samples.wo[:, 2] < -1e-6),
    )
    return (
        jnp.sum(~jnp.isfinite(weight) | (weight < 0)),
        jnp.sum(used),
        jnp.sum(used & (norm.judge_weight(samples.wi, samples.wo) > 0)),
        jnp.sum(weight),
        # A sentinel lets argmax find something among no samples at all.
        [(jnp.sum(fault & used), jnp.argmax(jnp.append(fault & used, True))) for fault in faults],
    )


def check_determined(condition: Array, unknowns: int, *, ridged: bool) -> None:
    """ValueError where the factorisation is singular to working precision."""
    limit = 1 / (unknowns * np.finfo(condition.dtype).eps)
    if not float(condition) < limit:
        remedy = "a larger ridge" if ridged else "a ridge > 0"
        raise ValueError(
            f"the samples do not determine the {unknowns} unknowns: condition number {float(condition):.1e}, more than "
            f"{limit:.1e}, what {condition.dtype} can resolve; lower the order, add samples in other directions, "
            f"or give {remedy}"
        )
