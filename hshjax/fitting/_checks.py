"""What `project` refuses, and how it says so."""

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array
from hshjax.fitting._norms import Norm
from hshjax.samples import Samples


def check_samples(samples: Samples, norm: Norm, unknowns: int, *, ridged: bool) -> None:
    """ValueError, naming a count and a remedy, for samples that no fit can use."""
    weight = samples.weight
    bad_weight = int(jnp.sum(~jnp.isfinite(weight) | (weight < 0)))
    if bad_weight:
        raise ValueError(f"{bad_weight} of {samples.size} weights are negative or not finite")
    used = weight > 0
    usable = int(jnp.sum(used))
    if usable == 0:
        raise ValueError(f"no sample to fit: all of the {samples.size} samples have weight 0")

    def refuse(bad: Array, what: str) -> None:
        count = int(jnp.sum(bad & used))
        if count:
            first = int(jnp.argmax(bad & used))
            raise ValueError(
                f"{count} of {usable} samples with a positive weight {what} (the first is sample {first}); "
                "mask them with weight 0"
            )

    directions = jnp.concatenate([samples.wi, samples.wo], axis=1)
    refuse(~jnp.all(jnp.isfinite(samples.value), axis=1), "hold NaN or infinite values")
    refuse(~jnp.all(jnp.isfinite(directions), axis=1), "hold NaN or infinite directions")
    # Looser than any rounding, tighter than any angle that was forgotten to be converted.
    lengths = jnp.stack([jnp.linalg.norm(w, axis=1) for w in (samples.wi, samples.wo)])
    refuse(jnp.any(jnp.abs(lengths - 1) > 1e-3, axis=0), "have directions that are not of unit length")
    refuse((samples.wi[:, 2] < 0) | (samples.wo[:, 2] < 0), "have a direction below the horizon (z < 0)")

    inside = int(jnp.sum(used & (norm.judge_weight(samples.wi, samples.wo) > 0)))
    if inside < unknowns and not ridged:
        raise ValueError(
            f"{inside} samples count in norm {norm.name}, but there are {unknowns} unknowns: "
            "lower the order, add samples, or give a ridge > 0"
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
