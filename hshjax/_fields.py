"""Fields of modules that a fit may move: arrays of a float dtype, with their bounds as metadata."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from hshjax._typing import Array


def bounded(
    low: float,
    high: float,
    *,
    amplitude: bool = False,
    search: tuple[float, float] | None = None,
    logarithmic: bool = False,
    **kwargs,
) -> Any:
    """A parameter field: an array of any float dtype, with metadata for those who fit it.

    - `low`, `high`: the box that a fit keeps it in (`bounds` in the metadata).
    - `amplitude`: whether ρ is linear in it, so that a guess can solve for it (`amplitude`).
    - `search`: where a guess looks for it if it is no amplitude, narrower than the box (`search`); None for the box.
    - `logarithmic`: whether a guess looks there in equal ratios instead of equal steps (`logarithmic`).

    **Raises:** ValueError for a search outside the box, or a logarithmic one that is not above 0.
    """
    if search is not None and not (low <= search[0] < search[1] <= high):
        raise ValueError(f"a search range lies in the box [{low:g}, {high:g}], got {search}")
    if logarithmic and (search is None or search[0] <= 0):
        raise ValueError(f"a logarithmic search needs a range above 0, got {search}")
    metadata = {"bounds": (low, high), "amplitude": amplitude, "search": search, "logarithmic": logarithmic}
    return eqx.field(converter=floating, metadata=metadata, **kwargs)


def floating(value: Any) -> Array:
    """An array of a float dtype: a parameter given as 32 must be as trainable as 32.0."""
    value = jnp.asarray(value)
    return value if jnp.issubdtype(value.dtype, jnp.inexact) else value.astype(jnp.result_type(float))
