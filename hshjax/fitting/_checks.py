"""What `project` refuses, and how it says so."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array
from hshjax.fitting._norms import Norm
from hshjax.samples import Samples


def check_samples(samples: Samples, norm: Norm, unknowns: int, *, ridged: bool) -> tuple[int, float]:
    """How many samples have a weight, and the sum of the weights.

    **Raises:** ValueError, naming a count and a remedy, for samples that no fit can use.
    """
    bad_weights, usable, inside, total, faults = jax.device_get(_survey(samples, norm))
    if bad_weights:
        raise ValueError(f"{bad_weights} of {samples.size} weights are negative or not finite")
    if usable == 0:
        raise ValueError(f"no sample to fit: all of the {samples.size} samples have weight 0")
    for what, (count, first) in zip(FAULTS, faults, strict=True):
        if count:
            raise ValueError(
                f"{count} of {usable} samples with a positive weight {what} (the first is sample {first}); "
                "mask them with weight 0"
            )
    if inside < unknowns and not ridged:
        raise ValueError(
            f"{inside} samples count in norm {norm.name}, but there are {unknowns} unknowns: "
            "lower the order, add samples, or give a ridge > 0"
        )
    return int(usable), float(total)


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
