"""The norms by name: what they weigh, and what they refuse."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.fitting import NORMS
from hshjax.fitting._norms import named_norm
from hshjax.geometry import direction
from tests.fitting.oracle import NORM_TABLE, TARGETS, host
from tests.helpers import DTYPE, assert_close, directions


def test_the_norms_are_those_of_the_mathematics():
    assert list(NORMS) == list(NORM_TABLE)
    for name, (p, fit, judge, max_theta) in NORM_TABLE.items():
        norm = named_norm(name)
        assert norm.name == name
        assert norm.meaning
        assert norm.target == TARGETS[name]
        assert (norm.exponent, norm.fit, norm.judge, norm.max_theta) == (p, fit, judge, max_theta)


def test_coefficients_are_inner_products_only_under_a_flat_weight():
    assert [name for name, norm in NORMS.items() if norm.orthonormal] == ["B", "C", "D"]


@pytest.mark.parametrize("name", NORM_TABLE)
def test_weights(name):
    wi, wo = directions(0, 200), directions(1, 200)
    zi, zo = (a[:, 2] for a in host(wi, wo))
    _, fit, judge, max_theta = NORM_TABLE[name]
    inside = np.minimum(zi, zo) >= math.cos(max_theta)
    assert inside.all() == (name != "E")
    norm = NORMS[name]
    assert_close(norm.fit_weight(wi, wo), (zi * zo) ** fit * inside)
    assert_close(norm.judge_weight(wi, wo), (zi * zo) ** judge * inside)
    assert norm.fit_weight(wi, wo).dtype == DTYPE


def test_norm_e_ends_at_80_degrees():
    theta = jnp.radians(jnp.asarray([79.9, 80.1], DTYPE))
    w, up = direction(theta, jnp.asarray(0.0, DTYPE)), direction(jnp.zeros(2, DTYPE), jnp.asarray(0.0, DTYPE))
    for weight in (NORMS["E"].fit_weight, NORMS["E"].judge_weight):
        for inside, outside in (weight(w, up), weight(up, w)):
            assert inside > 0
            assert outside == 0


@pytest.mark.parametrize("name", ["F", "a", "", "AB", "L2"])
def test_unknown_names_are_refused_with_the_known_ones(name):
    with pytest.raises(ValueError, match=rf"norm must be one of A, B, C, D, E .*got {name!r}"):
        named_norm(name)
