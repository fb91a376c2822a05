"""The anisotropic half-vector basis against its formula in angles, its laws, and a brushed material."""

from itertools import product
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy.special import eval_jacobi, roots_legendre

from hshjax.bases import AnisotropicHalfVectorBasis, HalfVectorBasis, LogWarp, anisotropic_order, total_order
from hshjax.bases._pairs import PAIR_BLOCK
from hshjax.brdfs import Lambert, Ward
from hshjax.geometry import from_half_difference
from tests.bases.test_half_vector import WARPS, assert_finite_derivatives, u_of
from tests.bases.test_laws import equations, normal
from tests.helpers import DTYPE, X64, assert_close, directions, mostly_slow

TABLE = anisotropic_order(80, bilateral=False, half_turn=False)
SYMMETRIES = list(product([True, False], repeat=2))
PAIRS = [("log", "identity"), ("identity", "log"), ("root", "rational")]
"""Of warps: of the half vector, and of the difference vector."""


def make(table, names):
    return AnisotropicHalfVectorBasis(table, *(WARPS[name] for name in names))


def circle(degree, order, radius2):
    k = abs(order)
    return radius2 ** (k / 2) * eval_jacobi((degree - k) // 2, 0, k, 2 * radius2 - 1)


def rows_in_angles(table, names, theta_h, phi_h, theta_d, phi_d):
    u, v = (u_of(name, 1 - np.cos(theta)) for name, theta in zip(names, (theta_h, theta_d), strict=True))
    columns = []
    for j, k, n, m in table:
        phase = k * phi_h + m * (phi_h + phi_d)
        sine = m < 0 or (m == 0 and k < 0)
        turn = -np.sqrt(2) * np.sin(phase) if sine else np.sqrt(2) * np.cos(phase) if k or m else 1.0
        columns.append(np.sqrt((j + 1) * (n + 1)) * circle(j, k, u) * circle(n, m, v) * turn)
    return np.stack(columns, axis=-1)


def turned(w, angle):
    """About the normal, by an angle or an angle each."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = np.asarray(w, np.float64).T
    return jnp.asarray(np.stack([c * x - s * y, s * x + c * y, z], axis=-1), DTYPE)


def pairs_at(theta_h, phi_h, theta_d, phi_d):
    return tuple(turned(w, phi_h) for w in from_half_difference(*map(jnp.asarray, (theta_h, theta_d, phi_d))))


def is_sine(table):
    return np.array([m < 0 or (m == 0 and k < 0) for _, k, _, m in table])


# --- functions --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", mostly_slow(PAIRS, PAIRS[:2]), ids="-".join)
def test_rows_are_the_formula_in_angles(names):
    """And fused sums are sums of rows."""
    rng = np.random.default_rng(0)
    angles = [
        *rng.uniform([[0], [-np.pi]], [[1.2], [np.pi]], (2, 40)),
        *rng.uniform([[0], [-3]], [[1.2], [3]], (2, 40)),
    ]
    basis, (wi, wo), c = make(TABLE, names), pairs_at(*angles), normal(0, 80, 2)
    rows = basis(wi, wo)
    # In float32 from rounded directions: slopes are of the order 1 / α = 300.
    assert_close(rows, rows_in_angles(TABLE, names, *angles), tolerance=1e-9 if X64 else 5e-3)
    assert_close(basis.evaluate(c, wi, wo), np.asarray(rows) @ np.asarray(c), tolerance=1e-10 if X64 else 1e-3)


@pytest.mark.skipif(not X64, reason="a Gram matrix in float64")
@pytest.mark.parametrize("names", [("rational", "identity"), ("identity", "log")], ids="-".join)
def test_functions_are_orthonormal(names):
    """For du dv dφ_h dψ / 4π², on a rule that is exact for them; pairs below the horizon count as well."""
    disk = [(n, m) for n in range(5) for m in range(-n, n + 1, 2)]
    table = [(j, k, n, m) for (j, k), (n, m) in product(disk, disk) if n % 2 == 0]
    node, weight = roots_legendre(5)
    node, weight = (node + 1) / 2, weight / 2
    o = {"identity": node, "rational": 0.03 * node / (1.03 - node), "log": 0.003 * np.expm1(node * np.log1p(1 / 0.003))}
    theta_h, theta_d = (np.arccos(1 - o[name]) for name in names)
    azimuth = 2 * np.pi * (np.arange(10) + 0.3) / 10
    grid = np.meshgrid(theta_h, azimuth, theta_d, azimuth + 0.1, indexing="ij")
    rows = np.asarray(make(table, names)(*pairs_at(*(x.ravel() for x in grid))))
    w = np.broadcast_to(weight[:, None, None, None] * weight[:, None] / 100, (5, 10, 5, 10)).ravel()
    assert np.abs((rows * w[:, None]).T @ rows - np.eye(135)).max() < 1e-11


def test_laws():
    """Reciprocity to the bit; mirrors; turns about the normal, which turn a cosine and its sine by (k + m) angles."""
    basis, wi, wo = make(TABLE, ("log", "log")), directions(0, 50), directions(1, 50)
    rows, tolerance = np.asarray(basis(wi, wo)), 1e-10 if X64 else 2e-3
    np.testing.assert_array_equal(rows, basis(wo, wi))
    assert basis.reciprocal
    assert not basis.isotropic
    _, k, _, m = np.array(TABLE).T
    flip = np.where(is_sine(TABLE), -1, 1)
    for mirror, sign in (([1.0, -1, 1], flip), ([-1.0, 1, 1], flip * (-1.0) ** k)):
        mirror = jnp.asarray([mirror], DTYPE)
        assert_close(basis(wi * mirror, wo * mirror), rows * sign, tolerance=tolerance)
    assert_close(basis(turned(wi, np.pi), turned(wo, np.pi)), rows * (-1.0) ** k, tolerance=tolerance)

    partner = np.array([TABLE.index((j, -k, n, -m)) if (j, -k, n, -m) in TABLE else -1 for j, k, n, m in TABLE])
    known = partner >= 0
    assert known.sum() > 70
    # cos(x + y) = cos x cos y - sin x sin y, and -sin(x + y) = -sin x cos y - cos x sin y.
    angle = 0.7 * (k + m)[known]
    expected = rows[:, known] * np.cos(angle) - rows[:, partner[known]] * np.sin(angle)
    assert_close(np.asarray(basis(turned(wi, 0.7), turned(wo, 0.7)))[:, known], expected, tolerance=tolerance)


@pytest.mark.parametrize("names", mostly_slow(PAIRS, PAIRS[:1]), ids="-".join)
def test_isotropic_functions_are_those_of_opposite_orders(names):
    table, wi, wo = total_order(60, bilateral=False), directions(0, 50), directions(1, 50)
    isotropic = HalfVectorBasis(table, *(WARPS[name] for name in names))
    found = make([(2 * a, -m, n, m) for a, n, m in table], names)(wi, wo)
    assert_close(found, isotropic(wi, wo), tolerance=1e-10 if X64 else 1e-3)


@pytest.mark.parametrize("half_turn", mostly_slow([True, False], [False]))
def test_derivatives_where_angles_have_no_meaning(half_turn):
    assert_finite_derivatives(make(anisotropic_order(30, bilateral=False, half_turn=half_turn), ("log", "log")))


@pytest.mark.skipif(not X64, reason="differences in float64")
def test_gradients_against_differences():
    """In coefficients, directions and the scales of both warps; at a mirror pair and at equal directions too."""
    special = (
        jnp.asarray([[0.6, 0, 0.8], [0.6, 0, 0.8], [0, 0, 1.0]]),
        jnp.asarray([[-0.6, 0, 0.8], [0.6, 0, 0.8], [0, 0, 1]]),
    )
    wi, wo = (jnp.concatenate([directions(k, 3, min_z=0.2), special[k]]) for k in (0, 1))
    table = anisotropic_order(16, half_turn=False)

    @jax.jit
    def value(c, alphas, wi, wo):
        basis = AnisotropicHalfVectorBasis(table, *(LogWarp(jnp.asarray(alpha)) for alpha in alphas))
        return basis.evaluate(*map(jnp.asarray, (c, wi, wo)))

    arguments = normal(0, 16, 2), (jnp.asarray(0.05), jnp.asarray(0.08)), wi, wo
    check_grads(value, arguments, order=1, modes=("rev",), eps=1e-6, rtol=1e-6, atol=1e-6)


def test_transforms():
    basis, wi, wo = make(20, ("log", "log")), directions(0, 3, 5), directions(1, 3, 5)
    rows, tolerance = basis(wi, wo), 1e-10 if X64 else 1e-3
    assert rows.shape == (3, 5, 20)
    assert rows.dtype == DTYPE
    assert_close(jax.jit(lambda b, i, o: b(i, o))(basis, wi, wo), rows, tolerance=tolerance)
    assert_close(jax.vmap(basis)(wi, wo), rows, tolerance=tolerance)
    assert basis(wi[:0], wo[:0]).shape == (0, 5, 20)
    assert basis.evaluate(normal(0, 20, 2), wi[:0], wo[:0]).shape == (0, 5, 2)


@pytest.mark.skipif(not X64, reason="compares the two precisions, which needs x64")
def test_float32_is_float64_rounded():
    basis, wi, wo = AnisotropicHalfVectorBasis(60), *(directions(k, 200).astype(jnp.float32) for k in (0, 1))
    assert basis(wi, wo).dtype == jnp.float32
    wide = basis(wi.astype(jnp.float64), wo.astype(jnp.float64))
    # Degrees up to 14 of u, whose slope is up to 1 / (α ln(1 + 1/α)) = 22: some hundred roundings.
    assert_close(basis(wi, wo), wide, tolerance=5e-4)


def test_equal_and_hashed_by_what_is_static():
    """The arrays of two materials do not tell them apart; their functions do."""

    def static(basis):
        return eqx.partition(basis, eqx.is_array)[1]

    one, other = (static(AnisotropicHalfVectorBasis(9, LogWarp(jnp.asarray(alpha, DTYPE)))) for alpha in (0.1, 0.2))
    assert one == other
    assert hash(one) == hash(other)
    assert one != static(AnisotropicHalfVectorBasis(10, LogWarp(jnp.asarray(0.1, DTYPE))))
    assert one != static(AnisotropicHalfVectorBasis(9, WARPS["rational"]))


def test_evaluate_never_holds_the_row():
    basis, w = AnisotropicHalfVectorBasis(300), jnp.zeros((PAIR_BLOCK, 3), DTYPE)

    def largest(function, *arguments):
        found = equations(jax.make_jaxpr(function)(*arguments).jaxpr)
        return max(v.aval.size for equation in found for v in equation.outvars)

    assert largest(basis.evaluate, jnp.zeros((300, 1), DTYPE), w, w) < PAIR_BLOCK * 300 / 2
    assert largest(basis, w, w) >= PAIR_BLOCK * 300


# --- tables -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bilateral", "half_turn"), SYMMETRIES)
def test_shorter_tables_are_prefixes(bilateral, half_turn):
    long = anisotropic_order(300, bilateral=bilateral, half_turn=half_turn)
    assert len(set(long)) == 300
    assert long[:40] == anisotropic_order(40, bilateral=bilateral, half_turn=half_turn)
    assert is_sine(long).any() != bilateral
    assert any(k % 2 for _, k, _, _ in long) != half_turn
    cost = [j / 2.8 + n / 2 + 1.2 * abs(m) + 0.3 * abs(k + m) for j, k, n, m in long]
    assert np.all(np.diff(cost) > -1e-12)
    isotropic = [(j // 2, n, m) for j, k, n, m in long if k == -m]
    if bilateral:  # a cosine and its sine cost the same, and may come in either order
        assert tuple(isotropic) == total_order(len(isotropic))
    assert set(isotropic) <= set(total_order(len(isotropic) + 1, bilateral=bilateral))


DEGREES = [4, 8, 12, 16]
COLUMNS = {
    "anisotropic": {"bilateral": False, "half_turn": False},
    "anisotropic, bilateral": {"bilateral": True, "half_turn": False},
    "anisotropic, half-turn": {"bilateral": False, "half_turn": True},
    "anisotropic, both": {"bilateral": True, "half_turn": True},
}


def modes_up_to(degree):
    """By the definition: all pairs of circle polynomials that there are."""
    disk = [(n, m) for n in range(degree + 1) for m in range(-n, n + 1, 2)]
    return [(*a, *b) for a, b in product(disk, disk) if a[0] + b[0] <= degree and b[0] % 2 == 0]


def test_counts_are_those_of_the_docs():
    """Functions of j + n up to a degree, of the order that knows nothing but these, as docs/bases.md has them."""
    rows = {name: [] for name in ("isotropic, bilateral", "isotropic", *COLUMNS)}
    for degree in DEGREES:
        every = modes_up_to(degree)
        isotropic = [mode for mode in every if mode[1] == -mode[3]]
        rows["isotropic"].append(len(isotropic))
        rows["isotropic, bilateral"].append(int(np.sum(~is_sine(isotropic))))
        for name, symmetry in COLUMNS.items():
            chosen = {
                mode
                for mode, sine in zip(every, is_sine(every), strict=True)
                if not (symmetry["bilateral"] and sine) and not (symmetry["half_turn"] and mode[1] % 2)
            }
            found = anisotropic_order(len(chosen) + 1, **symmetry, cost=(1.0, 1.0, 0.0, 0.0))
            assert set(found[:-1]) == chosen
            assert found[-1][0] + found[-1][2] > degree
            rows[name].append(len(chosen))
    text = (Path(__file__).parents[2] / "docs" / "bases.md").read_text()
    for name, counts in rows.items():
        line = f"| {name} | {' | '.join(map(str, counts))} |"
        assert line in text, line


@pytest.mark.parametrize(
    ("functions", "message"),
    [
        (0, "at least one function, got a count of 0"),
        ((), "got an empty table"),
        ([(1, 1, 1, 1)], "n and m even"),
        ([(2, 1, 0, 0)], "j - k, n and m even"),
        ([(1, 3, 0, 0)], r"\|k\| <= j"),
        ([(2, 2, 2, 4)], r"\|m\| <= n"),
        ([(1, 2, 0)], r"functions are \(j, k, n, m\)"),
        ([(1, 1, 2, 0), (1, 1, 2, 0)], "stands twice"),
    ],
)
def test_tables_that_are_refused(functions, message, unchecked):
    with pytest.raises(ValueError, match=message):
        AnisotropicHalfVectorBasis(functions)


@pytest.mark.parametrize("cost", [(0.0, 1.0, 1.0, 1.0), (1.0, 1.0, -1.0, 0.0)])
def test_costs_that_are_refused(cost):
    with pytest.raises(ValueError, match="costs are >= 0, and > 0 of degrees, got"):
        anisotropic_order(3, cost=cost)


def test_something_else_for_a_warp(unchecked):
    with pytest.raises(ValueError, match=r"needs a warp, got 0\.1"):
        AnisotropicHalfVectorBasis(3, 0.1)


# --- a material -------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not X64, reason="least squares in float64")
def test_a_brushed_material():
    """ln ρ of Lambert + Ward by least squares, judged on other pairs: no isotropic function tells its two widths."""
    truth = Lambert(jnp.asarray([0.2])) + Ward(jnp.asarray([0.2]), jnp.asarray(0.1), jnp.asarray(0.4))
    theta_h, phi_h, theta_d, phi_d = np.random.default_rng(0).uniform(size=(4, 4000)) * [[1], [4], [1], [4]] * np.pi / 2
    wi, wo = pairs_at(theta_h**2 / (np.pi / 2), phi_h, theta_d, phi_d)  # denser at the highlight
    seen = np.asarray((wi[:, 2] > 0.2) & (wo[:, 2] > 0.2))
    wi, wo = wi[seen], wo[seen]
    target, other = np.log(np.asarray(truth(wi, wo)))[:, 0], np.arange(len(wi)) % 2 == 1
    errors = {}
    for kind in (HalfVectorBasis, AnisotropicHalfVectorBasis):
        rows = np.asarray(kind(50, LogWarp(jnp.asarray(0.01)))(wi, wo))
        c = np.linalg.lstsq(rows[~other], target[~other], rcond=None)[0]
        errors[kind] = np.sqrt(np.mean((rows[other] @ c - target[other]) ** 2))
    print({kind.__name__: round(float(error), 3) for kind, error in errors.items()})
    assert errors[AnisotropicHalfVectorBasis] < errors[HalfVectorBasis] / 4
