"""BRDFs as tables: the error that is reported is the error, and what a table cannot hold is said or refused."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HalfVectorBasis
from hshjax.brdfs import GGX, Lambert, LogLinearBRDF, Ward
from hshjax.fitting import tabulate
from hshjax.geometry import from_half_difference
from tests.helpers import DTYPE, X64, assert_close, directions

STEPS = (24, 12, 8)
SHINY = Lambert(np.array([0.3, 0.2, 0.1])) + GGX(0.3, 0.3)


def test_a_constant_is_met_up_to_the_horizon():
    found = tabulate(Lambert(0.4), steps=(6, 4, 3))
    assert_close(found.table.values, np.full((7, 5, 3, 1), 0.4 / np.pi))
    assert found.table.channel_names == ("0",)
    assert max(found.error.largest, found.grazing.largest) < 1e-6
    assert found.folding == 0
    wi, wo = directions(0, 50), directions(1, 50)
    assert_close(found.table(wi, wo), np.full((50, 1), 0.4 / np.pi), tolerance=1e-6)


def test_the_error_that_is_reported_is_the_error():
    """At places of one's own, anywhere in the cells: not larger than at the centres, and not much smaller."""
    found = tabulate(SHINY, steps=STEPS)
    rng = np.random.default_rng(0)
    t, d, f = rng.uniform(0, 1, (3, 40_000)) * np.array([[1], [np.pi / 2], [np.pi]])
    wi, wo = (jnp.asarray(w, DTYPE) for w in from_half_difference(*map(jnp.asarray, (t**2 * np.pi / 2, d, f))))
    seen = np.minimum(wi[:, 2], wo[:, 2]) > np.cos(np.radians(80))
    wi, wo = wi[seen], wo[seen]
    truth, guess = np.asarray(SHINY(wi, wo)), np.asarray(found.table(wi, wo))
    z = np.stack([wi[:, 2:], wo[:, 2:]])
    change = np.abs(np.log1p(truth * z) - np.log1p(guess * z))
    assert change.max() < 1.2 * found.error.largest
    assert 0.4 * found.error.mean < change.mean() < found.error.mean
    assert found.error.relative.shape == (3,)
    assert 0 < found.error.mean < 0.02


@pytest.mark.slow
def test_finer_steps_quarter_the_error():
    """Linear between nodes: of second order."""
    coarse, fine = (tabulate(SHINY, steps=tuple(n * k for n in (20, 10, 6))).error for k in (1, 2))
    assert 3 < coarse.mean / fine.mean < 5
    assert np.all(coarse.relative / fine.relative > 3)


def test_a_compact_model():
    basis = HalfVectorBasis(8)
    model = LogLinearBRDF(basis, [jnp.asarray([-1.0, 0.5, 0.2, -0.1, 0.3, 0.1, 0.1, -0.2], DTYPE), jnp.zeros(1, DTYPE)])
    found = tabulate(model, steps=STEPS)
    wi, wo = directions(0, 200, min_z=0.2), directions(1, 200, min_z=0.2)
    assert found.table.values.dtype == DTYPE
    error = np.abs(np.log(np.asarray(found.table(wi, wo)) / np.asarray(model(wi, wo))))
    assert error.max() < 0.1
    assert float(np.abs(found.table(wo, wi) - found.table(wi, wo)).max()) < (1e-9 if X64 else 1e-3)


def test_what_is_not_reciprocal_is_folded():
    found = tabulate(lambda wi, wo: wi[:, 2:], steps=STEPS)
    wi, wo = from_half_difference(*(jnp.asarray(x, DTYPE) for x in (0.3, 0.4, 0.5)))
    assert_close(found.table(wi, wo), (wi[2:] + wo[2:]) / 2, tolerance=0.02)
    assert found.folding > 0.02 > found.error.mean


def test_what_is_refused():
    with pytest.raises(ValueError, match="isotropic"):
        tabulate(Ward(0.5, 0.3, 0.1), steps=STEPS)
    with pytest.raises(ValueError, match="at least one step"):
        tabulate(SHINY, steps=(0, 4, 4))
    with pytest.raises(ValueError, match="finite values, got"):
        tabulate(lambda wi, wo: 1 / jnp.where(wi[:, 2:] > 0.99, 0, wi[:, 2:]), steps=STEPS)
