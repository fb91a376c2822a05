"""Bases of pairs of directions: orthonormality, symmetries, counts, and the sum without the row."""

import csv
from functools import lru_cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax import HSH, SHR, HelmholtzBasis, IsotropicBasis, TensorBasis, Zernike, isotropic_pair_rule, pair_rule
from hshjax.bases._pairs import PAIR_BLOCK
from tests.bases.cases import ALL_BASES, ALL_PAIR_BASES, ALL_PAIRS, SOME_PAIRS
from tests.bases.test_laws import equations, normal
from tests.helpers import DTYPE, X64, assert_close, directions, mostly_slow

COUNTS = Path(__file__).parents[1] / "reference" / "counts.csv"
ORDER = 2

all_pairs = pytest.mark.parametrize("name", mostly_slow(ALL_PAIRS, SOME_PAIRS))


def make(name: str, order: int = ORDER):
    pairs, basis = ALL_PAIRS[name]
    return pairs(basis(order))


@lru_cache
def sample(name: str):
    """The basis, 40 pairs of directions, and its rows there."""
    wi, wo = directions(0, 40), directions(1, 40)
    return make(name), wi, wo, np.asarray(make(name)(wi, wo))


def turned(w, angle: float):
    c, s = np.cos(angle), np.sin(angle)
    return w @ jnp.asarray([[c, s, 0], [-s, c, 0], [0, 0, 1]], DTYPE)


def mirrored(w):
    return w.at[..., 1].multiply(-1)


# --- orthonormality and counts ----------------------------------------------------------------------------------------


def gram_error(pairs, rule):
    y, weight = np.asarray(pairs(rule.wi, rule.wo), np.float64), np.asarray(rule.weight, np.float64)
    return np.max(np.abs(y.T @ (weight[:, None] * y) - np.eye(y.shape[1])))


@all_pairs
def test_orthonormal_on_pairs_of_directions(name):
    assert gram_error(make(name), pair_rule(2 * ORDER, dtype=DTYPE)) <= (1e-12 if X64 else 2e-5)


@pytest.mark.parametrize("bilateral", [True, False])
@pytest.mark.parametrize("name", ALL_BASES)
def test_isotropic_is_orthonormal_on_the_isotropic_rule(name, bilateral):
    pairs = IsotropicBasis(ALL_BASES[name](6), bilateral=bilateral)
    assert gram_error(pairs, isotropic_pair_rule(12, dtype=DTYPE)) <= (1e-12 if X64 else 5e-5)


def test_isotropic_rule_too_coarse_is_seen():
    assert gram_error(IsotropicBasis(HSH(4)), isotropic_pair_rule(6, dtype=DTYPE)) > 0.1


with COUNTS.open() as file:
    TABLE = list(csv.DictReader(file))


@pytest.mark.parametrize("row", TABLE[:17], ids=lambda row: f"order{row['order']}")
def test_counts_are_those_of_the_reference(row):
    """Every column of the table; SHR has the counts of HSH."""
    order = int(row["order"])
    for prefix, kind in (("HSH", HSH), ("HSH", SHR), ("ZER", Zernike)):
        basis = kind(order)
        found = {
            "lobe": len(basis.modes),
            "lobe_bilateral": sum(m >= 0 for _, m in basis.modes),
            "helmholtz_full": len(HelmholtzBasis(basis).modes),
            "helmholtz_iso": len(IsotropicBasis(basis, bilateral=False).modes),
            "helmholtz_iso_bilateral": len(IsotropicBasis(basis, bilateral=True).modes),
        }
        assert found == {name: int(row[f"{prefix}_{name}"]) for name in found}


@pytest.mark.parametrize("order", [0, 1, 5, 8])
@pytest.mark.parametrize("name", ALL_BASES)
def test_counts_are_the_formulas(name, order):
    """With k_m radial functions per m: Σ k_m (k_m + 1) / 2 bilateral, k_0 (k_0 + 1) / 2 + Σ_{m>0} k_m² without."""
    basis = ALL_BASES[name](order)
    k = [(order - m) // 2 + 1 if name == "zernike" else order - m + 1 for m in range(order + 1)]
    n = k[0] + 2 * sum(k[1:])
    assert len(TensorBasis(basis).modes) == n**2
    assert len(HelmholtzBasis(basis).modes) == n * (n + 1) // 2
    assert len(IsotropicBasis(basis).modes) == sum(j * (j + 1) // 2 for j in k)
    assert len(IsotropicBasis(basis, bilateral=False).modes) == k[0] * (k[0] + 1) // 2 + sum(j * j for j in k[1:])


@all_pairs
def test_modes_are_hashable_and_say_the_orders(name):
    pairs = make(name, 3)
    assert isinstance(pairs.modes, tuple)
    assert len(set(pairs.modes)) == len(pairs.modes)
    assert pairs.degrees().shape == (len(pairs.modes), 2)
    assert pairs.degrees().max() == 3
    assert jax.tree.leaves(pairs) == []
    assert pairs == make(name, 3)
    assert hash(pairs) == hash(make(name, 3))
    assert pairs != make(name, 2)
    assert len({make(other, 3) for other in ALL_PAIRS}) == len(ALL_PAIRS)


def test_bilateral_is_the_default():
    assert IsotropicBasis(HSH(2)) == IsotropicBasis(HSH(2), bilateral=True)
    assert IsotropicBasis(HSH(2)) != IsotropicBasis(HSH(2), bilateral=False)


@pytest.mark.parametrize("name", mostly_slow([n for n in ALL_PAIRS if not n.startswith("tensor")], SOME_PAIRS))
def test_columns_of_a_lower_order_come_first(name):
    low, wi, wo, row = sample(name)
    high = make(name, 3)
    assert high.modes[: len(low.modes)] == low.modes
    assert_close(high(wi, wo)[:, : len(low.modes)], row)


# --- what the columns are ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ALL_BASES)
def test_tensor_and_helmholtz_columns_are_their_products(name):
    """h_a(wi) h_b(wo), and Eq. 2 with N = 1/sqrt2 off the diagonal, 1/2 on it; the modes name a and b."""
    tensor, wi, wo, tensor_rows = sample(f"tensor-{name}")
    helmholtz, *_, helmholtz_rows = sample(f"helmholtz-{name}")
    basis = tensor.basis
    hi, ho = (dict(zip(basis.modes, np.asarray(basis(w)).T, strict=True)) for w in (wi, wo))
    for column, (a, b) in zip(tensor_rows.T, tensor.modes, strict=True):
        assert_close(column, hi[a] * ho[b])
    for column, (a, b) in zip(helmholtz_rows.T, helmholtz.modes, strict=True):
        assert_close(column, (hi[a] * ho[b] + hi[b] * ho[a]) * (0.5 if a == b else np.sqrt(0.5)))


@pytest.mark.parametrize("name", ALL_BASES)
def test_isotropic_columns_are_their_formula(name):
    """N cos|sin(m Δφ) [R_n(i) R_p(o) ± R_p(i) R_n(o)], R read off the basis at φ = 0."""
    pairs, wi, wo, row = sample(f"isotropic-{name}")

    def radial(w):
        w = np.asarray(w)
        y = pairs.basis(jnp.asarray(np.stack([np.hypot(w[:, 0], w[:, 1]), 0 * w[:, 2], w[:, 2]], -1), DTYPE))
        return dict(zip(pairs.basis.modes, np.asarray(y).T, strict=True))

    ri, ro = radial(wi), radial(wo)
    difference = np.arctan2(wi[:, 1], wi[:, 0]) - np.arctan2(wo[:, 1], wo[:, 0])
    for column, (n, p, m) in zip(row.T, pairs.modes, strict=True):
        k, sign = abs(m), -1 if m < 0 else 1
        azimuth = np.sin(k * difference) if m < 0 else np.cos(k * difference)
        both = ri[n, k] * ro[p, k] + sign * ri[p, k] * ro[n, k]
        assert_close(column, azimuth * both / np.sqrt(2 * (1 + (n == p)) * (1 if m == 0 else 2)))


# --- symmetries -------------------------------------------------------------------------------------------------------


@all_pairs
def test_reciprocal_bases_are_unchanged_by_a_swap(name):
    pairs, wi, wo, row = sample(name)
    swapped = np.asarray(pairs(wo, wi))
    if pairs.reciprocal:
        assert_close(swapped, row)
    else:
        assert np.max(np.abs(swapped - row)) > 0.1
        k = len(pairs.basis.modes)
        assert_close(swapped.reshape(-1, k, k), row.reshape(-1, k, k).swapaxes(1, 2))


@all_pairs
def test_isotropic_bases_are_unchanged_by_a_rotation(name):
    pairs, wi, wo, row = sample(name)
    rotated = np.asarray(pairs(turned(wi, 1.1), turned(wo, 1.1)))
    if "isotropic" in name:
        assert_close(rotated, row)
        assert np.max(np.abs(np.asarray(pairs(turned(wi, 1.1), wo)) - row)) > 0.1
    else:
        assert np.max(np.abs(rotated - row)) > 0.1


@pytest.mark.parametrize("name", mostly_slow([n for n in ALL_PAIRS if n.startswith("isotropic")], SOME_PAIRS))
def test_a_mirror_changes_the_sign_of_sines_only(name):
    pairs, wi, wo = make(name, 3), directions(0, 40), directions(1, 40)  # below order 3 Zernike has no sine
    row = np.asarray(pairs(wi, wo))
    sign = np.array([-1 if m < 0 else 1 for *_, m in pairs.modes])
    assert np.any(sign < 0) != pairs.bilateral
    assert_close(pairs(mirrored(wi), mirrored(wo)), sign * row)


@pytest.mark.parametrize("name", ALL_BASES)
def test_asymmetry_of_the_matrix_is_that_of_the_function(name):
    """∫∫ (ρ(i, o) - ρ(o, i))² = ||A - Aᵀ||²."""
    pairs, rule = TensorBasis(ALL_BASES[name](ORDER)), pair_rule(2 * ORDER, dtype=DTYPE)
    k = len(pairs.basis.modes)
    matrix = normal(2, k, k)
    rho = pairs.evaluate(matrix.ravel(), rule.wi, rule.wo)
    swapped = pairs.evaluate(matrix.ravel(), rule.wo, rule.wi)
    assert_close(jnp.sum(rule.weight * (rho - swapped) ** 2), jnp.sum((matrix - matrix.T) ** 2))


# --- shapes and sums --------------------------------------------------------------------------------------------------


@all_pairs
def test_evaluate_is_the_row_times_coefficients(name):
    pairs, wi, wo, row = sample(name)
    for channels in ((), (2, 3)):
        coefficients = normal(3, len(pairs.modes), *channels)
        value = pairs.evaluate(coefficients, wi, wo)
        assert value.shape == (40, *channels)
        assert_close(value, np.tensordot(row, np.asarray(coefficients), 1), tolerance=None if X64 else 5e-5)


@pytest.mark.parametrize("name", ALL_PAIR_BASES)
def test_directions_broadcast_and_batches_may_be_empty(name):
    pairs = ALL_PAIR_BASES[name](HSH(ORDER))
    k, wi, wo = len(pairs.modes), directions(4, 5, 1), directions(5, 4)
    row = pairs(wi[:, 0][:, None].repeat(4, 1), jnp.broadcast_to(wo, (5, 4, 3)))
    c = normal(6, k, 2)
    with jax.numpy_rank_promotion("allow"):
        assert_close(pairs.evaluate(c, wi, wo), np.asarray(row) @ np.asarray(c))
    assert row.shape == (5, 4, k)
    nothing = jnp.zeros((4, 0, 3), DTYPE)
    assert jax.eval_shape(pairs, nothing, nothing).shape == (4, 0, k)
    assert jax.eval_shape(pairs.evaluate, c, nothing, nothing).shape == (4, 0, 2)
    assert pairs(wo[:0], wo[:0]).shape == (0, k)


@pytest.mark.parametrize("name", ALL_PAIR_BASES)
def test_jit_and_vmap_change_nothing(name):
    pairs, wi, wo, row = sample(f"{name}-zernike")
    c = normal(7, len(pairs.modes))
    one_by_one = jax.jit(jax.vmap(lambda wi, wo: (pairs(wi, wo), pairs.evaluate(c, wi, wo))))
    found, value = one_by_one(wi, wo)
    assert_close(found, row)
    assert_close(value, row @ np.asarray(c))


def test_blocks_do_not_show():
    pairs, wi, wo = HelmholtzBasis(Zernike(1)), directions(8, 1300), directions(9, 1300)
    c = normal(10, len(pairs.modes))
    row = np.asarray(jax.jit(jax.vmap(pairs))(wi, wo))
    for n in (1, PAIR_BLOCK - 1, PAIR_BLOCK + 1, 1300):
        assert_close(pairs(wi[:n], wo[:n]), row[:n])
        assert_close(pairs.evaluate(c, wi[:n], wo[:n]), row[:n] @ np.asarray(c))


@pytest.mark.parametrize("name", ALL_PAIR_BASES)
def test_evaluate_forms_no_product_of_the_bases(name):
    """The largest array is far below K x K numbers a pair; in the row form of the reciprocity-free basis it is that."""
    pairs = ALL_PAIR_BASES[name](HSH(8))
    k, w = len(pairs.basis.modes), jnp.zeros((PAIR_BLOCK, 3), DTYPE)

    def largest(function, *arguments):
        found = equations(jax.make_jaxpr(function)(*arguments).jaxpr)
        return max(v.aval.size for equation in found for v in equation.outvars)

    assert largest(pairs.evaluate, jnp.zeros(len(pairs.modes), DTYPE), w, w) < PAIR_BLOCK * k * k / 20
    assert largest(TensorBasis(HSH(8)), w, w) >= PAIR_BLOCK * k * k


@all_pairs
def test_wrong_coefficients_are_named(name):
    pairs, wi, wo, _ = sample(name)
    k = len(pairs.modes)
    with pytest.raises(ValueError, match=rf"must have shape \({k}, \*channels\), got \({k - 1},\)"):
        pairs.evaluate(jnp.zeros(k - 1, DTYPE), wi, wo)


@pytest.mark.parametrize("name", ALL_PAIRS)
@pytest.mark.parametrize("order", [0, 1, 3, 4])
def test_the_count_is_that_of_the_modes(name, order):
    assert make(name, order).count == len(make(name, order).modes)


@pytest.mark.parametrize("name", ALL_PAIR_BASES)
def test_batches_of_vmap_are_more_pairs(name):
    pairs = ALL_PAIR_BASES[name](HSH(4))  # with channels enough that nothing is written out
    wi, wo = directions(60, 6).reshape(2, 3, 3), directions(61, 6).reshape(2, 3, 3)
    c = normal(62, 2, pairs.count, 20)
    expected = jnp.stack([pairs.evaluate(c[0], *both) for both in zip(wi, wo, strict=True)])
    assert_close(jax.vmap(lambda i, o: pairs.evaluate(c[0], i, o))(wi, wo), expected)
    one_sided = jnp.stack([pairs.evaluate(c[0], wi[k], wo[0]) for k in range(2)])
    assert_close(jax.vmap(lambda i: pairs.evaluate(c[0], i, wo[0]))(wi), one_sided)
    different = jnp.stack([pairs.evaluate(c[k], wi[k], wo[k]) for k in range(2)])
    assert_close(jax.vmap(pairs.evaluate)(c, wi, wo), different)


def test_no_channels_are_no_values():
    pairs, w = TensorBasis(HSH(1)), directions(0, 3)
    assert pairs.evaluate(jnp.zeros((pairs.count, 0), DTYPE), w, w).shape == (3, 0)
