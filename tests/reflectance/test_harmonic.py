"""Eq. 1 in closed form: against quadrature, against itself by another way, and at the places where angles break."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from hshjax.bases import HSH, SHR, HelmholtzBasis, IsotropicBasis, SphericalHarmonics, TensorBasis, Zernike
from hshjax.bases._rotation import OBLIQUE, turn_by
from hshjax.brdfs import GGX, Lambert, LinearBRDF
from hshjax.lighting import DirectionalLight, HarmonicLight
from hshjax.reflectance import reflect
from hshjax.reflectance._harmonic_tables import restriction
from tests.helpers import DTYPE, X64, assert_close, slow_unless

CASES = {
    "HSH": (IsotropicBasis(HSH(3)), "brdf", 4),
    "foreshortened": (IsotropicBasis(HSH(4)), "foreshortened", 2),
    "half foreshortened, not bilateral": (IsotropicBasis(HSH(3), bilateral=False), "half_foreshortened", 5),
    "Helmholtz": (HelmholtzBasis(HSH(3)), "brdf", 4),
    "tensor of Zernike": (TensorBasis(Zernike(3)), "foreshortened", 3),
    "Zernike": (IsotropicBasis(Zernike(4)), "brdf", 6),
    "SHR, not bilateral": (IsotropicBasis(SHR(2), bilateral=False), "foreshortened", 3),
    "SHR under constant light": (HelmholtzBasis(SHR(2)), "brdf", 0),
    "spherical harmonics": (IsotropicBasis(SphericalHarmonics(3)), "brdf", 3),
    "constant BRDF": (IsotropicBasis(HSH(0)), "brdf", 3),
}
KEPT = ("HSH", "half foreshortened, not bilateral", "Helmholtz")
every_case = pytest.mark.parametrize("name", [slow_unless(name in KEPT, name) for name in CASES])
RELATIVE = 1e-10 if X64 else 3e-4
"""Of the largest value: in float32 both ways sum some hundred terms, and the quadrature some thousand points."""


def random(seed, *shape):
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), DTYPE)


def unit(x):
    return x / jnp.linalg.norm(x, axis=-1, keepdims=True)


def points(n=40):
    """Normals all over the sphere, poles included, each with a view on its side."""
    normals = jnp.concatenate([unit(random(0, n, 3)), jnp.asarray([[0, 0, 1.0], [0, 0, -1]], DTYPE)])
    view = unit(random(1, n + 2, 3))
    below = jnp.sum(normals * view, axis=-1, keepdims=True) < 0
    return normals, jnp.where(below, -view, view)


def case(name, channels=2):
    pairs, target, order = CASES[name]
    return LinearBRDF(pairs, random(2, pairs.count, channels), target), random(3, (order + 1) ** 2, channels)


def assert_same(found, expected):
    assert_close(found, expected, tolerance=RELATIVE * float(jnp.abs(expected).max()))


@every_case
def test_against_quadrature(name):
    """The rule is exact for both: in v, z = v², as many nodes as degrees."""
    brdf, light = case(name)
    normals, view = points()
    expected = reflect(brdf, HarmonicLight(light, degree=40), normals, view)
    assert_same(reflect(brdf, HarmonicLight(light), normals, view), expected)


@every_case
def test_an_eye_far_away(name):
    """The reflectance map, where there is one, says what the general way says."""
    brdf, light = case(name)
    normals, _ = points()
    for view in (jnp.asarray([0.0, 0, 1], DTYPE), unit(random(5, 3))):
        far = reflect(brdf, HarmonicLight(light), normals, view)
        assert_same(far, reflect(brdf, HarmonicLight(light), normals, jnp.broadcast_to(view, normals.shape)))


@pytest.mark.slow
def test_orders_of_some_size():
    pairs = IsotropicBasis(HSH(8))
    brdf, light = LinearBRDF(pairs, random(2, pairs.count, 1)), HarmonicLight(random(3, 15**2, 1))
    normals, _ = points(60)
    view = unit(random(5, 3))
    everywhere = jnp.broadcast_to(view, normals.shape)
    expected = reflect(brdf, HarmonicLight(light.coefficients, degree=44), normals, everywhere)
    assert_same(reflect(brdf, light, normals, view), expected)
    assert_same(reflect(brdf, light, normals, everywhere), expected)


@pytest.mark.skipif(not X64, reason="a property of tables in float64")
def test_restriction_then_cosine():
    """M with the cosine is M without it, of one order more, times the cosine matrix, tridiagonal for HSH."""
    basis, wider, wide = HSH(5), HSH(6), np.dtype(np.float64)
    tables, column = wider.tables(), {mode: k for k, mode in enumerate(wider.modes)}
    cosine = np.zeros((wider.count, basis.count))
    for a, (n, m) in enumerate(basis.modes):
        # x p_j = p_{j+1} / s_{j+1} - (shift / s)_{j+1} p_j + p_{j-1} / s_j, and z = (x + 1) / 2.
        j, slope, shift = n - abs(m), tables.slope[abs(m)], tables.shift[abs(m)]
        cosine[column[n + 1, m], a] = 1 / (2 * slope[j + 1])
        cosine[column[n, m], a] = (1 - shift[j + 1] / slope[j + 1]) / 2
        if j > 0:
            cosine[column[n - 1, m], a] = 1 / (2 * slope[j])
    assert_close(restriction(6, wider, 1.0, wide) @ cosine, restriction(6, basis, 0.0, wide))


def test_parts_go_their_ways():
    """Series, Lambert and multiples in closed form, GGX and a lamp not; their sum is the sum of all."""
    pairs = IsotropicBasis(HSH(2))
    parts = [LinearBRDF(pairs, random(2, pairs.count, 3)), Lambert(jnp.asarray([0.5, 0.2, 0.1], DTYPE)), GGX(0.5, 0.5)]
    lights = [HarmonicLight(random(3, 9, 1)), HarmonicLight(random(4, 4, 3)), DirectionalLight(random(5, 3), 2.0)]
    scale = jnp.asarray(0.7, DTYPE)
    brdf, light = (parts[0] + parts[1]) * scale + parts[2], lights[0] + lights[1] + lights[2]
    normals, view = points(10)
    slowly = [HarmonicLight(one.coefficients, degree=48) for one in lights[:2]]
    expected = reflect(brdf, slowly[0] + slowly[1] + lights[2], normals, view)
    assert_same(reflect(brdf, light, normals, view), expected)


def test_shapes_and_darkness():
    brdf, light = case("HSH")
    normals, view = points(6)
    dark = jnp.zeros((2, 3), DTYPE)
    for eye in (view[0], jnp.broadcast_to(view[0], (2, 3))):
        assert_close(reflect(brdf, HarmonicLight(light), dark, eye), np.zeros((2, 2)))
        away = -jnp.broadcast_to(eye, (2, 3))
        assert_close(reflect(brdf, HarmonicLight(light), away, eye), np.zeros((2, 2)))
        assert reflect(brdf, HarmonicLight(light), jnp.zeros((0, 3), DTYPE), view[0]).shape == (0, 2)
    assert reflect(brdf, HarmonicLight(light), normals[0], view[0]).shape == (2,)
    grey = HarmonicLight(light[:, :1])
    assert_same(
        reflect(brdf, grey, normals, view), reflect(brdf, HarmonicLight(jnp.tile(light[:, :1], (1, 2))), normals, view)
    )


@pytest.mark.parametrize("far", [True, False], ids=["far", "near"])
def test_blocks_and_transforms(far):
    """More points than a block holds, jit and vmap change nothing."""
    brdf, light = case("HSH")
    normals, view = points(1500 if far else 50)
    view = view[0] if far else view
    lights = jnp.stack([light, 2 * light + 1])

    def shade(light, normals, chunk=None):
        return reflect(brdf, HarmonicLight(light), normals, view, chunk=chunk)

    whole = shade(light, normals)
    # An eye far away has blocks of a size of its own; the others take as many points as they are told.
    parts = [shade(light, normals[:700]), shade(light, normals[700:])] if far else [shade(light, normals, chunk=7)]
    assert_same(jnp.concatenate(parts), whole)
    assert_same(jax.jit(shade)(light, normals), whole)
    assert_same(jax.vmap(shade, (0, None))(lights, normals)[0], whole)


@pytest.mark.parametrize("far", [True, False], ids=["far", "near"])
def test_turning_everything_changes_nothing(far):
    brdf, light = case("HSH")
    normals, view = points()
    view = view[0] if far else view
    turn = jnp.asarray(turn_by(np.array([0.3, -1.0, 2.0])), DTYPE)
    turned = reflect(brdf, HarmonicLight(light).rotated(turn), normals @ turn.T, view @ turn.T)
    before = reflect(brdf, HarmonicLight(light), normals, view)
    assert_close(turned, before, tolerance=(1e-12 if X64 else 1e-4) * float(jnp.abs(before).max()))


# --- derivatives ------------------------------------------------------------------------------------------------------


def differentiable(name, far):
    """f(BRDF's coefficients, light, normals, view), and where to look at it: poles, and where eye and normal meet."""
    pairs, target, order = CASES[name]
    normals = jnp.asarray([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0.1], [0.3, -0.4, 0.5]], DTYPE)
    view = jnp.asarray([[0.1, 0.2, 1.0], [0.3, 0.1, -1.0], [1.0, 0.4, 0.1], [0.3, -0.4, 0.5]], DTYPE)
    if far:
        normals, view = normals[jnp.asarray([0, 2, 3])], jnp.asarray([0, 0, 1.0], DTYPE)

    def f(coefficients, light, normals, view):
        coefficients, light, normals, view = map(jnp.asarray, (coefficients, light, normals, view))
        return reflect(LinearBRDF(pairs, coefficients, target), HarmonicLight(light), unit(normals), unit(view))

    return f, (random(2, pairs.count, 1), random(3, (order + 1) ** 2, 1), normals, view)


@pytest.mark.skipif(not X64, reason="differences in float64")
@pytest.mark.parametrize(
    ("name", "far", "order"),
    [
        slow_unless(True, "HSH", True, 1, id="far"),
        slow_unless(False, "HSH", False, 1, id="near"),
        slow_unless(False, "Helmholtz", False, 1, id="anisotropic"),
        slow_unless(False, "half foreshortened, not bilateral", True, 2, id="far, second"),
        slow_unless(False, "half foreshortened, not bilateral", False, 2, id="near, second"),
    ],
)
def test_derivatives_against_differences(name, far, order):
    f, arguments = differentiable(name, far)
    if name == "Helmholtz":  # whose frame jumps at z = 0, and is singular nowhere else
        arguments = (*arguments[:2], arguments[2][jnp.asarray([0, 1, 3])], arguments[3][jnp.asarray([0, 1, 3])])
    check_grads(f, arguments, order=order, modes=("fwd", "rev"), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("far", [slow_unless(True, True, id="far"), slow_unless(False, False, id="near")])
def test_no_derivative_is_nan_anywhere(far):
    """Facing away, on the horizon of the eye, along every axis and the one that is turned to, without a surface."""
    brdf, light = case("HSH")
    axis = turn_by(OBLIQUE)[2]
    normals = jnp.asarray(
        [[0, 0, -1.0], [0, 0, 1], [1, 0, 0], [0, -1, 0], [0, 0, 0], [0.6, 0, -0.8], axis, -axis], DTYPE
    )
    view = jnp.asarray([0, 0, 1.0], DTYPE) if far else jnp.tile(jnp.asarray([[0, 0, 1.0]], DTYPE), (8, 1))

    def total(coefficients, light, normals, view):
        brdf = LinearBRDF(CASES["HSH"][0], coefficients)
        return jnp.sum(reflect(brdf, HarmonicLight(light), normals, view))

    gradient = jax.grad(total, argnums=(0, 1, 2, 3))(brdf.coefficients, light, normals, view)
    assert all(np.all(np.isfinite(leaf)) for leaf in gradient)
