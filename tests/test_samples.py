"""The data type of fitters and readers."""

import jax
import jax.numpy as jnp
import pytest

from hshjax import Samples, isotropic_pair_rule, pair_rule
from tests.helpers import DTYPE, assert_close, directions

N = 5


def parts(**changed):
    fields = {
        "wi": directions(0, N),
        "wo": directions(1, N),
        "value": jnp.ones((N, 3), DTYPE),
        "weight": jnp.ones(N, DTYPE),
    }
    return {**fields, **{name: jnp.ones(shape, DTYPE) for name, shape in changed.items()}}


def test_sizes():
    samples = Samples(**parts())
    assert (samples.size, samples.channels) == (N, 3)
    assert (samples.degree, samples.isotropic) == (None, False)
    assert len(jax.tree.leaves(samples)) == 4


@pytest.mark.parametrize(
    ("name", "shape"),
    [("wi", (N, 2)), ("wo", (N + 1, 3)), ("wo", (3,)), ("value", (N,)), ("value", (N - 1, 3)), ("weight", (N, 1))],
)
def test_shapes_that_disagree_are_named(name, shape, unchecked):
    message = rf"Samples needs wi \(n, 3\), .* got n = 5 from wi and {name} of shape \({', '.join(map(str, shape))},?\)"
    with pytest.raises(ValueError, match=message):
        Samples(**parts(**{name: shape}))


@pytest.mark.parametrize("rule", [pair_rule(2), isotropic_pair_rule(3)], ids=["full", "isotropic"])
def test_from_function_keeps_the_rule(rule):
    samples = Samples.from_function(lambda wi, wo: wi[..., 2:] * wo, rule)
    assert (samples.degree, samples.isotropic) == (rule.degree, rule.isotropic)
    assert_close(samples.weight, rule.weight)
    assert_close(samples.value, rule.wi[:, 2:] * rule.wo)


def test_from_function_makes_a_scalar_function_one_channel():
    rule = pair_rule(1)
    samples = Samples.from_function(lambda wi, wo: wi[..., 2] * wo[..., 2], rule)
    assert samples.value.shape == (rule.weight.size, 1)
    assert_close(samples.value[:, 0], rule.wi[:, 2] * rule.wo[:, 2])


def test_scattered_samples_weigh_one_each():
    fields = parts()
    samples = Samples.scattered(fields["wi"], fields["wo"], fields["value"])
    assert_close(samples.weight, jnp.ones(N))
    assert samples.weight.dtype == DTYPE
    assert samples.degree is None
    weighted = Samples.scattered(fields["wi"], fields["wo"], fields["value"], jnp.arange(N, dtype=DTYPE))
    assert_close(weighted.weight, jnp.arange(N))


def test_other_weights_make_samples_scattered():
    rule = isotropic_pair_rule(2)
    samples = Samples.from_function(lambda wi, wo: wi, rule).reweighted(2 * rule.weight)
    assert (samples.degree, samples.isotropic) == (None, True)
    assert_close(samples.weight, 2 * rule.weight)
    assert_close(samples.value, rule.wi)


def test_what_is_masked_is_cleared():
    weight = jnp.arange(N, dtype=DTYPE)
    bad = {name: parts()[name].at[0].set(jnp.nan) for name in ("wi", "wo", "value")}
    clear = Samples(**bad, weight=weight, degree=4, isotropic=True).cleared()
    assert (clear.degree, clear.isotropic) == (None, True)
    for name, array in parts(weight=(N,)).items():
        assert_close(getattr(clear, name)[1:], weight[1:] if name == "weight" else array[1:])
    assert_close(clear.wi[0], jnp.array([0, 0, 1], DTYPE))
    assert_close(clear.wo[0], jnp.array([0, 0, 1], DTYPE))
    assert_close(jnp.append(clear.value[0], clear.weight[0]), jnp.zeros(4))


def test_a_negative_or_missing_weight_masks_too():
    weight = jnp.array([jnp.nan, -1, 0, 1, 2], DTYPE)
    assert_close(Samples(**{**parts(), "weight": weight}).cleared().weight, jnp.array([0, 0, 0, 1, 2]))


def test_samples_pass_through_jit_with_their_rule():
    samples = Samples.from_function(lambda wi, wo: wi, pair_rule(1))
    found = jax.jit(lambda s: s)(samples)
    assert (found.degree, found.isotropic) == (1, False)
    assert_close(found.value, samples.value)
