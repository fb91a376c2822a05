"""Non-negative weights of a few materials: exact, for very many pixels at once."""

import jax.numpy as jnp

from hshjax._typing import Array, Float

LIMIT = 5
"""Of materials: the number of supports doubles with each."""


def non_negative_weights(
    gram: Float[Array, "*batch k k"], moment: Float[Array, "*batch k"]
) -> tuple[Float[Array, "*batch k"], Float[Array, " *batch"]]:
    """The w >= 0 that minimise w·gram·w - 2 w·moment, and how much they explain: w·moment.

    Every support is solved, and the best one without a negative weight taken: exact, and quick for `LIMIT` materials.
    What does not differ to rounding shares no weight: the first of them gets all.
    """
    k = moment.shape[-1]
    if k > LIMIT:
        raise ValueError(f"at most {LIMIT} materials, got {k}")
    weights, explained = jnp.zeros_like(moment), jnp.zeros_like(moment[..., 0])
    for support in sorted(range(1, 2**k), key=int.bit_count):
        chosen = [index for index in range(k) if support >> index & 1]
        part = solve([[gram[..., i, j] for j in chosen] for i in chosen], [moment[..., i] for i in chosen])
        gain = sum(w * moment[..., i] for w, i in zip(part, chosen, strict=True))
        better = (gain > explained) & jnp.all(jnp.stack(part) >= 0, axis=0)
        found = dict(zip(chosen, part, strict=True))
        whole = jnp.stack([found.get(i, jnp.zeros_like(explained)) for i in range(k)], axis=-1)
        weights = jnp.where(better[..., None], whole, weights)
        explained = jnp.where(better, gain, explained)
    return weights, explained


def solve(matrix: list[list[Array]], right: list[Array]) -> list[Array]:
    """x of small positive definite systems, entry by entry: for many systems a solver's call each would take longer.

    Infinite or NaN where a pivot is lost to rounding; a comparison with such a value is false.
    """
    n = len(right)
    matrix, right = [list(row) for row in matrix], list(right)
    diagonal = [matrix[i][i] for i in range(n)]
    for i in range(n):
        pivot = matrix[i][i]
        lost = pivot <= 16 * jnp.finfo(pivot.dtype).eps * diagonal[i]
        pivot = jnp.where(lost, jnp.nan, pivot)
        matrix[i][i] = pivot
        for j in range(i + 1, n):
            factor = matrix[j][i] / pivot
            for column in range(i + 1, n):
                matrix[j][column] = matrix[j][column] - factor * matrix[i][column]
            right[j] = right[j] - factor * right[i]
    found: list[Array] = [right[0]] * n
    for i in reversed(range(n)):
        rest = sum((matrix[i][j] * found[j] for j in range(i + 1, n)), jnp.zeros_like(right[i]))
        found[i] = (right[i] - rest) / matrix[i][i]
    return found
