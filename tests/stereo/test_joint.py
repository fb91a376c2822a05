"""Normals, BRDF and lights refined together by gradients through Eq. 1."""

import functools
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, HalfVectorBasis, IsotropicBasis, LogWarp
from hshjax.brdfs import GGX, Lambert, LinearBRDF
from hshjax.brdfs._base import in_dtype
from hshjax.camera import OrthographicCamera
from hshjax.lighting import DirectionalLight
from hshjax.stereo import Stereo, angular_errors, predict, refine_jointly, solve_calibrated
from hshjax.stereo._axes import camera_axes
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
    root_of,
    whitening,
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


def glossy(specular, roughness=0.35):
    """Linear in its amplitude `specular`; of the diffuse part weights of pixels tell."""
    return Lambert(0.6) + GGX(1.0, roughness) * jnp.asarray([specular], jnp.float32)


@functools.cache
def exact():
    """Photographs without noise, and the result that explains them: quick, and known to the last digit."""
    photographs = ball(glossy(0.08), size=14, lights=10)
    values = photographs.values
    blank = np.zeros(values.shape[:2], bool)
    weights = np.ones((photographs.pixels, 1, 1), np.float32)
    return photographs, Stereo(
        photographs.truth, weights, in_dtype(glossy(0.08), jnp.float32), photographs.lights, 0.0,
        np.zeros(photographs.pixels, np.float32), blank, blank, photographs.mask, (),
    )  # fmt: skip


def tilted(stereo, radius=0.026):
    """Every normal turned by 3 degrees (twice the radius, in the chart's middle), each in its own direction."""
    rng = np.random.default_rng(0)
    pq = np.asarray(to_chart(jnp.asarray(stereo.normals)))
    away = rng.normal(size=pq.shape)
    pq = pq + radius * away / np.linalg.norm(away, axis=1, keepdims=True)
    return replace(stereo, normals=np.asarray(from_chart(jnp.asarray(pq, jnp.float32))))


def assert_falls(stereo):
    """Clearly: rounds that raise the loss are dropped, so that it never rises proves nothing."""
    assert figures(stereo)["loss_end"] < 0.99 * figures(stereo)["loss_start"]


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

    @eqx.filter_jit  # all at once: compiling takes longer than anything else
    def losses(point):
        return jnp.stack([jnp.sum(term(point) ** 2) / 2 for term in terms])

    gradients = eqx.filter_jit(jax.jacrev(losses))(point)
    slopes = sum(
        jnp.sum((a * b[None]).reshape(len(terms), -1), axis=1)
        for a, b in zip(*map(jax.tree.leaves, (gradients, way)), strict=True)
    )
    ahead, behind = (losses(jax.tree.map(lambda p, w, s=s: p + s * step * w, point, way)) for s in (1, -1))
    assert_close(slopes, (ahead - behind) / (2 * step), tolerance=1e-5 if X64 else 3e-2)


@pytest.mark.slow
def test_normals_and_brdf_that_were_spoilt_are_put_right():
    photographs, right = exact()
    wrong = tilted(replace(right, brdf=in_dtype(glossy(0.12), jnp.float32)))
    found = refine_jointly(wrong, photographs, stiffness=0.0, **FEW)
    assert_falls(found)
    assert abs(found.brdf.b.scale[0] - 0.08) < 0.5 * abs(0.12 - 0.08)
    before, after = (np.mean(angular_errors(part.normals, right.normals)) for part in (wrong, found))
    assert before > 1.5
    assert after < 0.4 * before
    assert np.array_equal(found.lights.direction, right.lights.direction)
    assert [stage.name for stage in found.history] == ["joint", "follow", "reflectance"]


@pytest.mark.slow
def test_the_camera_is_that_of_the_result_and_what_is_held_stays():
    """All is turned by 120 degrees; photographs that know nothing of that are of the same object."""
    photographs, right = exact()
    camera = OrthographicCamera((1.0, 0, 0), (0.0, 0, 1), height=2.05, resolution=photographs.mask.shape)
    axes = camera_axes(camera).astype(np.float32)
    given = np.asarray(photographs.lights.direction)
    spoilt = given.copy()
    spoilt[2] += np.tan(np.radians(2)) * tangents(given.astype(float))[2, 0].astype(np.float32)
    lights = jax.vmap(DirectionalLight)(jnp.asarray(spoilt @ axes), photographs.lights.irradiance)
    wrong = replace(right, normals=right.normals @ axes, lights=lights, camera=camera)
    found = refine_jointly(wrong, photographs, normals=False, brdf=False, lights=True, turns=0.05, **FEW)
    assert_falls(found)
    assert found.camera is camera
    assert_close(found.normals, wrong.normals, tolerance=1e-5)  # once to the chart and back
    for a, b in zip(jax.tree.leaves(found.brdf), jax.tree.leaves(wrong.brdf), strict=True):
        assert_close(a, b, tolerance=1e-7)
    assert angular_errors(np.asarray(found.lights.direction), given @ axes)[2] < 0.8  # of 2 degrees


def test_photographs_say_nothing_of_what_no_light_tells():
    """What holds normals is the photographs' Hessian itself; what is added where it is inverted stays there."""
    hessian = jnp.asarray([[[4.0, 2.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]], DTYPE)  # of one direction; of none
    root = root_of(hessian)
    assert_close(root @ jnp.swapaxes(root, 1, 2), hessian)
    own = whitening(hessian)
    assert_close(own @ jnp.swapaxes(own, 1, 2), np.linalg.inv(np.asarray(hessian) + 400 * np.eye(2)))


@pytest.mark.slow
def test_normals_alone():
    photographs, right = exact()
    wrong = tilted(right)
    found = refine_jointly(wrong, photographs, brdf=False, **FEW)
    assert_falls(found)
    for a, b in zip(jax.tree.leaves(found.brdf), jax.tree.leaves(wrong.brdf), strict=True):
        assert_close(a, b, tolerance=1e-7)
    assert np.array_equal(found.lights.direction, wrong.lights.direction)
    before, after = (np.mean(angular_errors(part.normals, right.normals)) for part in (wrong, found))
    assert after < 0.75 * before  # half of it is held


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
    assert_falls(found)

    def error(part):
        counts = ~(part.outliers | part.shadows)[..., None]
        return np.sqrt(np.mean(np.where(counts, predict(part) - photographs.values, 0) ** 2))

    assert error(found) < 1.05 * error(stereo)


@pytest.mark.slow
def test_a_roughness_can_be_what_moves():
    photographs, right = exact()
    wrong = replace(right, brdf=in_dtype(glossy(0.08, 0.45), jnp.float32))
    found = refine_jointly(wrong, photographs, normals=False, brdf=lambda brdf: brdf.b.brdf.roughness, **FEW)
    assert_falls(found)
    assert_close(found.brdf.b.scale, wrong.brdf.b.scale, tolerance=1e-7)
    assert abs(found.brdf.b.brdf.roughness - 0.35) < 0.5 * abs(0.45 - 0.35)


@pytest.mark.slow
def test_values_that_are_masked_count_for_nothing():
    """Spoilt by less than residuals of the start are judged by, so that nothing but the mask leaves them out."""
    photographs, right = exact()
    wrong = replace(right, brdf=in_dtype(glossy(0.12), jnp.float32))
    values = photographs.values.copy()
    masked = values[..., 0] < np.median(values[..., 0], axis=1, keepdims=True)  # brightness, a 90 % quantile, stays
    values[masked] *= 0.93
    clean, spoilt, unmasked = (
        refine_jointly(replace(wrong, outliers=mask), replace(photographs, values=v), normals=False, **FEW)
        for mask, v in ((masked, photographs.values), (masked, values), (np.zeros_like(masked), values))
    )
    assert_falls(clean)
    a, b, c = (float(part.brdf.b.scale[0]) for part in (clean, spoilt, unmasked))
    assert abs(a - 0.08) < 0.5 * abs(0.12 - 0.08)
    assert abs(a - b) < 0.01 * abs(a - 0.12)
    assert abs(c - b) > 0.05 * abs(a - 0.12)


@pytest.mark.slow
def test_bounds_hold_and_histories_go_on():
    photographs, stereo = solved()
    found = refine_jointly(stereo, photographs, normals=False, **FEW)
    assert found.history[: len(stereo.history)] == stereo.history
    for leaf in (found.brdf.b.scale, found.brdf.a.b.scale):
        assert np.all(np.asarray(leaf) >= 0)


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
        ({"start": GGX(jnp.asarray([0.5, 0.3]), 0.3)}, "2 channels, the result 1 materials"),
        ({"start": GGX(0.5, 0.3), "normals": False}, "nothing is to be refined: .* pick parts with brdf="),
        ({"brdf": lambda brdf: ()}, "nothing is trainable"),
    ],
)
def test_what_makes_no_sense_is_refused(settings, message):
    photographs, stereo = exact()
    with pytest.raises(ValueError, match=message):
        refine_jointly(stereo, photographs, **settings)


def test_photographs_of_something_else_are_refused():
    photographs, stereo = exact()
    with pytest.raises(ValueError, match="another mask"):
        refine_jointly(stereo, ball(size=16, lights=10))
    with pytest.raises(ValueError, match="the result is of 10 photographs, got 12"):
        refine_jointly(stereo, ball(size=14, lights=12))
    blind = replace(stereo, outliers=np.ones_like(stereo.outliers))
    with pytest.raises(ValueError, match="masks every value"):
        refine_jointly(blind, photographs)
