"""Normals, BRDF and lights refined together by gradients through Eq. 1."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, HalfVectorBasis, IsotropicBasis, LogWarp
from hshjax.brdfs import GGX, Lambert, LinearBRDF
from hshjax.brdfs._base import in_dtype
from hshjax.lighting import DirectionalLight
from hshjax.stereo import angular_errors, predict, refine_jointly, solve_calibrated
from hshjax.stereo._chart import from_chart, to_chart
from hshjax.stereo._joint import (
    Coordinates,
    InBounds,
    Material,
    NearLights,
    NearMaterial,
    NearNormals,
    Photometric,
    Unknowns,
)
from hshjax.stereo._refine_jointly import amplitudes
from hshjax.stereo._rendered import Rendered
from hshjax.stereo._shading import shading_table
from hshjax.stereo._turned import tangents
from tests.helpers import DTYPE, X64, assert_close
from tests.stereo.cases import ball, directions

QUICK = {"rounds": 2, "sweeps": 1, "pixels": 200}
FEW = {"pixels": 140, "steps": 15, "rounds": 2}


@functools.cache
def solved():
    """Photographs of a glossy ball, and what alternation makes of them."""
    photographs = ball(size=14, lights=10)
    return photographs, solve_calibrated(photographs, **QUICK)


def figures(stereo, name="joint"):
    return next(stage.figures for stage in stereo.history if stage.name == name)


def test_rendered_shading_is_what_tables_interpolate():
    brdf = Lambert(jnp.asarray(0.5, DTYPE)) + GGX(jnp.asarray(0.1, DTYPE), jnp.asarray(0.5, DTYPE))
    towards = jnp.asarray(directions(4), DTYPE)
    rendered = Rendered(brdf, towards, jnp.ones(4, DTYPE))
    pq = jnp.asarray(np.random.default_rng(0).uniform(-0.5, 0.5, (20, 2)), DTYPE)
    table = shading_table((brdf,), towards)
    assert rendered.columns == table.columns == 1
    value, slope = rendered.with_slope(pq)
    assert_close(value, table.at(pq), tolerance=1e-3)
    step = 1e-5 if X64 else 1e-2
    ahead, behind = (rendered.at(pq + jnp.asarray([[sign * step, 0]], DTYPE)) for sign in (1, -1))
    assert_close(slope[:, 0], (ahead - behind) / (2 * step), tolerance=1e-6 if X64 else 5e-3)


def coordinates(count, lights):
    """Arbitrary ones, of a model with numbers that are bounded and others."""
    rng = np.random.default_rng(3)

    def random(*shape, scale=1.0):
        return jnp.asarray(scale * rng.normal(size=shape), DTYPE)

    basis = IsotropicBasis(HSH(1))
    series = LinearBRDF(basis, jnp.asarray(0.3 + 0.05 * rng.normal(size=(basis.count, 2)), DTYPE))
    brdf = in_dtype(series + GGX(1.0, 0.4) * jnp.asarray([0.1, 0.3]), DTYPE)
    material = Material.of(brdf, amplitudes(brdf))
    towards = directions(lights)
    m = material.start.size
    return Coordinates(
        material, material.start, random(m, m, scale=0.02),
        random(count, 2, scale=0.2), random(count, 2, 2, scale=0.05), random(count, 2, m, scale=0.1),
        jnp.asarray(towards, DTYPE), jnp.asarray(tangents(towards), DTYPE),
        random(lights, scale=0.1), jnp.full((lights, 3), 0.1, DTYPE),
    )  # fmt: skip


def test_amplitudes_are_what_a_brdf_is_linear_in():
    """Not the scale of a warp, nor a roughness, nor the specular albedo that a factor multiplies already."""
    basis = HalfVectorBasis(3, LogWarp(jnp.asarray(0.1)))
    brdf = LinearBRDF(basis, jnp.ones((3, 2))) + GGX(1.0, 0.3) * jnp.ones(2)
    moving = amplitudes(brdf)
    assert sum(jax.tree.leaves(moving)) == 2
    assert moving.a.coefficients
    assert moving.b.scale


def test_gradients_are_those_of_finite_differences():
    """Weights are held where they are the best ones: the gradient of the projected loss needs no more."""
    count, lights = 5, 6
    chart = coordinates(count, lights)
    rng = np.random.default_rng(4)
    values = jnp.asarray(rng.uniform(0.2, 1, (count, lights)), DTYPE)
    trust = jnp.asarray(rng.uniform(0, 1, (count, lights)), DTYPE)
    towards, nodes = chart.directions, jnp.asarray(rng.uniform(-0.4, 0.4, (4, 2)), DTYPE)
    start = 0.9 * Rendered(chart.material.at(chart.y), towards, jnp.ones(lights, DTYPE)).at(nodes)
    root = jnp.asarray(np.linalg.cholesky(np.eye(2) + 0.3 * np.ones((count, 2, 2))), DTYPE)
    terms = [
        Photometric(values, trust, chart),
        NearMaterial(nodes, start, jnp.asarray([1.0, 2.0], DTYPE), towards, chart),
        NearNormals(chart.pq + 0.1, root, chart),
        NearLights(jnp.full((lights, 3), 0.02, DTYPE), jnp.asarray([5.0, 5.0, 2.0], DTYPE), chart),
        InBounds(chart),
    ]
    point = Unknowns(
        jnp.asarray(rng.normal(size=(count, 2)), DTYPE), jnp.asarray(rng.normal(size=chart.y.size), DTYPE),
        jnp.asarray(rng.normal(size=(lights, 3)), DTYPE),
    )  # fmt: skip
    way = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), DTYPE), point)
    step = 1e-5 if X64 else 3e-3
    for term in terms:

        def loss(unknowns, term=term):
            return jnp.sum(term(unknowns) ** 2) / 2

        slope = sum(jnp.vdot(a, b) for a, b in zip(*map(jax.tree.leaves, (jax.grad(loss)(point), way)), strict=True))
        ahead, behind = (loss(jax.tree.map(lambda p, w, s=s: p + s * step * w, point, way)) for s in (1, -1))
        assert_close(slope, (ahead - behind) / (2 * step), tolerance=1e-5 if X64 else 3e-2)


@pytest.mark.parametrize("lights", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_loss_falls_and_what_is_held_stays(lights):
    photographs, stereo = solved()
    found = refine_jointly(stereo, photographs, normals=False, lights=lights, **FEW)
    assert figures(found)["loss_end"] <= figures(found)["loss_start"]
    assert_close(found.normals, stereo.normals, tolerance=1e-5)  # once to the chart and back
    assert np.array_equal(found.lights.direction, stereo.lights.direction) != lights
    assert found.history[: len(stereo.history)] == stereo.history


@pytest.mark.slow
def test_normals_alone():
    photographs, stereo = solved()
    found = refine_jointly(stereo, photographs, brdf=False, **FEW)
    assert figures(found)["loss_end"] <= figures(found)["loss_start"]
    for a, b in zip(jax.tree.leaves(found.brdf), jax.tree.leaves(stereo.brdf), strict=True):
        assert_close(a, b, tolerance=1e-7)
    assert np.array_equal(found.lights.direction, stereo.lights.direction)
    assert np.max(angular_errors(found.normals, stereo.normals)) > 0.01


@pytest.mark.slow
def test_wrong_normals_and_weights_are_put_right():
    """Every normal is turned by 3 degrees; photographs without noise put nearly all of it right, as nothing is held."""
    photographs, stereo = solved()
    rng = np.random.default_rng(0)
    pq = np.asarray(to_chart(jnp.asarray(photographs.truth)))
    away = rng.normal(size=pq.shape)
    pq = pq + 0.026 * away / np.linalg.norm(away, axis=1, keepdims=True)
    wrong = replace(stereo, normals=np.asarray(from_chart(jnp.asarray(pq, jnp.float32))))
    found = refine_jointly(wrong, photographs, stiffness=0.0, **FEW | {"steps": 40})
    before, after = (np.mean(angular_errors(part.normals, photographs.truth)) for part in (wrong, found))
    assert before > 1.5
    assert after < 0.4 * before


@pytest.mark.slow
def test_turned_and_brighter_lights_are_put_right():
    """Two lights of ten, with normals and BRDF as the others have found them."""
    photographs, stereo = solved()
    given = photographs.lights
    direction = np.asarray(given.direction, float).copy()
    across = tangents(direction)
    direction[[2, 9]] += np.tan(np.radians(2)) * across[[2, 9], 0]
    gain = np.ones(10)
    gain[5] = 1.1
    wrong = jax.vmap(DirectionalLight)(
        jnp.asarray(direction, jnp.float32), jnp.asarray(gain * np.asarray(given.irradiance), jnp.float32)
    )
    found = refine_jointly(
        replace(stereo, lights=wrong), photographs, normals=False, brdf=False, lights=True, turns=0.05, gains=0.1, **FEW
    )
    errors = angular_errors(np.asarray(found.lights.direction), np.asarray(given.direction))
    assert np.max(errors[[2, 9]]) < 0.8  # of 2 degrees
    ratio = np.asarray(found.lights.irradiance) / np.asarray(given.irradiance)
    assert abs(ratio[5] / np.median(ratio) - 1) < 0.04  # of 0.1


@pytest.mark.slow
def test_more_functions_predict_no_worse():
    photographs, stereo = solved()
    basis = IsotropicBasis(HSH(3))
    richer = stereo.brdf + LinearBRDF(basis, jnp.zeros((basis.count, 2), jnp.float32))
    found = refine_jointly(stereo, photographs, normals=False, start=richer, **FEW)
    assert figures(found)["loss_end"] < figures(found)["loss_start"]

    def error(part):
        counts = ~(part.outliers | part.shadows)[..., None]
        return np.sqrt(np.mean(np.where(counts, predict(part) - photographs.values, 0) ** 2))

    assert error(found) < 1.05 * error(stereo)


@pytest.mark.slow
def test_a_roughness_can_be_what_moves():
    photographs, stereo = solved()

    def roughness(brdf):
        return brdf.b.brdf.roughness

    found = refine_jointly(stereo, photographs, normals=False, brdf=roughness, **FEW)
    assert figures(found)["loss_end"] <= figures(found)["loss_start"]
    assert_close(found.brdf.b.scale, stereo.brdf.b.scale, tolerance=1e-7)
    assert found.brdf.b.brdf.roughness > 0


@pytest.mark.slow
def test_bounds_hold_and_values_that_are_masked_count_for_nothing():
    photographs, stereo = solved()
    values = photographs.values.copy()
    masked = stereo.outliers.copy()
    masked[::3, 4] = True
    values[::3, 4] *= 40
    hidden = replace(stereo, outliers=masked)
    clean, spoilt = (
        refine_jointly(hidden, replace(photographs, values=v), normals=False, **FEW)
        for v in (photographs.values, values)
    )
    for leaf in (spoilt.brdf.b.scale, spoilt.brdf.a.b.scale):
        assert np.all(np.asarray(leaf) >= 0)
    # Brightness, a 90 % quantile, is not masked: one of ten values hardly moves it.
    assert np.median(angular_errors(clean.normals, spoilt.normals)) < 1e-3
    assert figures(spoilt)["loss_end"] <= figures(spoilt)["loss_start"]


@pytest.mark.slow
def test_the_same_twice():
    photographs, stereo = solved()
    first, second = (refine_jointly(stereo, photographs, normals=False, **FEW) for _ in range(2))
    for a, b in zip(jax.tree.leaves(first.brdf), jax.tree.leaves(second.brdf), strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"normals": False, "brdf": False}, "nothing is to be refined"),
        ({"rounds": 0}, "rounds must be at least 1"),
        ({"steps": 0}, "steps must be at least 1"),
        ({"pixels": 1}, "pixels must be at least 2"),
        ({"stiffness": -1.0}, "stiffness must be at least 0"),
        ({"turns": 0.0}, "turns must be above 0"),
        ({"start": Lambert(0.5)}, "1 channels, the result 2 materials"),
        ({"brdf": lambda brdf: ()}, "nothing is trainable"),
    ],
)
def test_what_makes_no_sense_is_refused(settings, message):
    photographs, stereo = solved()
    with pytest.raises(ValueError, match=message):
        refine_jointly(stereo, photographs, **settings)


def test_photographs_of_something_else_are_refused():
    photographs, stereo = solved()
    with pytest.raises(ValueError, match="another mask"):
        refine_jointly(stereo, ball(size=16, lights=10))
    with pytest.raises(ValueError, match="the result is of 10 photographs, got 12"):
        refine_jointly(stereo, ball(size=14, lights=12))
    blind = replace(stereo, outliers=np.ones_like(stereo.outliers))
    with pytest.raises(ValueError, match="masks every value"):
        refine_jointly(blind, photographs)
