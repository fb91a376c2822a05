"""What every basis of directions obeys: shapes, dtypes, transformations, blocks, and the cost of compiling."""

import re
import time
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import hshjax
from hshjax import HSH, SHR, Zernike
from hshjax.bases._base import BLOCK
from tests.bases.cases import ALL_BASES, EVERY_BASIS
from tests.helpers import DTYPE, X64, assert_close, directions

every_basis = pytest.mark.parametrize("name", EVERY_BASIS)


def normal(seed: int, *shape: int):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), DTYPE)


@pytest.fixture
def unchecked():
    """Without the tests' type checks, which refuse an order that is no `int` before the library sees it."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


OPERATIONS = "series_sums", "series_gradients", "pair_sums"


def equations(jaxpr) -> list:
    """Every equation of a jaxpr and of those inside it, and inside what `_operation.py` makes primitives of."""
    found = []
    for equation in jaxpr.eqns:
        found.append(equation)
        if equation.primitive.name in OPERATIONS:
            given = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in equation.invars]
            found += equations(jax.make_jaxpr(partial(equation.primitive.impl, **equation.params))(*given).jaxpr)
        for inner in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda p: hasattr(p, "eqns")):
            if hasattr(inner, "eqns"):
                found += equations(inner)
    return found


# --- what a basis is --------------------------------------------------------------------------------------------------


def test_public_names():
    names = "HSH Zernike SHR SphericalHarmonics AbstractBasis TensorBasis HelmholtzBasis IsotropicBasis LowRank "
    names += "AbstractPairBasis convert factorize from_matrix to_matrix from_ordered to_ordered"
    assert all(hasattr(hshjax, name) for name in names.split())


@every_basis
def test_is_static_and_equal_by_value(name, unchecked):
    basis = EVERY_BASIS[name]
    assert jax.tree.leaves(basis(3)) == []
    assert isinstance(basis(3), eqx.Module)
    assert basis(3) == basis(np.int64(3))
    assert hash(basis(3)) == hash(basis(np.int64(3)))
    assert basis(3) != basis(4)
    assert basis(3) != 3
    assert len({kind(3) for kind in EVERY_BASIS.values()}) == len(EVERY_BASIS)


@every_basis
def test_is_a_static_argument_of_jit(name):
    traces = []

    @eqx.filter_jit
    def modes_of(basis, x):
        traces.append(basis)
        return x + len(basis.modes)

    for order in (2, 2, 3, 2):
        modes_of(EVERY_BASIS[name](order), jnp.zeros(()))
    assert len(traces) == 2


@every_basis
@pytest.mark.parametrize("order", [-1, 2.0, True, "a", None, np.array([1, 2])])
def test_order_must_be_an_integer_from_zero_up(name, order, unchecked):
    with pytest.raises(ValueError, match="order must be an integer >= 0, got " + re.escape(repr(order))):
        EVERY_BASIS[name](order)


@every_basis
def test_modes_are_the_columns_by_n_then_m(name):
    step = 2 if name == "zernike" else 1
    for order in (0, 1, 4, 7):
        modes = EVERY_BASIS[name](order).modes
        assert modes == tuple((n, m) for n in range(order + 1) for m in range(-n, n + 1, step))
        assert len(modes) == ((order + 1) * (order + 2) // 2 if name == "zernike" else (order + 1) ** 2)
        assert isinstance(hash(modes), int)


@every_basis
def test_modes_say_what_the_columns_do_in_azimuth(name):
    """m > 0 goes like cos mφ and m < 0 like sin |m|φ, both over the value of the cosine at φ = 0."""
    basis, z, phi = EVERY_BASIS[name](5), 0.4, np.linspace(0, 6, 13)
    rim = np.sqrt(1 - z**2)
    w = jnp.asarray(np.stack([rim * np.cos(phi), rim * np.sin(phi), np.full_like(phi, z)], -1), DTYPE)
    y = np.asarray(basis(w))
    for column, (n, m) in enumerate(basis.modes):
        radial = y[0, basis.modes.index((n, abs(m)))]
        assert_close(y[:, column], radial * (np.sin(-m * phi) if m < 0 else np.cos(m * phi)))


# --- shapes, dtypes, transformations ----------------------------------------------------------------------------------


@every_basis
@pytest.mark.parametrize("channels", [(), (1,), (3,), (2, 3)])
def test_evaluate_is_the_row_times_coefficients(name, channels):
    basis, w = EVERY_BASIS[name](4), directions(0, 5, 4)
    coefficients = normal(1, len(basis.modes), *channels)
    value = basis.evaluate(coefficients, w)
    assert value.shape == (5, 4, *channels)
    assert_close(value, np.tensordot(np.asarray(basis(w)), np.asarray(coefficients), 1))


@every_basis
def test_empty_and_single_batches(name):
    basis = EVERY_BASIS[name](2)
    k, w = len(basis.modes), directions(0, 3)
    nothing = jnp.zeros((4, 0, 3), DTYPE)
    assert basis(w[:0]).shape == (0, k)
    assert jax.eval_shape(basis, nothing).shape == (4, 0, k)
    assert jax.eval_shape(basis.evaluate, jnp.ones((k, 2, 3), DTYPE), nothing).shape == (4, 0, 2, 3)
    gradient = jax.grad(lambda c: jnp.sum(basis.evaluate(c, w[:0])))(jnp.ones(k, DTYPE))
    assert_close(gradient, np.zeros(k))
    assert basis(w[0]).shape == (k,)
    assert_close(basis(w[0]), basis(w)[0])


@every_basis
def test_wrong_coefficients_are_named(name):
    basis = EVERY_BASIS[name](2)
    k = len(basis.modes)
    with pytest.raises(ValueError, match=rf"order=2.*must have shape \({k}, \*channels\), got \({k + 1}, 3\)"):
        basis.evaluate(jnp.zeros((k + 1, 3), DTYPE), directions(0, 2))


@every_basis
def test_jit_and_vmap_change_nothing(name):
    basis, w = EVERY_BASIS[name](3), directions(2, 4, 5)
    coefficients = normal(3, len(basis.modes), 2)
    expected = np.asarray(basis(w)) @ np.asarray(coefficients)
    assert_close(basis.evaluate(coefficients, w), expected)
    over_points = jax.vmap(jax.vmap(basis))
    over_channels = jax.vmap(jax.vmap(basis.evaluate, (1, None), -1), (None, 0))
    row, value = jax.jit(lambda c, w: (over_points(w), over_channels(c, w)))(coefficients, w)
    assert_close(row, basis(w))
    assert_close(value, expected)


@every_basis
def test_columns_of_a_lower_order_come_first(name):
    w = directions(4, 30)
    low, high = EVERY_BASIS[name](3), EVERY_BASIS[name](6)
    assert high.modes[: len(low.modes)] == low.modes
    # SHR: the recurrences come from rules of different sizes, and differ by their rounding.
    assert_close(high(w)[:, : len(low.modes)], low(w), tolerance=1e-13 if X64 else 1e-6)


@pytest.mark.skipif(not X64, reason="compares the two precisions, which needs x64")
@every_basis
def test_float32_is_float64_rounded(name):
    basis, w = EVERY_BASIS[name](8), directions(5, 200)
    coefficients = normal(6, len(basis.modes), 3) / len(basis.modes)
    narrow = w.astype(jnp.float32), coefficients.astype(jnp.float32)
    assert basis(narrow[0]).dtype == jnp.float32
    assert basis.evaluate(narrow[1], narrow[0]).dtype == jnp.float32
    # Rounded directions: odd HSH go like sqrt(z), so the comparison starts from those same directions.
    wide = narrow[0].astype(jnp.float64)
    assert_close(basis(narrow[0]), basis(wide), tolerance=2e-5)
    assert_close(basis.evaluate(narrow[1], narrow[0]), basis.evaluate(coefficients, wide), tolerance=2e-5)
    with jax.numpy_dtype_promotion("standard"):
        assert jax.eval_shape(basis.evaluate, narrow[1], w).dtype == jnp.float64


@pytest.mark.parametrize("name", ALL_BASES)
def test_below_the_horizon_is_the_horizon(name):
    """z < 0 is evaluated at z = 0, x and y as they are."""
    basis, w = ALL_BASES[name](5), directions(7, 20)
    below, on = w.at[:, 2].multiply(-1), w.at[:, 2].set(0)
    assert_close(basis(below), basis(on))
    c = normal(8, len(basis.modes))
    assert_close(basis.evaluate(c, below), np.asarray(basis(on)) @ np.asarray(c))
    assert not np.allclose(basis(w), basis(on))


# --- blocks and memory ------------------------------------------------------------------------------------------------


def test_blocks_do_not_show():
    """One point, a block less one, a block, one more, and a last block that overlaps the one before it."""
    basis, w = Zernike(2), directions(9, 2500)  # the blocks know nothing of the basis
    c = normal(10, len(basis.modes), 2)
    row = np.asarray(jax.jit(jax.vmap(basis))(w))
    for n in (1, BLOCK - 1, BLOCK, BLOCK + 1, 2500):
        assert_close(basis(w[:n]), row[:n])
        assert_close(basis.evaluate(c, w[:n]), row[:n] @ np.asarray(c))


@pytest.mark.parametrize("name", ALL_BASES)
def test_evaluate_never_holds_the_row(name):
    """Neither of all points (memory of the program) nor of one block (the largest array inside the loops)."""
    basis = ALL_BASES[name](16)
    k, item = len(basis.modes), np.dtype(DTYPE).itemsize
    coefficients = jnp.zeros((k, 3), DTYPE)

    jaxpr = jax.make_jaxpr(basis.evaluate)(coefficients, jnp.zeros((BLOCK, 3), DTYPE))
    sizes = [v.aval.size for equation in equations(jaxpr.jaxpr) for v in equation.outvars]
    assert len(sizes) > 50
    assert max(sizes) < BLOCK * k / 5  # the largest: radial functions of every fourth order, of a block

    def temporary(function, points):
        compiled = jax.jit(function).lower(coefficients, jax.ShapeDtypeStruct((points, 3), DTYPE)).compile()
        return compiled.memory_analysis().temp_size_in_bytes

    points = 100_000
    assert temporary(basis.evaluate, points) < points * k * item / 50
    if name != "hsh":  # the derivatives are the same code for all
        return
    # In reverse too: what is kept is a few numbers a point (value, cotangent, gradient).
    loss = jax.grad(lambda c, w: jnp.sum(basis.evaluate(c, w) ** 2), (0, 1))
    assert temporary(loss, points) < points * k * item / 5
    # The measure sees a row where there is one.
    assert temporary(lambda c, w: basis(w) @ c, points) > points * k * item / 2


# --- compiling --------------------------------------------------------------------------------------------------------

VERBS = {
    "evaluate": lambda basis: lambda c, w: basis.evaluate(c, w),
    "row": lambda basis: lambda c, w: basis(w),
}


@pytest.mark.parametrize("name", ALL_BASES)
def test_programs_grow_no_faster_than_the_order(name):
    """Of functions there are four times as many."""

    def length(verb, order):
        basis = ALL_BASES[name](order)
        arguments = jnp.zeros((len(basis.modes), 3), DTYPE), jnp.zeros((2000, 3), DTYPE)
        return len(list(equations(jax.make_jaxpr(VERBS[verb](basis))(*arguments).jaxpr)))

    assert length("row", 32) == length("row", 16)
    assert length("evaluate", 32) < 2.1 * length("evaluate", 16)


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("basis", [HSH(32), Zernike(32), SHR(32)], ids=str)
def test_order_32_compiles_within_a_second(basis, verb):
    """Lowering and compiling, in CPU time of this process (the machine may be busy); the best of three."""
    arguments = jnp.zeros((len(basis.modes), 3), DTYPE), jnp.zeros((2000, 3), DTYPE)
    basis.columns(), basis.tables()
    seconds = []
    for _ in range(3):
        start = time.process_time()
        jax.jit(VERBS[verb](basis)).lower(*arguments).compile()
        seconds.append(time.process_time() - start)
        if seconds[-1] < 1:
            break
    assert min(seconds) < 1, f"{seconds} s"


@every_basis
def test_integer_directions_are_directions(name, unchecked):
    basis = EVERY_BASIS[name](2)
    assert_close(basis(jnp.asarray([0, 0, 1])), basis(jnp.asarray([0, 0, 1], DTYPE)))
    with pytest.raises(ValueError, match=r"got shape \(4, 2\)"):
        basis(jnp.zeros((4, 2), DTYPE))


@every_basis
@pytest.mark.parametrize("order", [0, 1, 2, 5, 8])
def test_the_count_is_that_of_the_modes(name, order):
    assert EVERY_BASIS[name](order).count == len(EVERY_BASIS[name](order).modes)
