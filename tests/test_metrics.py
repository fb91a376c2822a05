"""Report figures against closed forms."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.brdfs import CookTorrance, Lambert, OrenNayar
from hshjax.geometry import direction
from hshjax.metrics import albedo, hemispherical_albedo, negativity, reciprocity_error
from hshjax.quadrature import PairRule, hemisphere_rule, isotropic_pair_rule, pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, assert_close, directions

RGB = np.array([0.1, 0.5, 0.9])


def cosines(wi, wo):
    """ρ = z_i z_o: reciprocal, albedo (2π/3) z_o."""
    return wi[..., 2:] * wo[..., 2:]


def lopsided(wi, wo):
    """ρ = 1 + z_i - z_o: the difference of the two orders is 2 (z_i - z_o)."""
    return 1 + wi[..., 2:] - wo[..., 2:]


def twisted(wi, wo):
    """ρ = 1 + sin θ_i sin θ_o sin(φ_i - φ_o): isotropic, not reciprocal; the difference is twice the second term."""
    return 1 + (wi[..., 1:2] * wo[..., :1] - wi[..., :1] * wo[..., 1:2])


# --- albedo -----------------------------------------------------------------------------------------------------------


def test_albedo_of_closed_forms():
    wo = directions(0, 3, 4)
    assert_close(albedo(Lambert(RGB), wo), jnp.broadcast_to(jnp.asarray(RGB, DTYPE), (3, 4, 3)))
    assert_close(albedo(cosines, wo), 2 * jnp.pi / 3 * wo[..., 2:])
    assert_close(albedo(cosines, wo, hemisphere_rule(2)), 2 * jnp.pi / 3 * wo[..., 2:])
    assert albedo(Lambert(RGB), wo[0, 0]).shape == (3,)
    assert albedo(Lambert(RGB), wo[:0]).shape == (0, 4, 3)


def test_hemispherical_albedo_of_closed_forms():
    assert_close(hemispherical_albedo(Lambert(RGB)), RGB)
    # (1/π) ∫ (2π/3) z_o z_o dω_o = (2/3)(2π/3)
    assert_close(hemispherical_albedo(cosines), [4 * jnp.pi / 9])


def test_albedo_in_blocks_is_albedo():
    """More directions than fit one block of pairs (degree 64: 2145 nodes, 122 directions a block)."""
    wo, brdf = directions(1, 300), OrenNayar(0.8, 0.5)
    assert_close(albedo(brdf, wo)[250:], albedo(brdf, wo[250:]))


def test_albedo_is_differentiable_and_compiles():
    wo = directions(2, 5)
    gradient = jax.grad(lambda a: jnp.sum(albedo(Lambert(a), wo)))(jnp.asarray(0.3, DTYPE))
    assert_close(gradient, 5)
    assert_close(jax.jit(lambda w: albedo(cosines, w))(wo), albedo(cosines, wo))


# --- negativity -------------------------------------------------------------------------------------------------------


def test_negativity_of_closed_forms():
    share, minimum = negativity(Lambert(0.5))
    assert share == 0
    assert_close(minimum, 0.5 / jnp.pi)
    share, minimum = negativity(lambda wi, wo: -cosines(wi, wo))
    assert_close(share, 1)
    assert minimum < 0
    # One channel +1, the other -3: three quarters of the energy.
    share, minimum = negativity(lambda wi, wo: jnp.broadcast_to(jnp.asarray([1.0, -3.0], DTYPE), (*wi.shape[:-1], 2)))
    assert_close(share, 0.75)
    assert_close(minimum, -3)
    assert negativity(lambda wi, wo: 0 * cosines(wi, wo)).share == 0


def test_negativity_of_a_signed_function():
    """cos Δφ is negative over half of the azimuths: share 1/2, minimum -sin θ_i sin θ_o at the largest angles."""
    rule = isotropic_pair_rule(33, dtype=DTYPE)
    share, minimum = negativity(lambda wi, wo: jnp.sum(wi[..., :2] * wo[..., :2], -1, keepdims=True), rule)
    assert_close(share, 0.5)
    assert_close(minimum, -jnp.max(1 - rule.wi[:, 2] ** 2))


# --- reciprocity ------------------------------------------------------------------------------------------------------


def test_reciprocal_functions_have_no_error():
    error = reciprocity_error(CookTorrance(RGB / 2, 0.5, 0.2))
    assert_close(error.relative, 0)
    assert_close(error.maximum, 0)
    assert error.pairs == pair_rule(16).weight.size


@pytest.mark.parametrize("rule", [None, pair_rule(6), isotropic_pair_rule(6)], ids=["default", "pairs", "isotropic"])
def test_known_asymmetry(rule):
    # <z> = 2/3 and <z²> = 1/2 under 2z dz: ∫(2(zi - zo))² = 4 (2 <z²> - 2 <z>²) = 4/9; ∫ρ² = 1 + 1/9.
    error = reciprocity_error(lopsided, rule)
    assert_close(error.relative, np.sqrt((4 / 9) / (1 + 1 / 9)))
    zi, zo = np.meshgrid(*[np.unique(np.asarray((rule or pair_rule(16)).wi[:, 2]))] * 2)
    assert_close(error.maximum, np.max(2 * zi * zo * np.abs(zi - zo)))


@pytest.mark.parametrize("rule", [pair_rule(6), isotropic_pair_rule(8)], ids=["pairs", "isotropic"])
@pytest.mark.parametrize("function", [lopsided, twisted, cosines])
def test_samples_on_a_rule_agree_with_the_function(rule, function):
    samples = Samples.from_function(function, rule)
    error, expected = reciprocity_error(samples), reciprocity_error(function, rule)
    assert_close(error.relative, expected.relative)
    assert_close(error.maximum, expected.maximum)
    retro = np.all(np.abs(np.asarray(samples.wi - samples.wo)) < 1e-6, axis=1).sum()
    itself = np.abs(np.asarray(samples.wi[:, 2] - samples.wo[:, 2])) < 1e-6
    if samples.isotropic:
        # In plane with equal angles, Δφ = 0 or π: the swap is the sample itself.
        retro = np.sum(itself & (np.abs(np.asarray(samples.wo[:, 1])) < 1e-6))
    assert error.pairs == samples.size - retro


def test_common_rotations_of_isotropic_samples_are_found():
    rng = np.random.default_rng(3)
    theta = jnp.asarray(rng.uniform(0.05, 1.4, (2, 200)), DTYPE)
    phi = jnp.asarray(rng.uniform(-3, 3, (3, 200)), DTYPE)
    wi, wo = direction(theta[0], phi[0]), direction(theta[1], phi[1])
    # The swapped pairs, each turned by an angle of its own.
    turned_i, turned_o = direction(theta[1], phi[1] + phi[2]), direction(theta[0], phi[0] + phi[2])
    all_i, all_o = jnp.concatenate([wi, turned_i]), jnp.concatenate([wo, turned_o])
    value, weight = lopsided(all_i, all_o), jnp.ones(400, DTYPE)
    error = reciprocity_error(Samples(all_i, all_o, value, weight, isotropic=True))
    assert error.pairs == 400
    assert_close(error.maximum, jnp.max(2 * wi[:, 2] * wo[:, 2] * jnp.abs(wi[:, 2] - wo[:, 2])))
    unmatched = reciprocity_error(Samples(all_i, all_o, value, weight))
    assert unmatched.pairs == 0
    assert np.isnan(unmatched.relative)
    assert np.isnan(unmatched.maximum)


def test_weights_mask_and_weigh():
    wi, wo = directions(4, 2), directions(5, 2)
    all_i, all_o = jnp.concatenate([wi, wo]), jnp.concatenate([wo, wi])
    value = jnp.asarray([[1.0], [1.0], [1.0], [3.0]], DTYPE)

    def error(*weight):
        return reciprocity_error(Samples.scattered(all_i, all_o, value, jnp.asarray(weight, DTYPE)))

    assert error(1, 1, 1, 0) == (0.0, 0.0, 2)
    assert error(1, 0, 1, 1) == error(1, 1, 1, 0)
    assert error(0, 1, 0, 1).pairs == 2
    # Of the pair (1, 3) alone: difference 2, mean square 5.
    assert_close(error(0, 1, 0, 1).relative, np.sqrt(4 / 5))
    a, b = np.asarray(wi[:, 2] * wo[:, 2], np.float64)
    weighted = error(2, 8, 2, 2)
    assert_close(weighted.relative, np.sqrt(4 * 4 * b / (2 * a + 4 * 5 * b)))


def test_samples_without_partners_give_nan():
    wi = directions(6, 10)
    retro = reciprocity_error(Samples.scattered(wi, wi, jnp.ones((10, 1), DTYPE)))
    assert retro.pairs == 0
    assert np.isnan(retro.relative)
    empty = reciprocity_error(Samples.scattered(wi[:0], wi[:0], jnp.ones((0, 1), DTYPE)))
    assert empty.pairs == 0
    assert np.isnan(empty.maximum)


def test_rule_and_samples_exclude_each_other():
    samples = Samples.from_function(cosines, pair_rule(2))
    with pytest.raises(ValueError, match="rule must be None"):
        reciprocity_error(samples, pair_rule(2))


def test_many_samples_take_seconds():
    """Half a million isotropic pairs, half of them the swaps of the others."""
    rng = np.random.default_rng(7)
    half = 250_000
    wi, wo = directions(8, half), directions(9, half)
    order = rng.permutation(2 * half)
    all_i, all_o = jnp.concatenate([wi, wo])[order], jnp.concatenate([wo, wi])[order]
    samples = Samples(all_i, all_o, lopsided(all_i, all_o), jnp.ones(2 * half, DTYPE), isotropic=True)
    start = time.perf_counter()
    error = reciprocity_error(samples)
    elapsed = time.perf_counter() - start
    assert error.pairs == 2 * half
    assert_close(error.maximum, jnp.max(2 * wi[:, 2] * wo[:, 2] * jnp.abs(wi[:, 2] - wo[:, 2])))
    # A quadratic search would take hours; the bound leaves a slow machine room.
    assert elapsed < 60


def test_nodes_of_weight_zero_do_not_count():
    rule = pair_rule(6, dtype=DTYPE)
    low = (rule.wi[:, 2] < 0.3) | (rule.wo[:, 2] < 0.3)
    masked = PairRule(rule.wi, rule.wo, jnp.where(low, 0, rule.weight), rule.degree, rule.isotropic)

    def only_low(wi, wo):
        return jnp.where((wi[..., 2:] < 0.3) | (wo[..., 2:] < 0.3), -wi[..., 2:], 0)

    assert negativity(only_low, masked) == (0, 0)
    error = reciprocity_error(only_low, masked)
    assert (error.relative, error.maximum, error.pairs) == (0, 0, int(jnp.sum(~low)))


def test_a_function_without_channels_has_one():
    def flat(wi, wo):
        return wi[..., 2] / jnp.pi

    wo = directions(10, 4)
    assert albedo(flat, wo).shape == (4, 1)
    assert_close(albedo(flat, wo), jnp.full((4, 1), 2 / 3))
