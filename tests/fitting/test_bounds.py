"""The smooth transformations of bounded parameters."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.brdfs import GGX, CookTorrance, Lambert
from hshjax.fitting._bounds import Box, declared, nan_outside, on_bound, outside, to_bounded, to_free
from tests.helpers import DTYPE, assert_close

BOXES = {
    "two-sided": Box("x", 0.2, 3.0),
    "lower": Box("x", -1.0, math.inf),
    "upper": Box("x", -math.inf, 2.0),
    "free": Box("x", -math.inf, math.inf),
}
each_box = pytest.mark.parametrize("box", BOXES.values(), ids=BOXES.keys())


@each_box
def test_there_and_back(box):
    x = jnp.asarray([0.3, 0.9, 1.5, 1.9], DTYPE)
    # Near the ends of an arcsine a rounding of x is amplified to its square root, and squared again on the way back.
    assert_close(to_bounded(to_free(x, box), box), x)


@each_box
def test_no_free_number_leaves_the_box(box):
    x = to_bounded(jnp.linspace(-50, 50, 1001, dtype=DTYPE), box)
    assert jnp.all((x >= box.low) & (x <= box.high))


@pytest.mark.parametrize("name", ["two-sided", "lower", "upper"])
def test_a_start_on_a_bound_is_moved_to_where_there_is_a_slope(name):
    box = BOXES[name]
    for end in (box.low, box.high):
        if math.isfinite(end):
            u = to_free(jnp.asarray(end, DTYPE), box)
            assert abs(jax.grad(to_bounded)(u, box)) > 1e-3
            assert abs(to_bounded(u, box) - end) < 2e-5 * box.size


def test_what_is_outside_is_no_number():
    for name in ("two-sided", "lower", "upper"):
        box = BOXES[name]
        for beyond in (box.low - 0.1, box.high + 0.1):
            if math.isfinite(beyond):
                assert jnp.isnan(nan_outside(jnp.asarray(beyond, DTYPE), box))


@pytest.mark.parametrize("name", ["two-sided", "lower", "upper"])
def test_a_bound_is_reached_and_known(name):
    box = BOXES[name]
    end = {"two-sided": math.pi / 2, "lower": 0.0, "upper": 0.0}[name]
    assert on_bound(to_bounded(jnp.asarray(end, DTYPE), box), box)
    assert not on_bound(jnp.asarray(1.0, DTYPE), box)


def test_boxes_are_those_of_the_fields():
    model = {"body": Lambert(0.5), "coat": 0.4 * GGX(1.0, 0.4), "loose": jnp.zeros(2)}
    boxes = {box.name: (box.low, box.high) for box in declared(model)}
    assert boxes["['body'].albedo"] == (0.0, 1.0)
    assert boxes["['coat'].scale"] == (0.0, math.inf)
    assert boxes["['coat'].brdf.roughness"] == (1e-3, 1.0)
    assert boxes["['loose']"] == (-math.inf, math.inf)


def test_boxes_follow_the_leaves_that_are_left():
    brdf = CookTorrance(0.2, 0.4, 0.25)
    part = eqx.tree_at(lambda b: b.specular, brdf, None)
    assert [box.name for box in declared(part)] == ["diffuse", "slope"]


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (1e-3, 1.0), (0.25, 4.0), (0.0, 1e3), (-1.43, 3.27)])
def test_a_bound_goes_to_its_free_number_and_back(low, high):
    """Under jit, where quotients round differently: neither NaN, nor outside."""
    box = Box("x", low, high)
    ends = jnp.asarray([low, high], DTYPE)
    there = jax.jit(lambda x: to_free(x, box, inside=0.0))(ends)
    assert_close(there, [-math.pi / 2, math.pi / 2], tolerance=10 * float(jnp.finfo(DTYPE).eps) ** 0.5)
    back = jax.jit(lambda u: to_bounded(u, box))(there)
    assert_close(back, ends, tolerance=10 * float(jnp.finfo(DTYPE).eps) * max(1, high))
    assert not np.any(outside(back, box))
