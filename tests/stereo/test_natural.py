"""Shape and light in natural illumination."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import GGX, Lambert, Ward
from hshjax.camera import OrthographicCamera, PerspectiveCamera
from hshjax.fitting import to_series
from hshjax.lighting import DirectionalLight, HarmonicLight
from hshjax.photographs import Photographs
from hshjax.reflectance import reflect
from hshjax.stereo import angular_errors, light_from_shape, solve_natural
from hshjax.stereo._inflated import Bulge, Inflated, bending
from hshjax.stereo._natural import Bend, NaturalShape, _term
from tests.helpers import DTYPE, X64, assert_close

VIEW = jnp.asarray([0, 0, 1], DTYPE)


def light(order, channels=3, seed=0):
    """A sky that is positive on average, coefficients falling with the order."""
    rng = np.random.default_rng(seed)
    degree = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)
    coefficients = rng.normal(size=(degree.size, channels)) / (1 + degree[:, None])
    coefficients[0] = 3.0
    return HarmonicLight(jnp.asarray(coefficients, DTYPE))


def ellipsoid(size=24, height=1.0):
    """Mask of a disk, and normals of z = height sqrt(R² - x² - y²)."""
    x = np.arange(size) - (size - 1) / 2
    x, y = np.meshgrid(x, -x)
    radius = 0.46 * size
    inside = x**2 + y**2 < radius**2
    z = np.sqrt(np.where(inside, radius**2 - x**2 - y**2, 0))
    normals = np.stack([height * x, height * y, z], -1)[inside]
    return inside, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def photograph(lights, height=1.0, size=24, brdf=None):
    brdf = Lambert(jnp.ones((), DTYPE)) if brdf is None else brdf
    mask, normals = ellipsoid(size, height)
    values = [np.asarray(reflect(brdf, one, jnp.asarray(normals, DTYPE), VIEW)) for one in lights]
    many = jax.vmap(HarmonicLight)(jnp.stack([one.coefficients for one in lights]))
    return Photographs(np.stack(values, 1), mask, many, None, normals)


# The outline


def test_the_dome_of_a_disk_is_its_sphere():
    mask, normals = ellipsoid(64)
    shape = Inflated.of(mask, DTYPE)
    found = angular_errors(np.asarray(shape.normals(shape.flat(3, 1))), normals)
    assert np.median(found) < 0.5
    assert np.mean(found) < 1.5  # pixels on the outline know it to half of themselves
    radius = 0.46 * 64
    assert_close(np.max(np.asarray(shape.heights(shape.flat(1)))), radius, tolerance=0.02)


def test_normals_are_those_of_heights():
    mask, _ = ellipsoid(64)
    shape = Inflated.of(mask, DTYPE)
    rng = np.random.default_rng(0)
    zero = shape.flat(2, 1)
    bulge = jax.tree.map(lambda leaf: jnp.asarray(0.1 * rng.normal(size=leaf.shape), DTYPE), zero)
    heights = np.full(mask.shape, np.nan)
    heights[mask] = np.asarray(shape.heights(bulge))
    down, right = np.gradient(heights)
    expected = np.stack([-right, down, np.ones_like(right)], -1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    middle = np.zeros_like(mask)
    middle[16:-16, 16:-16] = True
    normals = np.zeros((*mask.shape, 3))
    normals[mask] = np.asarray(shape.normals(bulge))
    assert np.max(angular_errors(normals[middle], expected[middle])) < 1.0  # second order in the pixel
    assert np.mean(angular_errors(normals[middle], expected[middle])) < 0.3


@pytest.mark.parametrize("mask", [np.eye(5, dtype=bool), np.ones((2, 4), bool), np.ones((6, 5), bool)])
def test_odd_outlines_have_finite_normals(mask):
    """Single pixels, two rows, all of the rectangle."""
    shape = Inflated.of(mask, DTYPE)
    assert np.all(np.isfinite(shape.normals(shape.flat(2, 1))))
    assert np.all(np.asarray(shape.dome) > 0)


def test_bending_does_not_see_a_plane_nor_a_turn():
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
    assert all(np.allclose(part, 0, atol=1e-5) for part in bending(jnp.asarray(2 * x - y + 1, DTYPE)))

    def energy(field):
        return sum(float(jnp.mean(part**2)) for part in bending(jnp.asarray(field, DTYPE)))

    assert_close(energy(x * y), energy((x**2 - y**2) / 2), tolerance=1e-5)


# Light from a known shape


def test_a_light_without_noise_is_found():
    sky = light(2)
    given = photograph([sky], size=40)
    found = light_from_shape(given.values[:, 0], given.truth)
    assert_close(found.light.coefficients, sky.coefficients, tolerance=1e-8 if X64 else 2e-3)
    assert np.all(found.determined == 9)
    assert_close(found.seen, np.ones((9, 3)), tolerance=1e-6)


def test_lambert_leaves_no_trace_of_odd_orders():
    sky = light(4, seed=1)
    given = photograph([sky], size=40)
    rng = np.random.default_rng(0)
    noise = 0.002 * np.sqrt(np.mean(given.values**2))
    found = light_from_shape(
        given.values[:, 0] + noise * rng.normal(size=given.values[:, 0].shape), given.truth, order=4
    )
    third = slice(9, 16)
    assert np.all(found.seen[third] < 0.5)
    assert np.all(found.determined < 25)
    assert_close(found.noise, np.full(3, noise), tolerance=0.1)
    # What light is not told is 0, and the rest explains the photograph.
    again = reflect(Lambert(jnp.ones((), DTYPE)), found.light, jnp.asarray(given.truth, DTYPE), VIEW)
    assert np.sqrt(np.mean((np.asarray(again) - given.values[:, 0]) ** 2)) < noise


def test_deviations_are_those_of_noise():
    sky = light(2)
    given = photograph([sky], size=30)
    rng = np.random.default_rng(0)
    clean, noise = given.values[:, 0], 0.02
    ratios = []
    for _ in range(30):
        found = light_from_shape(clean + noise * rng.normal(size=clean.shape), given.truth, tolerance=10.0)
        ratios.append((np.asarray(found.light.coefficients) - np.asarray(sky.coefficients)) / found.deviation)
    assert 0.9 < np.sqrt(np.mean(np.square(ratios))) < 1.1  # of 810 numbers


def test_albedo_and_unknown_values():
    sky = light(2)
    given = photograph([sky], size=40)
    rng = np.random.default_rng(0)
    albedo = rng.uniform(0.3, 1, given.values[:, 0].shape)
    values = albedo * given.values[:, 0]
    values[::7] = np.nan
    found = light_from_shape(values, given.truth, albedo=albedo)
    assert_close(found.light.coefficients, sky.coefficients, tolerance=1e-8 if X64 else 2e-3)


@pytest.mark.parametrize(
    ("values", "settings", "message"),
    [
        (np.ones((5, 1)), {}, "need more pixels"),
        (np.ones((4, 1)), {}, "values must be"),
        (np.ones((5, 1)), {"order": -1}, "order must be at least 0"),
        (np.ones((5, 1)), {"tolerance": 0.0}, "tolerance above 0"),
    ],
)
def test_what_tells_no_light_is_refused(values, settings, message, unchecked):
    with pytest.raises(ValueError, match=message):
        light_from_shape(values, np.tile([[0.0, 0, 1]], (5, 1)), **settings)


WRONG = {
    "more channels": ({"brdf": Lambert((0.5, 0.4, 0.3))}, "the BRDF must have 1 channel or 1, .* got 3"),
    "anisotropic": ({"brdf": Ward(0.1, 0.5, 0.1)}, "must be isotropic"),
    "black": ({"brdf": Lambert(0.0)}, "reflects nothing"),
    "NaN": ({"brdf": Lambert(np.nan)}, "the BRDF is not finite"),
    "albedo of channels": ({"albedo": np.ones(3)}, r"albedo must be \(\d+,\) or \(\d+, 1\), got \(3,\)"),
    "negative albedo": ({"albedo": -1.0}, "albedo must be finite and not negative"),
    "NaN albedo": ({"albedo": np.nan}, "albedo must be finite and not negative"),
}


@pytest.mark.parametrize("name", WRONG)
def test_materials_that_do_not_fit_are_refused(name):
    """Of photographs of one channel. Albedos that are numbers are of one pixel in the middle."""
    settings, message = WRONG[name]
    given = photograph([light(2, channels=1)], size=12)
    if np.ndim(settings.get("albedo", [])) == 0:
        factors = np.ones((given.pixels, 1))
        factors[given.pixels // 2] = settings["albedo"]
        settings = {"albedo": factors}
    with pytest.raises(ValueError, match=message):
        solve_natural(given, **settings)
    with pytest.raises(ValueError, match=message):
        light_from_shape(given.values[:, 0], given.truth, **settings)


# Shape


def test_gradient_is_that_of_finite_differences_while_light_is_the_best_one():
    given = photograph([light(2), light(2, seed=5)], height=0.7, size=16)
    term = _term(
        replace(given, lights=None), Inflated.of(given.mask, DTYPE), Lambert(jnp.ones((), DTYPE)), None, 2, 0.02
    )
    rng = np.random.default_rng(0)
    zero = term.shape.flat(3, 1)
    point, way = (
        jax.tree.map(lambda leaf, s=s: jnp.asarray(s * rng.normal(size=leaf.shape), DTYPE), zero) for s in (0.1, 1.0)
    )

    def loss(bulge):
        return sum(jnp.sum(part**2) for part in jax.tree.leaves(term(bulge))) / 2

    slope = sum(jnp.vdot(a, b) for a, b in zip(*map(jax.tree.leaves, (jax.grad(loss)(point), way)), strict=True))
    step = 1e-5 if X64 else 1e-3
    ahead, behind = (loss(jax.tree.map(lambda p, w, s=s: p + s * step * w, point, way)) for s in (1, -1))
    assert_close(slope / ((ahead - behind) / (2 * step)), 1.0, tolerance=1e-6 if X64 else 2e-2)


@functools.cache
def found(unknown):
    """An ellipsoid 0.6 as high as wide, from one photograph, and what was found."""
    given = photograph([light(2)], height=0.6)
    return given, solve_natural(replace(given, lights=None) if unknown else given, heights=(1.0, 0.5))


def test_shape_in_known_light():
    given, result = found(False)
    errors = angular_errors(result.normals, given.truth)
    dome = Inflated.of(given.mask, DTYPE)
    start = angular_errors(np.asarray(dome.normals(dome.flat(1)), float), given.truth)
    assert np.mean(start) > 10
    assert np.median(errors) < 2.5  # 22 pixels wide: the outline alone is known to 1.5 degrees
    assert np.mean(errors) < 0.3 * np.mean(start)
    assert result.residual < 0.05
    assert result.image(result.normals).shape == (24, 24, 3)


@pytest.mark.slow
def test_shape_and_light_both_unknown():
    """Colours tell them apart. Of domes that lie degrees apart and err by 12.1 and 4.9, both end at one shape, which is
    nearer to the truth than either (4.2), though hardly as near as the outline of so few pixels allows."""
    given, result = found(True)
    assert result.residual < 0.02
    assert result.agreeing() == 2
    assert result.spread[np.argmin(result.losses)] == 0
    assert np.max(result.spread) < 0.5
    dome = Inflated.of(given.mask, DTYPE)
    starts = [np.asarray(dome.normals(dome.flat(1, 0, height)), float) for height in (1.0, 0.5)]
    assert np.mean(angular_errors(*starts)) > 5
    errors = [float(np.mean(angular_errors(normals, given.truth))) for normals in (result.normals, *starts)]
    assert errors[0] < 0.95 * min(errors[1:])
    again = reflect(
        Lambert(jnp.ones((), DTYPE)),
        HarmonicLight(result.lights.coefficients[0]),
        jnp.asarray(result.normals, DTYPE),
        VIEW,
    )
    assert_close(again, result.prediction[:, 0], tolerance=1e-5 if X64 else 1e-3)


AXES = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""Right, up, towards: no turn that is its own inverse."""


@pytest.mark.parametrize("unknown", [False, True])
def test_a_camera_far_away_may_be_turned(unknown):
    """With the light: the world is that of the lights, and normals and lights that are found turn with it."""
    given = photograph([light(2)], height=0.6, size=16)
    camera = OrthographicCamera(AXES[2], AXES[1], height=2.2, resolution=(16, 16))
    turn = jnp.asarray(AXES.T, DTYPE)
    lights = jax.vmap(lambda one: one.rotated(turn))(given.lights)
    scenes = given, replace(given, lights=lights, camera=camera)
    if unknown:
        scenes = tuple(replace(scene, lights=None) for scene in scenes)
    plain, turned = (solve_natural(scene, heights=(0.5,), steps=20) for scene in scenes)
    # Steps are the same up to rounding of the lights.
    tolerance = 1e-6 if X64 else 1e-2
    np.testing.assert_allclose(turned.normals, plain.normals @ AXES, atol=tolerance)
    assert turned.camera is camera
    assert plain.camera is None
    assert turned.heights.shape == given.mask.shape
    assert np.array_equal(np.isfinite(turned.heights), given.mask)
    np.testing.assert_allclose(turned.heights, plain.heights, atol=16 * tolerance)  # sums of slopes over 16 pixels
    back = jax.vmap(lambda one: one.rotated(turn.T))(turned.lights)
    np.testing.assert_allclose(back.coefficients, plain.lights.coefficients, atol=3 * tolerance)
    # and what is returned is Eq. 1 in the world
    towards = jnp.asarray(AXES[2], DTYPE)
    one = HarmonicLight(turned.lights.coefficients[0])
    again = reflect(Lambert(jnp.ones((), DTYPE)), one, jnp.asarray(turned.normals, DTYPE), towards)
    assert_close(again, turned.prediction[:, 0], tolerance=1e-6 if X64 else 1e-3)


def test_starts_that_diverge_do_not_agree():
    one, lights = np.ones((1, 1)), jax.vmap(HarmonicLight)(jnp.ones((1, 9, 1)))
    losses = np.array([np.nan, 2.0, 2.02, 2.1])
    result = NaturalShape(
        np.array([[0.0, 0, 1]]), one, lights, one[None], 0.1, losses, np.zeros(4), one > 0, (), None
    )  # fmt: skip
    assert result.agreeing() == 2


def test_nothing_tells_a_shape_from_its_reflection_in_depth():
    """With light turned half around the view: exact, for glossy surfaces as well."""
    glossy = to_series(Lambert(0.5) + 0.4 * GGX(1.0, 0.5), IsotropicBasis(HSH(4)), tolerance=1e-2).model
    _, normals = ellipsoid(12, 0.8)
    normals = jnp.asarray(normals, DTYPE)
    sky, half = light(4), jnp.diag(jnp.asarray([-1, -1, 1], DTYPE))
    turned = sky.rotated(half)
    bulging = reflect(glossy, sky, normals, VIEW)
    hollow = reflect(glossy, turned, normals * jnp.asarray([[-1, -1, 1]], DTYPE), VIEW)
    assert_close(bulging, hollow, tolerance=1e-8 if X64 else 1e-4)


def test_bend_counts_pixels_as_their_share():
    """The same field on a grid twice as fine has about the same loss."""
    losses = []
    for size in (24, 48):
        shape = Inflated.of(ellipsoid(size)[0], DTYPE)
        x = np.linspace(-1, 1, size)
        field = jnp.asarray(np.cos(2 * x)[:, None] * np.cos(x), DTYPE)
        term = Bend(shape, jnp.asarray(10.0, DTYPE))
        parts = term(Bulge((field,), (jnp.zeros((size, size), DTYPE),)))
        losses.append(sum(float(jnp.sum(part**2)) for part in parts))
    assert 0.8 < losses[1] / losses[0] < 1.25


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"order": -1}, "order must be at least 0"),
        ({"noise": 0.0}, "noise must be a finite number above 0"),
        ({"bend": float("inf")}, "bend must be a finite number above 0"),
        ({"heights": ()}, "at least one dome"),
        ({"heights": (1.0, -1.0)}, "heights must be a finite number above 0"),
        ({"steps": 0}, "steps must be at least 1"),
    ],
)
def test_arguments_out_of_range_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        solve_natural(photograph([light(2)], size=12), **settings)


def test_photographs_that_tell_nothing_are_refused():
    given = photograph([light(2), light(2, seed=1)], size=12)
    black = given.values.copy()
    black[:, 1] = 0
    with pytest.raises(ValueError, match=r"photographs \[2\] are black"):
        solve_natural(replace(given, values=black))
    lamps = jax.vmap(DirectionalLight)(jnp.ones((2, 3)), jnp.ones(2))
    with pytest.raises(ValueError, match="None or HarmonicLight"):
        solve_natural(replace(given, lights=lamps))
    two = jax.vmap(HarmonicLight)(jnp.ones((2, 4, 2)))
    with pytest.raises(ValueError, match=r"lights must have 1 channel or 3, .* got 2"):
        solve_natural(replace(given, lights=two))
    near = PerspectiveCamera((0.0, 0, 5), (0.0, 0, 0), (0.0, 1, 0), field_of_view=0.5, resolution=(12, 12))
    with pytest.raises(ValueError, match="the camera must be far away"):
        solve_natural(replace(given, camera=near))


@pytest.mark.parametrize("shape", [(1, 4), (5, 1)])
def test_a_row_or_column_is_refused(shape):
    given = Photographs(np.ones((max(shape), 1, 1)), np.ones(shape, bool))
    with pytest.raises(ValueError, match="the mask must have at least 2 rows and 2 columns, got"):
        solve_natural(given)
