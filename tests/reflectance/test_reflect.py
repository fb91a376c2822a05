"""The reflectance equation against closed forms, laws and differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from hshjax.bases import HSH, IsotropicBasis, SphericalHarmonics
from hshjax.brdfs import GGX, Lambert, LinearBRDF
from hshjax.camera import PerspectiveCamera
from hshjax.lighting import DirectionalLight, EnvironmentMap, HarmonicLight, MaskedLight, PointLight
from hshjax.reflectance import reflect
from tests.brdfs.cases import ALL_BRDFS
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close, directions, mostly_slow

UP = jnp.asarray([0, 0, 1.0], DTYPE)


def random(seed, *shape):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), DTYPE)


def sphere_directions(seed, n):
    w = np.random.default_rng(seed).normal(size=(n, 3))
    return jnp.asarray(w / np.linalg.norm(w, axis=-1, keepdims=True), DTYPE)


KINDS = ("directional", "point", "environment", "harmonic", "sum")


def lights():
    """One of each kind."""
    return {
        "directional": DirectionalLight(jnp.asarray([0.3, -0.2, 1.0], DTYPE), jnp.asarray([1.0, 2.0], DTYPE)),
        "point": PointLight(jnp.asarray([0.5, 0.2, 3.0], DTYPE), jnp.asarray([9.0, 5.0], DTYPE)),
        "environment": EnvironmentMap(1 + random(3, 6, 8, 2) ** 2, up="z"),
        "harmonic": HarmonicLight(random(4, 9, 2), degree=8),
        "sum": DirectionalLight(UP, 1.0) + HarmonicLight(random(5, 4, 2), degree=6),
    }


# --- truths -----------------------------------------------------------------------------------------------------------


def test_lambert_under_uniform_light():
    """Radiance is albedo times radiance, whichever way the surface is turned."""
    light = HarmonicLight(jnp.asarray([[2.0, 5.0]], DTYPE) * np.sqrt(4 * np.pi).astype(DTYPE))
    normals = sphere_directions(0, 20)
    radiance = reflect(Lambert(jnp.asarray([0.25, 1.0])), light, normals, normals)
    assert_close(radiance, np.broadcast_to([0.5, 5.0], (20, 2)))


def test_a_white_furnace():
    """What reflects all of a uniform light cannot be seen in it, from wherever it is seen."""
    light = HarmonicLight(jnp.full((1, 1), np.sqrt(4 * np.pi), DTYPE))
    view = directions(1, 20, min_z=0.05)
    assert_close(reflect(Lambert(jnp.asarray([1.0])), light, jnp.tile(UP, (20, 1)), view), np.ones((20, 1)))


def test_lambert_under_nine_harmonics():
    """Source: Ramamoorthi & Hanrahan, An Efficient Representation for Irradiance Environment Maps (2001), eq. 12.

    Its constants have six digits. The order of its coefficients is ours; its signs are ours, too.
    """
    light, n = HarmonicLight(random(0, 9, 1)), sphere_directions(1, 30)
    (c1, c2, c3, c4, c5), (x, y, z) = (0.429043, 0.511664, 0.743125, 0.886227, 0.247708), np.asarray(n).T
    l00, l1m1, l10, l11, l2m2, l2m1, l20, l21, l22 = np.asarray(light.coefficients)[:, 0]
    irradiance = (
        c1 * l22 * (x**2 - y**2) + c3 * l20 * z**2 + c4 * l00 - c5 * l20
        + 2 * c1 * (l2m2 * x * y + l21 * x * z + l2m1 * y * z)
        + 2 * c2 * (l11 * x + l1m1 * y + l10 * z)
    )  # fmt: skip
    radiance = reflect(Lambert(jnp.asarray([np.pi])), light, n, n)
    assert_close(radiance[:, 0], irradiance, tolerance=1e-5)


def test_lambert_under_harmonics_of_any_order():
    """The cosine lobe scales each order: π, 2π/3, π/4, 0, -π/24, 0, π/64 (same source, eq. 8)."""
    light, n = HarmonicLight(random(0, 49, 2)), sphere_directions(1, 30)
    scale = np.repeat([np.pi, 2 * np.pi / 3, np.pi / 4, 0, -np.pi / 24, 0, np.pi / 64], 2 * np.arange(7) + 1)
    expected = np.asarray(SphericalHarmonics(6)(n)) @ (scale[:, None] * np.asarray(light.coefficients))
    assert_close(reflect(Lambert(jnp.asarray([np.pi])), light, n, n), expected, tolerance=10 * TOLERANCE)


def test_one_directional_light_is_the_brdf():
    brdf, w, view = GGX(0.9, 0.3), directions(0, 10), directions(1, 10)
    for wi, wo in zip(w, view, strict=True):
        light = DirectionalLight(wi, 2.0)
        assert_close(reflect(brdf, light, UP, wo), 2 * brdf(wi, wo) * wi[2])


def test_a_point_light_far_away_is_directional():
    normals, positions = directions(0, 20), random(1, 20, 3)
    far, brdf = jnp.asarray([3.0, 4.0, 12.0], DTYPE), GGX(0.9, 0.3)
    distance = 1e6 if X64 else 1e3  # what the light's angle and distance vary by over the points, is its inverse
    near = reflect(brdf, PointLight(far / 13 * distance, distance**2), normals, UP, positions=positions)
    parallel = reflect(brdf, DirectionalLight(far, 1.0), normals, UP)
    assert_close(near, parallel, tolerance=100 / distance)


# --- laws -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", mostly_slow(KINDS, ["point", "environment", "harmonic"]))
def test_linear_in_light(name):
    light, n = lights()[name], directions(0, 7)
    where = {
        "directional": lambda light: light.irradiance,
        "point": lambda light: light.intensity,
        "environment": lambda light: light.radiance,
        "harmonic": lambda light: light.coefficients,
        "sum": lambda light: (light.a.irradiance, light.b.coefficients),
    }[name]
    scaled = eqx.tree_at(where, light, replace_fn=lambda leaf: 3 * leaf)

    def shade(light):
        return reflect(GGX(0.9, 0.4), light, n, UP, positions=n)

    assert_close(shade(scaled), 3 * shade(light))
    assert_close(shade(light + scaled), 4 * shade(light))


@pytest.mark.parametrize("name", ["directional", "point"])
def test_turning_everything_changes_nothing(name):
    turn, _ = jnp.linalg.qr(random(0, 3, 3))
    turn = turn * jnp.sign(jnp.linalg.det(turn))
    light, n, view, x = lights()[name], sphere_directions(0, 30), sphere_directions(1, 30), random(2, 30, 3)
    field = "direction" if name == "directional" else "position"
    turned = eqx.tree_at(lambda light: getattr(light, field), light, turn @ getattr(light, field))
    brdf = LinearBRDF(IsotropicBasis(HSH(3)), random(3, IsotropicBasis(HSH(3)).count, 2))
    before = reflect(brdf, light, n, view, positions=x)
    after = reflect(brdf, turned, n @ turn.T, view @ turn.T, positions=x @ turn.T)
    assert_close(after, before, tolerance=1e-12 if X64 else 1e-4)


@pytest.mark.parametrize("chunk", [1, 7, 20, 1000])
def test_chunks_change_nothing(chunk):
    light, n, x = lights()["sum"] + lights()["point"], sphere_directions(0, 20), random(1, 20, 3)
    masked = MaskedLight(light, jnp.abs(random(2, 20, light.emitters)))
    brdf = Lambert(jnp.asarray([0.5]))
    parts = [reflect(brdf, MaskedLight(light, masked.visible[k]), n[k], UP, positions=x[k]) for k in range(20)]
    assert_close(reflect(brdf, masked, n, UP, positions=x, chunk=chunk), jnp.stack(parts))


@pytest.mark.parametrize("kind", ["value", "gradient"])
def test_memory_does_not_grow_with_pairs(kind):
    """A million normals under a map of 32768 pixels, as the compiler counts it: pairs would be 10^5 times as much."""

    def radiance(brdf, radiance, normals):
        return reflect(brdf, EnvironmentMap(radiance, up="z"), normals, UP)

    def loss(brdf, light, normals):
        return jnp.mean(radiance(brdf, light, normals))

    function = {"value": radiance, "gradient": jax.grad(loss, (0, 1, 2))}[kind]
    light, normals = (jax.ShapeDtypeStruct(shape, DTYPE) for shape in ((128, 256, 3), (1024 * 1024, 3)))
    brdf = GGX(jnp.ones(3, DTYPE), jnp.asarray(0.3, DTYPE))
    found = jax.jit(function).lower(brdf, light, normals).compile().memory_analysis()
    assert found.temp_size_in_bytes + found.argument_size_in_bytes + found.output_size_in_bytes < 0.5e9


def test_shapes():
    light, brdf = lights()["harmonic"], Lambert(jnp.asarray([0.5, 0.5]))
    assert reflect(brdf, light, UP, UP).shape == (2,)
    assert reflect(brdf, light, jnp.ones((2, 3, 3), DTYPE), UP).shape == (2, 3, 2)
    assert reflect(brdf, light, jnp.zeros((0, 3), DTYPE), UP).shape == (0, 2)
    assert reflect(brdf, light, jnp.zeros((4, 3), DTYPE), UP).dtype == DTYPE
    assert_close(reflect(brdf, light, jnp.zeros((4, 3), DTYPE), UP), np.zeros((4, 2)))


@pytest.mark.parametrize("transform", ["jit", "vmap"])
def test_transforms(transform):
    n, brdf = directions(0, 5, 4), GGX(0.9, 0.4)
    many = jax.vmap(DirectionalLight)(directions(1, 5), jnp.ones((5, 2), DTYPE))

    def shade(light, n):
        return reflect(brdf, light, n, UP)

    lights = [DirectionalLight(direction, jnp.ones(2, DTYPE)) for direction in many.direction]
    if transform == "vmap":
        assert_close(jax.vmap(shade)(many, n), jnp.stack([shade(*pair) for pair in zip(lights, n, strict=True)]))
    else:
        assert_close(jax.jit(shade)(lights[0], n[0]), shade(lights[0], n[0]))


# --- derivatives ------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not X64, reason="differences in float64")
@pytest.mark.parametrize("name", mostly_slow(KINDS, ["directional", "harmonic"]))
def test_gradients_against_differences(name):
    """In the light, the material, normals and positions, away from the horizons, where the derivative jumps."""
    basis = IsotropicBasis(HSH(2))
    brdf, n, x = LinearBRDF(basis, random(3, basis.count, 2)), directions(0, 4, min_z=0.9), random(1, 4, 3)
    arrays, static = eqx.partition((brdf, lights()[name]), eqx.is_inexact_array)

    def shade(*args):
        arrays, n, x = jax.tree.map(jnp.asarray, args)  # differences are taken in numpy
        brdf, light = eqx.combine(arrays, static)
        return reflect(brdf, light, n / jnp.linalg.norm(n, axis=-1, keepdims=True), UP, positions=x, chunk=3)

    # Emitters of an environment rise and set as the normals turn; the cosine makes that continuous, not smooth.
    free = (arrays, n, x) if name in ("directional", "point") else (arrays,)
    check_grads(
        lambda *args: shade(*args, *(n, x)[len(args) - 1 :]), free, order=1, modes=("fwd", "rev"), rtol=1e-6, atol=1e-6
    )


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="differences in float64")
@pytest.mark.parametrize("name", [name for name in ALL_BRDFS if "flat" not in name and "smooth" not in name])
def test_gradients_of_every_brdf_against_differences(name):
    """In its parameters, a lamp nearby and the normals; two on a bound of theirs have no differences."""
    n, x, lamp = directions(0, 3, min_z=0.9), random(1, 3, 3) / 4, PointLight(random(2, 3).at[2].set(3), 9.0)
    arrays, static = eqx.partition((ALL_BRDFS[name], lamp), eqx.is_inexact_array)

    def shade(*args):
        arrays, n = jax.tree.map(jnp.asarray, args)
        brdf, light = eqx.combine(arrays, static)
        return reflect(brdf, light, n / jnp.linalg.norm(n, axis=-1, keepdims=True), UP, positions=x)

    check_grads(shade, (arrays, n), order=1, modes=("fwd", "rev"), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", mostly_slow(KINDS, ["directional", "point", "harmonic"]))
def test_no_derivative_is_nan_anywhere(name):
    """Facing away, on the horizon of light and eye, along the singular direction of the frame, without a surface."""
    normals = jnp.asarray([[0, 0, -1.0], [0, 0, 1], [1, 0, 0], [0, -1, 0], [0, 0, 0], [0.6, 0, -0.8]], DTYPE)
    light = lights()[name]
    arrays, static = eqx.partition((GGX(0.9, 0.3), light), eqx.is_inexact_array)

    def total(arrays, normals, view):
        brdf, light = eqx.combine(arrays, static)
        return jnp.sum(reflect(brdf, light, normals, view, positions=2 * normals))

    gradient = jax.grad(total, argnums=(0, 1, 2))(arrays, normals, UP)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))


def flash():
    """A lamp in a perspective eye, and a point without a surface: a mesh that is missed has its position there."""
    eye = jnp.asarray([0.0, 0, 4], DTYPE)
    camera = PerspectiveCamera(
        eye, jnp.zeros(3, DTYPE), jnp.asarray([0.0, 1, 0], DTYPE), field_of_view=0.5, resolution=(1, 1)
    )
    return PointLight(eye, 9.0), camera, eye


@pytest.mark.parametrize("position", ["the lamp", "nowhere"])
def test_points_without_a_surface_are_black(position):
    """Whatever is said of them, with derivatives of 0: a lamp in the eye, and positions that are not a number."""
    lamp, camera, eye = flash()
    normals = jnp.asarray([[0, 0, 0], [0, 0, 1.0]], DTYPE)
    missed = eye if position == "the lamp" else jnp.full(3, jnp.nan, DTYPE)

    def total(lamp, normals, x):
        return jnp.sum(reflect(GGX(0.9, 0.3), lamp, normals, camera, positions=x))

    with jax.debug_nans(False):
        x = jnp.stack([missed, jnp.zeros(3, DTYPE)])
        image = reflect(GGX(0.9, 0.3), lamp, normals, camera, positions=x)
        assert image[0, 0] == 0 < image[1, 0]
        gradient = jax.grad(total, (0, 1, 2))(lamp, normals, x)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))


def test_a_point_in_a_lamp_is_not_lit_by_it():
    lamp, _, eye = flash()
    assert reflect(Lambert(0.5), lamp, UP, UP, positions=eye) == 0


@pytest.mark.parametrize("light", ["directional", "harmonic", "in closed form"])
def test_what_is_not_a_number_stays_so(light):
    """A fit that has diverged must not look dark."""
    light = HarmonicLight(random(4, 9, 2)) if light == "in closed form" else lights()[light]
    normals = jnp.asarray([[jnp.nan, 0, 1], [0, 0, 1]], DTYPE)
    for view in (UP, jnp.stack([UP, UP])):
        with jax.debug_nans(False):
            image = reflect(Lambert(0.5), light, normals, view)
        assert np.all(np.isnan(image[0]))
        assert np.all(np.isfinite(image[1]))


@pytest.mark.parametrize("name", ["directional", "harmonic", "in closed form"])
def test_lengths_of_normals_and_views_do_not_count(name):
    light = HarmonicLight(random(4, 9, 2)) if name == "in closed form" else lights()[name]
    basis = IsotropicBasis(HSH(2))
    brdf, n, view = LinearBRDF(basis, random(3, basis.count, 2)), directions(0, 5), directions(1, 5)
    for v in (view, view[0]):
        expected = reflect(brdf, light, n, v)
        assert_close(reflect(brdf, light, 3 * n, 0.25 * v), expected, tolerance=1e-12 if X64 else 1e-5)


# --- refusals ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"lighting": PointLight(jnp.zeros(3), 1.0)}, "give their positions"),
        ({"view": jnp.ones((5, 3))}, r"view must have shape \(3,\) or that of the normals, \(4, 3\), got \(5, 3\)"),
        ({"positions": jnp.ones((2, 4, 3))}, "positions must have shape"),
        ({"normals": jnp.ones((4, 2))}, r"\(\*batch, 3\)"),
        ({"chunk": 0}, "chunk must be >= 1, got 0"),
        ({"lighting": jax.vmap(DirectionalLight)(jnp.ones((5, 3)), jnp.ones(5))}, r"got \(5, 3\); many lights in one"),
        ({"lighting": jax.vmap(HarmonicLight)(jnp.ones((5, 4, 1)))}, r"must have shape .* got \(5, 4, 1\)"),
    ],
    ids=["positions", "view", "other positions", "normals", "chunk", "many lamps", "many series"],
)
def test_refusals(arguments, message, unchecked):
    given = {
        "brdf": Lambert(0.5),
        "lighting": DirectionalLight(jnp.ones(3), 1.0),
        "normals": jnp.ones((4, 3)),
        "view": jnp.ones(3),
    }
    with pytest.raises(ValueError, match=message):
        reflect(**(given | arguments))
