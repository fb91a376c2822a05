"""Sums under transformations that other rules for derivatives and batches do not survive."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import AxisType, PartitionSpec

from hshjax.bases import HSH, AnisotropicHalfVectorBasis, HalfVectorBasis, HelmholtzBasis, IsotropicBasis, Zernike
from tests.helpers import DTYPE, X64, assert_close, directions

POINTS = 4


def coefficients(basis, channels=2):
    return jnp.asarray(np.random.default_rng(0).normal(size=(basis.count, channels)), DTYPE)


def arguments(basis):
    number = 1 if isinstance(basis, HSH | Zernike) else 2
    return tuple(directions(seed, POINTS, min_z=0.3) for seed in range(number))


# Written out, and by products of matrices.
BASES = [
    HSH(2),
    HSH(11),
    Zernike(3),
    IsotropicBasis(HSH(1)),
    IsotropicBasis(HSH(11)),
    HelmholtzBasis(HSH(1)),
    HalfVectorBasis(9),
    HalfVectorBasis(201),
    AnisotropicHalfVectorBasis(9),
]


def name(basis):
    return f"{type(basis).__name__}-{basis.count}"


@pytest.mark.parametrize("basis", BASES, ids=name)
def test_inside_shard_map(basis):
    """Where JAX checks over which axes of a mesh each value varies."""
    c, w = coefficients(basis), arguments(basis)
    mesh = jax.make_mesh((1,), ("devices",), axis_types=(AxisType.Auto,))
    over = PartitionSpec("devices")

    def everything(c, *w):
        value = basis.evaluate(c, *w)
        slope = jax.grad(lambda w: jnp.sum(jnp.sin(basis.evaluate(c, *w))))
        return value, jax.jvp(slope, (w,), (w,)), basis(*w)

    inside = jax.shard_map(everything, mesh=mesh, in_specs=(PartitionSpec(), *[over] * len(w)), out_specs=over)
    for found, expected in zip(
        jax.tree.leaves(jax.jit(inside)(c, *w)), jax.tree.leaves(everything(c, *w)), strict=True
    ):
        scale = 1 + float(jnp.abs(expected).max())
        assert_close(found / scale, expected / scale)


@pytest.mark.skipif(not X64, reason="float32 has no digits for a second derivative of order 11")
@pytest.mark.parametrize("basis", [HSH(2), HSH(11), HelmholtzBasis(HSH(1))], ids=name)
def test_second_derivatives_through_a_loop(basis):
    """JAX keeps no `jax.custom_jvp` of what a loop computes before its derivative."""
    c, w = coefficients(basis), arguments(basis)

    def one(w):
        return jnp.sum(jnp.sin(basis.evaluate(c, *w)))

    def looped(w):
        return jnp.sum(jax.lax.map(one, tuple(each[:, None] for each in w)))

    for second in (jax.hessian, lambda f: jax.jacrev(jax.jacrev(f)), lambda f: jax.jacfwd(jax.jacfwd(f))):
        found, expected = (jax.tree.leaves(second(f)(w)) for f in (looped, one))
        for a, b in zip(found, expected, strict=True):
            scale = float(jnp.abs(b).max())
            assert_close(a / scale, b / scale)


@pytest.mark.parametrize("basis", [HSH(2), HSH(11), IsotropicBasis(HSH(1)), HelmholtzBasis(HSH(1))], ids=name)
def test_batches_of_batches(basis):
    c, w = coefficients(basis), arguments(basis)
    items = jnp.stack([c, 2 * c, c - 1])
    expected = jnp.stack([jnp.stack([basis.evaluate(item, *w)] * 2) for item in items])
    both = tuple(jnp.stack([each, each]) for each in w)

    def evaluate(item, *w):
        return basis.evaluate(item, *w)

    alone = jax.vmap(evaluate, (0, *[None] * len(w)))  # of items
    over = jax.vmap(evaluate, (None, *[0] * len(w)))  # of directions
    assert_close(jax.vmap(lambda item: over(item, *both))(items), expected)
    assert_close(jax.vmap(lambda *w: alone(items, *w), out_axes=1)(*both), expected)

    # Both differ, item by item: side by side, and so their derivatives.
    def slope(item, *w):
        return jax.grad(lambda item: jnp.sum(jnp.sin(basis.evaluate(item, *w))))(item)

    together = jax.vmap(slope)(items, *(jnp.stack([each] * 3) for each in w))
    assert_close(together, jnp.stack([slope(item, *w) for item in items]))
    tangents = jax.vmap(lambda item, *w: jax.jvp(partial(evaluate, item), w, w)[1])
    assert_close(
        tangents(items, *(jnp.stack([each] * 3) for each in w)),
        jnp.stack([jax.jvp(partial(evaluate, item), w, w)[1] for item in items]),
    )

    # The other way round: derivatives of what has been taken side by side, also where only one of both moves.
    many = tuple(jnp.stack([each] * 3) for each in w)

    def total(items, *w):
        return jnp.sum(jnp.sin(jax.vmap(evaluate)(items, *w)))

    assert_close(jax.grad(total)(items, *many), together)
    moved = jax.jvp(lambda *w: jax.vmap(evaluate)(items, *w), many, many)[1]
    assert_close(moved, jnp.stack([jax.jvp(partial(evaluate, item), w, w)[1] for item in items]))
    twice = jax.vmap(jax.vmap(evaluate))  # both differ in both batches
    deep = jnp.stack([items, items + 1])
    deeper = tuple(jnp.stack([each, each]) for each in many)
    found = jax.grad(lambda deep: jnp.sum(jnp.sin(twice(deep, *deeper))))(deep)
    assert_close(found[0], together)


@pytest.mark.parametrize("basis", [HSH(2), HSH(11), IsotropicBasis(HSH(1)), HalfVectorBasis(9)], ids=name)
def test_sums_transpose_as_what_they_are_linear_in(basis):
    c, w = coefficients(basis), arguments(basis)

    def evaluate(c):
        return basis.evaluate(c, *w)

    weight = evaluate(c)
    (found,) = jax.linear_transpose(evaluate, c)(weight)
    assert_close(found, jax.grad(lambda c: jnp.vdot(weight, evaluate(c), precision="highest"))(c))
    items = jnp.stack([c, c + 1])
    (found,) = jax.linear_transpose(jax.vmap(evaluate), items)(jax.vmap(evaluate)(items))
    assert found.shape == items.shape
    with pytest.raises(TypeError, match="linear in the coefficients"):
        jax.linear_transpose(lambda w: basis.evaluate(c, *w), w)(weight)


@pytest.mark.parametrize("basis", [HSH(2), IsotropicBasis(HSH(1)), HalfVectorBasis(9)], ids=name)
def test_exported_for_any_number_of_points(basis):
    (points,) = jax.export.symbolic_shape("n", constraints=["n >= 1", "n <= 300"])
    c, w = coefficients(basis), arguments(basis)
    like = [jax.ShapeDtypeStruct((points, 3), DTYPE)] * len(w)
    program = jax.export.export(jax.jit(lambda *w: basis.evaluate(c, *w)))(*like)
    assert_close(program.call(*w), basis.evaluate(c, *w))
