"""Figures of one material against another: closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.brdfs import HalfVectorTable, Lambert
from hshjax.fitting import compare, relative_error
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import assert_close


def test_lambert_against_lambert():
    """All relative errors are the ratio less 1, whatever the norm; log errors an integral over one cosine."""
    found = compare(Lambert([0.5, 0.8]), Lambert([0.6, 0.8]), degree=32)
    for name in ("A", "D", "E"):
        np.testing.assert_allclose(found.errors[name], [0.2, 0], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(found.reference_albedo, np.tile([0.5, 0.8], (3, 1)), rtol=1e-4)
    np.testing.assert_allclose(found.albedo, np.tile([0.6, 0.8], (3, 1)), rtol=1e-4)
    rule = isotropic_pair_rule(32)
    cosines = [np.asarray(w[:, 2], np.float64) for w in (rule.wi, rule.wo)]
    weight = np.asarray(rule.weight) * (np.minimum(*cosines) >= np.cos(np.radians(80)))
    means = [np.sum(weight * np.log((1 + 0.6 / np.pi * z) / (1 + 0.5 / np.pi * z))) for z in cosines]
    np.testing.assert_allclose(found.log_error, [np.mean(means) / np.sum(weight), 0], rtol=1e-4, atol=1e-6)
    top = float(np.max(cosines[0] * cosines[1]))
    np.testing.assert_allclose(found.largest, [0.1 / np.pi * top, 0], rtol=1e-4, atol=1e-6)


def test_samples_on_either_side_are_where_it_is_compared():
    rule = isotropic_pair_rule(8)
    samples = Samples.from_function(Lambert([0.5]), rule).reweighted(jnp.linspace(0, 1, rule.weight.size))
    there, back = compare(samples, Lambert([0.6])), compare(Lambert([0.6]), samples)
    assert_close(there.errors["D"], relative_error(Lambert([0.6]), samples, "D"))
    np.testing.assert_allclose(there.errors["A"], 0.2, rtol=1e-5)
    np.testing.assert_allclose(back.errors["A"], 1 / 6, rtol=1e-5)
    assert there.samples == rule.weight.size - 1
    assert there.reference_albedo is None
    assert back.albedo is None
    with pytest.raises(ValueError, match="both sides are scattered"):
        compare(samples, samples)
    with pytest.raises(ValueError, match="candidate 2"):
        compare(samples, Lambert([0.5, 0.5]))


def test_where_a_table_has_no_value_nothing_is_compared():
    """A table of 0.5/π whose nodes beyond θ_h = 45 degrees hold nonsense and are not measured."""
    axes = np.linspace(0, np.pi / 2, 9), np.linspace(0, np.pi / 2, 5), np.linspace(0, np.pi, 4, endpoint=False)
    values, measured = np.full((9, 5, 4, 1), 0.5 / np.pi), np.ones((9, 5, 4), bool)
    values[5:], measured[5:] = 99, False
    table = HalfVectorTable(
        jnp.asarray(values), *map(jnp.asarray, axes), channel_names=("value",), measured=jnp.asarray(measured)
    )
    found = compare(Lambert([0.5]), table, degree=16)
    np.testing.assert_allclose(found.errors["A"], 0, atol=1e-5)
    assert 0 < found.samples < isotropic_pair_rule(16).weight.size
