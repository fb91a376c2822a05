"""What the tests share: tolerances, seeded directions, and the lists that the laws run over."""

import os

import jax.numpy as jnp
import numpy as np
import pytest

X64 = os.environ.get("HSHJAX_TEST_DTYPE", "float64") == "float64"
DTYPE = jnp.float64 if X64 else jnp.float32
TOLERANCE = 1e-10 if X64 else 2e-5


def assert_close(actual, expected, *, tolerance: float | None = None) -> None:
    """Equal to `tolerance` (1e-10 in float64, 2e-5 in float32), absolute below 1 and relative above."""
    tolerance = TOLERANCE if tolerance is None else tolerance
    np.testing.assert_allclose(np.asarray(actual), np.asarray(expected), rtol=tolerance, atol=tolerance)


def directions(seed: int, *shape: int, min_z: float = 0.0):
    """Directions uniform on the hemisphere above z = min_z, `(*shape, 3)`, in the dtype of the leg."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(min_z, 1, shape)
    phi = rng.uniform(0, 2 * np.pi, shape)
    rim = np.sqrt(1 - z**2)
    return jnp.asarray(np.stack([rim * np.cos(phi), rim * np.sin(phi), z], -1), DTYPE)


def slow_unless(kept: bool, *values, id: str | None = None):
    """A parameter set that runs in `make test-slow` only, unless it is `kept`: each costs compilations of its own."""
    return pytest.param(*values, id=id, marks=() if kept else pytest.mark.slow)


def mostly_slow(names, kept):
    """`names` as parameters; slow but for those that are `kept`."""
    return [slow_unless(name in kept, name) for name in names]
