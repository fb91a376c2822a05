"""Coefficients <-> matrix, Eq. 3's ordered series, embeddings, orders, and low rank."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax import (
    HSH,
    SHR,
    HelmholtzBasis,
    IsotropicBasis,
    TensorBasis,
    Zernike,
    convert,
    factorize,
    from_matrix,
    from_ordered,
    pair_rule,
    to_matrix,
    to_ordered,
)
from tests.bases.cases import ALL_BASES, ALL_PAIRS, SOME_PAIRS
from tests.bases.test_laws import normal
from tests.helpers import DTYPE, X64, assert_close, directions

ORDER = 2
WI, WO = directions(0, 30), directions(1, 30)


def make(name: str, order: int = ORDER):
    pairs, basis = ALL_PAIRS[name]
    return pairs(basis(order))


# --- matrices ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SOME_PAIRS)
def test_matrix_says_the_same_function(name):
    """ρ = h(wi)ᵀ A h(wo), A symmetric for a reciprocal basis, and the coefficients come back."""
    pairs = make(name)
    c = normal(0, len(pairs.modes), 2)
    matrix = to_matrix(pairs, c)
    hi, ho = (np.asarray(pairs.basis(w)) for w in (WI, WO))
    assert_close(np.einsum("pa,abc,pb->pc", hi, matrix, ho), pairs.evaluate(c, WI, WO), tolerance=None if X64 else 5e-5)
    assert bool(jnp.all(matrix == matrix.swapaxes(0, 1))) == pairs.reciprocal
    assert_close(from_matrix(pairs, matrix), c)
    assert_close(jnp.sum(matrix**2), jnp.sum(c**2))  # Parseval
    assert to_matrix(pairs, c[:, 0]).shape == matrix.shape[:2]
    assert_close(from_matrix(pairs, to_matrix(pairs, c[:, 0])), c[:, 0])


def _x64() -> bool:
    return jnp.float64 == DTYPE


@pytest.mark.parametrize("name", SOME_PAIRS)
def test_from_matrix_is_the_projection_in_l2(name):
    """The coefficients of any h(wi)ᵀ A h(wo) are its inner products with the columns."""
    pairs, rule = make(name), pair_rule(2 * ORDER, dtype=DTYPE)
    tensor = TensorBasis(pairs.basis)
    k = len(pairs.basis.modes)
    matrix = normal(1, k, k)
    rho = tensor.evaluate(matrix.ravel(), rule.wi, rule.wo)
    expected = np.asarray(pairs(rule.wi, rule.wo)).T @ np.asarray(rule.weight * rho)
    assert_close(from_matrix(pairs, matrix), expected)


def test_nearest_reciprocal_function_is_the_symmetric_part():
    pairs = HelmholtzBasis(HSH(ORDER))
    matrix = normal(2, 9, 9)
    assert_close(to_matrix(pairs, from_matrix(pairs, matrix)), (matrix + matrix.T) / 2)


def test_wrong_shapes_are_named():
    pairs = HelmholtzBasis(HSH(1))
    with pytest.raises(ValueError, match=r"must have shape \(4, 4, \*channels\), got \(3, 3\)"):
        from_matrix(pairs, jnp.zeros((3, 3), DTYPE))
    with pytest.raises(ValueError, match=r"must have shape \(4, 4, \*channels\), got \(3, 3\)"):
        from_ordered(pairs, jnp.zeros((3, 3), DTYPE))
    with pytest.raises(ValueError, match=r"must have shape \(10, \*channels\), got \(9,\)"):
        to_matrix(pairs, jnp.zeros(9, DTYPE))
    with pytest.raises(ValueError, match=r"must have shape \(10, \*channels\), got \(9,\)"):
        to_ordered(pairs, jnp.zeros(9, DTYPE))


# --- Eq. 3 ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [(), (2,)])
@pytest.mark.parametrize("name", ALL_BASES)
def test_ordered_series_of_eq_3(name, channels):
    """Σ over ORDERED pairs of a_ab N_ab [h_a(i) h_b(o) + h_b(i) h_a(o)], term by term, is what `from_ordered` says."""
    pairs = HelmholtzBasis(ALL_BASES[name](ORDER))
    hi, ho = (np.asarray(pairs.basis(w)) for w in (WI, WO))
    k = hi.shape[1]
    series = normal(3, k, k, *channels)
    expected = np.zeros((30, *channels))
    for a in range(k):
        for b in range(k):
            norm = 0.5 if a == b else np.sqrt(0.5)
            function = norm * (hi[:, a] * ho[:, b] + hi[:, b] * ho[:, a])
            expected += np.multiply.outer(function, np.asarray(series[a, b]))
    c = from_ordered(pairs, series)
    assert_close(pairs.evaluate(c, WI, WO), expected, tolerance=None if X64 else 1e-4)  # float32: 81 terms
    back = to_ordered(pairs, c)
    assert_close(back, back.swapaxes(0, 1))
    assert_close(from_ordered(pairs, back), c)
    assert jnp.sum(back**2) < jnp.sum(series**2)  # the least of all series that say the same


# --- between bases ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bilateral", [True, False])
@pytest.mark.parametrize("name", ALL_BASES)
def test_isotropic_embeds_in_helmholtz_and_in_tensor(name, bilateral):
    basis = ALL_BASES[name](ORDER)
    isotropic = IsotropicBasis(basis, bilateral=bilateral)
    c = normal(4, len(isotropic.modes), 2)
    value = isotropic.evaluate(c, WI, WO)
    for target in (HelmholtzBasis(basis), TensorBasis(basis), IsotropicBasis(basis, bilateral=False)):
        embedded = convert(isotropic, c, target)
        assert embedded.shape == (len(target.modes), 2)
        assert_close(target.evaluate(embedded, WI, WO), value)
        assert_close(jnp.sum(embedded**2), jnp.sum(c**2))
        assert_close(convert(target, embedded, isotropic), c)


def test_the_way_back_projects():
    """Helmholtz -> isotropic keeps the average over rotations: the inner products with the isotropic columns."""
    full, isotropic = HelmholtzBasis(HSH(ORDER)), IsotropicBasis(HSH(ORDER), bilateral=False)
    rule, c = pair_rule(2 * ORDER, dtype=DTYPE), normal(5, 45)
    rho = full.evaluate(c, rule.wi, rule.wo)
    expected = np.asarray(isotropic(rule.wi, rule.wo)).T @ np.asarray(rule.weight * rho)
    assert_close(convert(full, c, isotropic), expected)


@pytest.mark.parametrize("name", ALL_BASES)
def test_a_single_basis_is_padded_and_truncated(name):
    low, high = ALL_BASES[name](2), ALL_BASES[name](4)
    c = normal(6, len(low.modes), 3)
    padded = convert(low, c, high)
    assert_close(high.evaluate(padded, WI), low.evaluate(c, WI))
    assert_close(convert(high, padded, low), c)
    assert_close(convert(high, normal(7, len(high.modes)), low), normal(7, len(high.modes))[: len(low.modes)])


@pytest.mark.parametrize("name", SOME_PAIRS)
def test_a_pair_basis_is_padded_and_truncated(name):
    low, high = make(name, 1), make(name, 2)
    c = normal(8, len(low.modes), 2)
    padded = convert(low, c, high)
    assert_close(high.evaluate(padded, WI, WO), low.evaluate(c, WI, WO))
    assert_close(convert(high, padded, low), c)
    # What truncation drops is what the lower order does not have.
    full = normal(9, len(high.modes))
    kept = [mode in set(low.modes) for mode in high.modes]
    assert_close(convert(high, full, low), full[np.array(kept)])


@pytest.mark.parametrize(
    ("source", "target"),
    [
        (HSH(1), Zernike(1)),
        (HSH(1), HelmholtzBasis(HSH(1))),
        (HelmholtzBasis(HSH(1)), HSH(1)),
        (HelmholtzBasis(HSH(1)), HelmholtzBasis(SHR(1))),
    ],
    ids=str,
)
def test_other_families_are_refused(source, target):
    with pytest.raises(ValueError, match=r"of one family; got .*HSH.* and "):
        convert(source, jnp.zeros(len(source.modes), DTYPE), target)


# --- low rank ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rank", [1, 4, 9])
def test_low_rank_error_is_the_measured_one(rank):
    """Against the L2 norm of the difference on an exact rule; the full rank (9) is exact."""
    pairs, rule = HelmholtzBasis(HSH(ORDER)), pair_rule(2 * ORDER, dtype=DTYPE)
    c = normal(10, 45, 2)
    low = factorize(pairs.basis, to_matrix(pairs, c), rank)
    assert low.values.shape == (rank, 2)
    assert low.vectors.shape == (9, rank, 2)
    exact, kept = pairs.evaluate(c, rule.wi, rule.wo), low.evaluate(rule.wi, rule.wo)
    weight = rule.weight[:, None]
    measured = jnp.sqrt(jnp.sum(weight * (exact - kept) ** 2, 0) / jnp.sum(weight * exact**2, 0))
    assert_close(measured, low.error)
    if rank == 9:
        assert_close(kept, exact, tolerance=None if X64 else 1e-4)  # float32: the eigenvectors' rounding
        assert_close(low.error, np.zeros(2))
    else:
        assert bool(jnp.all(low.error > 0.05))
    assert_close(pairs.evaluate(from_matrix(pairs, low.matrix()), WI, WO), low.evaluate(WI, WO))
    assert bool(jnp.all(jnp.diff(jnp.abs(low.values), axis=0) <= 0))


def test_low_rank_recovers_a_function_of_low_rank():
    v = normal(11, 9, 2)
    matrix = (v[:, None] * v[None, :]) @ jnp.asarray([2.0, -3.0], DTYPE)
    assert_close(factorize(HSH(2), matrix[..., None], 2).error, [0.0])
    assert factorize(HSH(2), matrix[..., None], 1).error[0] > 0.1
    zero = factorize(HSH(2), 0 * matrix[..., None], 1)
    assert_close(zero.error, [0.0])
    assert_close(zero.evaluate(WI, WO), np.zeros((30, 1)))


def test_low_rank_reads_the_symmetric_part():
    matrix = normal(12, 9, 9, 1)
    symmetric = (matrix + matrix.swapaxes(0, 1)) / 2
    assert_close(factorize(HSH(2), matrix, 9).matrix(), symmetric)


@pytest.mark.parametrize(
    ("shape", "rank", "match"),
    [
        ((4, 4, 1), 0, r"rank must lie in 1 \.\.\. 4, got 0"),
        ((4, 4, 1), 5, r"rank must lie in 1 \.\.\. 4, got 5"),
        ((3, 3, 1), 1, r"must have shape \(4, 4, channels\), got \(3, 3, 1\)"),
    ],
)
def test_wrong_factorisations_are_named(shape, rank, match):
    with pytest.raises(ValueError, match=match):
        factorize(HSH(1), jnp.zeros(shape, DTYPE), rank)
