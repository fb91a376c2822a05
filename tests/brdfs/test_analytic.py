"""Laws of the analytic BRDFs, and their values against formulas in angles."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.brdfs import (
    ABC,
    GGX,
    BlinnPhong,
    ConductorFresnel,
    ConstantFresnel,
    CookTorrance,
    DielectricFresnel,
    Lambert,
    OrenNayar,
    ScaledBRDF,
    SchlickFresnel,
    Ward,
)
from hshjax.brdfs._microfacet import beckmann, trowbridge_reitz
from hshjax.geometry import direction
from hshjax.quadrature import hemisphere_rule
from tests.brdfs.cases import ALBEDO_EXCEPTIONS, ALL_BRDFS, FRESNELS, RGB
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close, directions, mostly_slow, slow_unless

each_brdf = pytest.mark.parametrize("brdf", ALL_BRDFS.values(), ids=ALL_BRDFS.keys())
# Every formula once; the other cases, Fresnel factors and channels, differ in what is tested elsewhere by itself.
FORMULAS = [
    name
    for name in ALL_BRDFS
    if not name.endswith("rgb") and not any(name.endswith(f"_{fresnel}") for fresnel in FRESNELS)
]
each_formula = pytest.mark.parametrize(
    "brdf", [slow_unless(name in FORMULAS, brdf, id=name) for name, brdf in ALL_BRDFS.items()]
)
each_fresnel = pytest.mark.parametrize("fresnel", FRESNELS.values(), ids=FRESNELS.keys())

# The sharpest settings that the bounds allow, for the questions of finiteness.
SHARP_BRDFS = {
    "cook_torrance_sharp": CookTorrance(0.1, 0.9, 1e-3),
    "ggx_sharp": GGX(1.0, 1e-3),
    "ggx_height_correlated_sharp": GGX(1.0, 1e-3, height_correlated=True),
    "abc_sharp": ABC(0.1, 1e3, 1e8, 10.0),
    "blinn_phong_sharp": BlinnPhong(1.0, 1000.0),
    "ward_sharp": Ward(1.0, 1e-3, 1e-2),
    "oren_nayar_full_rough": OrenNayar(1.0, math.pi / 2, full=True),
}


def unit(theta, phi=0.0):
    return direction(jnp.asarray(theta, DTYPE), jnp.asarray(phi, DTYPE))


def grazing(z, phi):
    rim = math.sqrt(1 - z * z)
    return jnp.asarray([rim * math.cos(phi), rim * math.sin(phi), z], DTYPE)


def degenerate_pairs(z):
    pole, slanted = jnp.asarray([0, 0, 1], DTYPE), unit(0.7, 0.4)
    return {
        "pole": (pole, pole),
        "one at the pole": (pole, slanted),
        "retro": (slanted, slanted),
        "mirror": (slanted, unit(0.7, 0.4 + math.pi)),
        "retro at grazing": (grazing(z, 0.3), grazing(z, 0.3)),
        "mirror at grazing": (grazing(z, 0.3), grazing(z, 0.3 + math.pi)),
        "across at grazing": (grazing(z, 0.3), grazing(z, 0.3 + math.pi / 2)),
        "pole and grazing": (pole, grazing(z, 2.0)),
        "slanted and grazing": (slanted, grazing(z, 2.0)),
    }


# --- laws -------------------------------------------------------------------------------------------------------------


@each_brdf
def test_reciprocity(brdf):
    wi, wo = directions(0, 500), directions(1, 500)
    assert_close(brdf(wi, wo), brdf(wo, wi))


@each_brdf
def test_non_negative(brdf):
    wi, wo = directions(2, 500), directions(3, 500)
    assert jnp.all(brdf(wi, wo) >= 0)
    assert jnp.any(brdf(wi, wo) > 0)


@pytest.mark.parametrize("name", mostly_slow([n for n in ALL_BRDFS if n not in ALBEDO_EXCEPTIONS], FORMULAS))
def test_directional_albedo_is_at_most_one(name):
    # Degree 400 with the substitution z = v², 401 x 401 nodes: against degree 1200 the sharpest lobe of the list (slope
    # 0.25, V-cavity kinks, 86 degrees) moves by 2e-7. Beyond, its mirror lobe is narrower than the nodes.
    rule = hemisphere_rule(400, sqrt=True, dtype=DTYPE)
    wo = jnp.stack([unit(theta, 0.3) for theta in (0.0, 0.4, 0.8, 1.1, 1.3, 1.5)])
    weight = (rule.weight * rule.w[:, 2])[:, None]
    albedo = jax.lax.map(lambda o: jnp.sum(ALL_BRDFS[name](rule.w, o) * weight, axis=0), wo)
    assert jnp.all(albedo <= 1 + (1e-6 if X64 else 1e-4))  # float32: the sum of 160 000 terms


def test_albedo_exceptions_are_as_documented():
    """Ward's original diverges towards grazing; Oren-Nayar at albedo 1 stops at the stated maxima, above 1."""
    rule = hemisphere_rule(200, sqrt=True, dtype=DTYPE)
    weight = (rule.weight * rule.w[:, 2])[:, None]

    def albedo(brdf, theta):
        return float(jnp.sum(brdf(rule.w, unit(theta)) * weight, axis=0)[0])

    ward = Ward(1.0, 0.3, 0.3, original=True)
    bounded = Ward(1.0, 0.3, 0.3)
    assert albedo(ward, 1.5707) > 5 * albedo(ward, 1.5) > 1
    assert albedo(bounded, 1.5707) < 1
    assert 1.010 < albedo(OrenNayar(1.0, 0.20), 1.5707) < 1.016
    assert 1.045 < albedo(OrenNayar(1.0, 0.32, full=True), 1.5707) < 1.051


@each_formula
def test_zero_with_zero_gradient_below_the_horizon(brdf):
    up, down = unit(0.5), jnp.asarray([0.6, 0.0, -0.8], DTYPE)
    flat = jnp.asarray([1.0, 0.0, 0.0], DTYPE)
    wi, wo = jnp.stack([up, down, down, flat, up]), jnp.stack([down, up, down, up, flat])
    assert jnp.all(brdf(wi, wo) == 0)
    gradient = jax.jit(jax.jacrev(lambda b, i, o: b(i, o), argnums=(0, 1, 2)))(brdf, wi, wo)
    assert all(jnp.all(leaf == 0) for leaf in jax.tree.leaves(gradient))


# What a formula knows of shapes, it knows by `per_channel` and `cosines`.
@pytest.mark.parametrize("name", ["lambert_rgb", "oren_nayar_full", "cook_torrance_rgb", "ward", "sum"])
def test_shapes_batches_and_transformations(name):
    brdf = ALL_BRDFS[name]
    wi, wo = directions(4, 5, 4), directions(5, 5, 4)
    value = brdf(wi, wo)
    channels = value.shape[-1]
    assert channels in (1, 3)
    assert value.shape == (5, 4, channels)
    assert value.dtype == DTYPE
    assert_close(eqx.filter_jit(brdf)(wi, wo), value)
    assert_close(jax.vmap(jax.vmap(brdf))(wi, wo), value)
    assert_close(brdf(wi[:, :1], wo[0]), brdf(jnp.broadcast_to(wi[:, :1], wi.shape), jnp.broadcast_to(wo[0], wi.shape)))
    assert brdf(wi[0, 0], wo[0, 0]).shape == (channels,)
    assert brdf(wi[:0], wo[:0]).shape == (0, 4, channels)


@pytest.mark.skipif(not X64, reason="needs float64 to compare with")
@each_formula
def test_float32_agrees(brdf):
    wi, wo = directions(6, 500, min_z=0.05), directions(7, 500, min_z=0.05)
    single = brdf(wi.astype(jnp.float32), wo.astype(jnp.float32))
    assert single.dtype == jnp.float32
    # Rounded inputs, 6e-8, times the logarithmic slope of a lobe: up to 2 tan θ_h / (m² cos²θ_h) there, a few hundred.
    assert_close(single, brdf(wi, wo), tolerance=1e-4)


@pytest.mark.skipif(not X64, reason="finite differences need float64")
@each_formula
def test_first_derivatives_against_finite_differences(brdf):
    wi, wo = directions(8, 40, min_z=0.1), directions(9, 40, min_z=0.1)
    rng = np.random.default_rng(10)
    parameters, static = eqx.partition(brdf, eqx.is_inexact_array)
    point = (parameters, wi, wo)
    # Along the sphere, as directions move; parameters move freely.
    tangent = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), point)
    tangent = (tangent[0], jnp.cross(tangent[1], wi), jnp.cross(tangent[2], wo))

    def value(point):
        parameters, wi, wo = point
        return eqx.combine(parameters, static)(wi, wo)

    def moved(step):
        return value(jax.tree.map(lambda leaf, along: leaf + step * along, point, tangent))

    _, derivative = jax.jvp(value, (point,), (tangent,))
    step = 1e-5
    differences = (8 * (moved(step) - moved(-step)) - (moved(2 * step) - moved(-2 * step))) / (12 * step)
    # Fourth-order differences: cancellation eps/step = 2e-11 times values up to about 10, and truncation.
    assert_close(derivative, differences, tolerance=1e-7)


# More channels are the same arithmetic, and Cook-Torrance stands for GGX in carrying every Fresnel factor: each Hessian
# takes seconds to compile.
DEGENERATE = [name for name in ALL_BRDFS if not name.endswith("rgb") and name.removeprefix("ggx_") not in FRESNELS]


@pytest.mark.parametrize(
    "name", mostly_slow([*DEGENERATE, *SHARP_BRDFS], ["oren_nayar_full", "cook_torrance", "ggx", "ward"])
)
def test_second_derivatives_are_finite_at_degenerate_pairs(name):
    brdf = (ALL_BRDFS | SHARP_BRDFS)[name]
    parameters, static = eqx.partition(brdf, eqx.is_inexact_array)
    leaves, structure = jax.tree.flatten((parameters, jnp.zeros(3, DTYPE), jnp.zeros(3, DTYPE)))
    sizes = np.cumsum([leaf.size for leaf in leaves])[:-1]

    def value(flat):
        parts = [part.reshape(leaf.shape) for part, leaf in zip(jnp.split(flat, sizes), leaves, strict=True)]
        parameters, wi, wo = jax.tree.unflatten(structure, parts)
        return eqx.combine(parameters, static)(wi, wo)

    def point(wi, wo):
        parts = jax.tree.leaves((parameters, wi, wo))
        return jnp.concatenate([part.astype(DTYPE).ravel() for part in parts])

    pairs = {(where, z): pair for z in (1e-3, 1e-6) for where, pair in degenerate_pairs(z).items()}
    points = jnp.stack([point(wi, wo) for wi, wo in pairs.values()])
    derivatives = (jax.jit(jax.vmap(f))(points) for f in (value, jax.jacfwd(value), jax.hessian(value)))
    for order, derivative in enumerate(derivatives):
        for (where, z), entry in zip(pairs, derivative, strict=True):
            if not X64 and z < 1e-5 and order == 2 and name in SHARP_BRDFS:
                continue  # slope 1e-3 at z = 1e-6: entries of 4e34, one division by z below float32's limit
            # In float32 a true derivative at z = 1e-6 may exceed the largest number; it may not be undefined.
            legal = jnp.isfinite(entry) if X64 or z > 1e-5 else ~jnp.isnan(entry)
            assert jnp.all(legal), f"derivative {order} at {where}, z = {z}"


@each_brdf
def test_parameters_have_bounds_and_lie_inside(brdf):
    def check(module):
        for field in dataclasses.fields(module):
            value = getattr(module, field.name)
            if isinstance(value, eqx.Module):
                check(value)
            elif eqx.is_array(value):
                low, high = field.metadata["bounds"]
                assert low < high
                assert jnp.all((value >= low) & (value <= high)), field.name

    check(brdf)
    assert any(eqx.is_inexact_array(leaf) for leaf in jax.tree.leaves(brdf))


# --- values -----------------------------------------------------------------------------------------------------------


def scalar_angles(wi, wo):
    """θ_i, θ_o, Δφ, θ_h, θ_d of one pair, by Python's own functions."""
    i, o = (np.asarray(w, np.float64) for w in (wi, wo))
    h = i + o
    h = h / np.linalg.norm(h)
    delta = math.atan2(i[1], i[0]) - math.atan2(o[1], o[0])
    return math.acos(i[2]), math.acos(o[2]), delta, math.acos(h[2]), math.acos(h @ o)


def cook_torrance(wi, wo, diffuse, specular, m):
    ti, to, _, th, td = scalar_angles(wi, wo)
    d = math.exp(-((math.tan(th) / m) ** 2)) / (math.pi * m**2 * math.cos(th) ** 4)
    g = min(1, 2 * math.cos(th) * math.cos(ti) / math.cos(td), 2 * math.cos(th) * math.cos(to) / math.cos(td))
    return diffuse / math.pi + specular * d * g / (4 * math.cos(ti) * math.cos(to))


def ggx(wi, wo, specular, alpha, height_correlated):
    ti, to, _, th, _ = scalar_angles(wi, wo)
    d = alpha**2 / (math.pi * math.cos(th) ** 4 * (alpha**2 + math.tan(th) ** 2) ** 2)
    lam = [(math.sqrt(1 + alpha**2 * math.tan(t) ** 2) - 1) / 2 for t in (ti, to)]
    g = 1 / (1 + lam[0] + lam[1]) if height_correlated else 1 / (1 + lam[0]) / (1 + lam[1])
    return specular * d * g / (4 * math.cos(ti) * math.cos(to))


def abc(wi, wo, diffuse, amplitude, b, c, eta):
    ti, to, _, th, td = scalar_angles(wi, wo)
    tt = math.asin(math.sin(td) / eta)  # refracted, Snell; then Fresnel's sines and tangents
    f = ((math.sin(td - tt) / math.sin(td + tt)) ** 2 + (math.tan(td - tt) / math.tan(td + tt)) ** 2) / 2
    g = min(1, 2 * math.cos(th) * math.cos(ti) / math.cos(td), 2 * math.cos(th) * math.cos(to) / math.cos(td))
    tail = 1 / (1 + b * (1 - math.cos(th))) ** c
    return diffuse / math.pi + amplitude * f * tail * g / (math.pi * math.cos(ti) * math.cos(to))


def oren_nayar(wi, wo, albedo, sigma, full):
    ti, to, delta, _, _ = scalar_angles(wi, wo)
    alpha, beta, v, c = max(ti, to), min(ti, to), sigma**2, math.cos(delta)
    c1 = 1 - 0.5 * v / (v + 0.33)
    c2 = 0.45 * v / (v + 0.09)
    if not full:
        return albedo / math.pi * (c1 + c2 * max(0, c) * math.sin(alpha) * math.tan(beta))
    c2 *= math.sin(alpha) - (0 if c >= 0 else (2 * beta / math.pi) ** 3)
    c3 = 0.125 * v / (v + 0.09) * (4 * alpha * beta / math.pi**2) ** 2
    first = c1 + c * c2 * math.tan(beta) + (1 - abs(c)) * c3 * math.tan((alpha + beta) / 2)
    second = 0.17 * v / (v + 0.13) * (1 - c * (2 * beta / math.pi) ** 2)
    return albedo / math.pi * first + albedo**2 / math.pi * second


def ward(wi, wo, specular, ax, ay, original):
    ti, to, _, th, td = scalar_angles(wi, wo)
    s = np.asarray(wi, np.float64) + np.asarray(wo, np.float64)
    ph = math.atan2(s[1], s[0])
    lobe = math.exp(-(math.tan(th) ** 2) * (math.cos(ph) ** 2 / ax**2 + math.sin(ph) ** 2 / ay**2))
    if original:
        return specular * lobe / (4 * math.pi * ax * ay * math.sqrt(math.cos(ti) * math.cos(to)))
    return specular * lobe / (4 * math.pi * ax * ay * math.cos(td) ** 2 * math.cos(th) ** 4)


def blinn_phong(wi, wo, specular, n):
    _, _, _, th, _ = scalar_angles(wi, wo)
    return specular * (n + 2) * (n + 4) / (8 * math.pi * (2 ** (-n / 2) + n)) * math.cos(th) ** n


@pytest.mark.parametrize(
    ("brdf", "formula", "arguments"),
    [
        (CookTorrance(0.2, 0.458, 0.25), cook_torrance, (0.2, 0.458, 0.25)),
        (GGX(0.8, 0.3), ggx, (0.8, 0.3, False)),
        (GGX(0.8, 0.3, height_correlated=True), ggx, (0.8, 0.3, True)),
        (ABC(0.2, 1.2, 40.0, 1.3, DielectricFresnel(1.8)), abc, (0.2, 1.2, 40.0, 1.3, 1.8)),
        (OrenNayar(0.8, 0.4), oren_nayar, (0.8, 0.4, False)),
        (OrenNayar(0.8, 0.4, full=True), oren_nayar, (0.8, 0.4, True)),
        (Ward(0.8, 0.2, 0.5), ward, (0.8, 0.2, 0.5, False)),
        (Ward(0.8, 0.2, 0.5, original=True), ward, (0.8, 0.2, 0.5, True)),
        (BlinnPhong(0.8, 12.5), blinn_phong, (0.8, 12.5)),
    ],
    ids=[
        "cook_torrance",
        "ggx",
        "ggx_height",
        "abc",
        "oren_nayar",
        "oren_nayar_full",
        "ward",
        "ward_original",
        "blinn_phong",
    ],
)
def test_value_against_the_formula_in_angles(brdf, formula, arguments):
    wi, wo = directions(11, 500, min_z=0.05), directions(12, 500, min_z=0.05)
    expected = [formula(i, o, *arguments) for i, o in zip(wi, wo, strict=True)]
    # float32: rounded s = wi + wo times the slope of the lobe, as above.
    assert_close(brdf(wi, wo)[:, 0], expected, tolerance=TOLERANCE if X64 else 1e-4)


@each_fresnel
@pytest.mark.parametrize("make", [lambda f: CookTorrance(0.0, 0.9, 0.3, f), lambda f: GGX(0.9, 0.3, f)])
def test_fresnel_multiplies_at_the_half_angle(fresnel, make):
    wi, wo = directions(13, 500, min_z=0.05), directions(14, 500, min_z=0.05)
    cosine = jnp.sqrt(jnp.maximum((1 + jnp.sum(wi * wo, -1)) / 2, 0))  # half-angle formula
    assert_close(make(fresnel)(wi, wo), make(ConstantFresnel())(wi, wo) * fresnel(cosine))


def test_lobes_integrate_to_one():
    """∫ D z_h dω_h = 1, on degree 400 in v² (slopes down to 0.1 are spread over many nodes)."""
    rule = hemisphere_rule(400, sqrt=True, dtype=DTYPE)
    weight = (rule.weight * rule.w[:, 2])[:, None]
    # float32 sums 160 000 terms of either sign of rounding.
    tolerance = 1e-8 if X64 else 1e-4
    for slope in (0.1, 0.3, 1.0):
        m = jnp.asarray(slope, DTYPE)
        assert_close(jnp.sum(beckmann(rule.w, m, m) * weight), 1, tolerance=tolerance)
        assert_close(jnp.sum(beckmann(rule.w, m, jnp.asarray(0.5, DTYPE)) * weight), 1, tolerance=tolerance)
        assert_close(jnp.sum(trowbridge_reitz(rule.w, m) * weight), 1, tolerance=tolerance)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 7.5, 100.0, 1000.0])
def test_blinn_phong_albedo_is_specular_at_normal_incidence_and_less_elsewhere(exponent):
    rule = hemisphere_rule(300, sqrt=True, dtype=DTYPE)
    weight = (rule.weight * rule.w[:, 2])[:, None]
    brdf = BlinnPhong(0.7, exponent)
    # float32: the sum of 90 000 terms, and n log z_h with n = 1000.
    tolerance = 1e-9 if X64 else 2e-4
    assert_close(jnp.sum(brdf(rule.w, unit(0.0)) * weight), 0.7, tolerance=tolerance)
    for theta in (0.3, 0.8, 1.3, 1.55):
        assert jnp.sum(brdf(rule.w, unit(theta)) * weight) <= 0.7 + tolerance


@pytest.mark.parametrize("full", [False, True])
def test_oren_nayar_without_roughness_is_lambert(full):
    wi, wo = directions(15, 500), directions(16, 500)
    assert_close(OrenNayar(RGB, 0.0, full=full)(wi, wo), Lambert(RGB)(wi, wo))


def test_height_correlation_shadows_less():
    wi, wo = directions(17, 500), directions(18, 500)
    assert jnp.all(
        GGX(1.0, 0.5, height_correlated=True)(wi, wo) >= GGX(1.0, 0.5)(wi, wo) * (1 - 10 * jnp.finfo(DTYPE).eps)
    )


# --- Fresnel ----------------------------------------------------------------------------------------------------------

COSINES = np.linspace(0, 1, 41)


@pytest.mark.parametrize(
    "fresnel", [slow_unless(n in ("schlick_rgb", "dielectric"), f, id=n) for n, f in FRESNELS.items()]
)
def test_fresnel_range_shapes_and_finite_derivatives(fresnel):
    cosine = jnp.asarray(COSINES, DTYPE).at[0].set(1e-6)
    value = fresnel(cosine)
    assert value.shape in ((41, 1), (41, 3))
    assert value.dtype == DTYPE
    assert jnp.all((value >= 0) & (value <= 1 + 10 * jnp.finfo(DTYPE).eps))
    assert fresnel(cosine[0]).shape == value.shape[-1:]
    for derivative in (jax.jacfwd(fresnel), jax.jacfwd(jax.jacrev(fresnel))):
        assert jnp.all(jnp.isfinite(jax.jit(jax.vmap(derivative))(cosine)))
    parameters, static = eqx.partition(fresnel, eqx.is_inexact_array)
    if not jax.tree.leaves(parameters):
        return  # the constant factor has no parameter to differentiate, and jacrev no tree to build
    gradient = jax.jit(jax.jacrev(lambda p: eqx.combine(p, static)(cosine)))(parameters)
    assert all(jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))


@pytest.mark.parametrize("eta", [0.6, 1.0, 1.5, 2.4])
def test_dielectric_closed_forms(eta):
    fresnel = DielectricFresnel(eta)

    def at(cosine):
        return float(fresnel(jnp.asarray(cosine, DTYPE))[0])

    assert_close(at(1.0), ((eta - 1) / (eta + 1)) ** 2)
    if eta != 1:
        # At Brewster's angle only the senkrecht half is left, sin²(θ_i - θ_t) with θ_i + θ_t = π/2.
        brewster = math.atan(eta)
        assert_close(at(math.cos(brewster)), math.sin(2 * brewster - math.pi / 2) ** 2 / 2)
        assert_close(at(0.0), 1)


def test_total_reflection_is_one_with_zero_gradient():
    critical = math.cos(math.asin(1 / 1.5))
    cosine = jnp.linspace(0, critical - 1e-3, 20, dtype=DTYPE)
    fresnel = DielectricFresnel(1 / 1.5)
    assert jnp.all(fresnel(cosine) == 1)
    assert jnp.all(jax.grad(lambda c: jnp.sum(fresnel(c)))(cosine) == 0)
    assert jax.grad(lambda eta: jnp.sum(DielectricFresnel(eta)(cosine)))(jnp.asarray(1 / 1.5, DTYPE)) == 0


@pytest.mark.parametrize("eta", [0.6, 1.0, 1.5, 2.4])
def test_conductor_without_absorption_is_the_dielectric(eta):
    cosine = jnp.asarray(COSINES[1:], DTYPE)
    # Both differ by rounding of eta² - sin², near 0 at the critical angle and for eta = 1, under a root: sqrt(eps).
    assert_close(ConductorFresnel(eta, 0.0)(cosine), DielectricFresnel(eta)(cosine), tolerance=1e-7 if X64 else 1e-3)


@pytest.mark.parametrize(("eta", "k"), [(0.2, 3.4), (1.45, 1.8), (2.9, 3.1), (1.5, 0.01)])
def test_conductor_against_complex_arithmetic(eta, k):
    n = complex(eta, k)
    refracted = np.sqrt(n**2 - 1 + COSINES**2 + 0j)
    senkrecht = (COSINES - refracted) / (COSINES + refracted)
    parallel = (n**2 * COSINES - refracted) / (n**2 * COSINES + refracted)
    expected = (abs(senkrecht) ** 2 + abs(parallel) ** 2) / 2
    value = ConductorFresnel(eta, k)(jnp.asarray(COSINES, DTYPE))[:, 0]
    assert_close(value, expected)
    assert_close(value[-1], ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2))


def test_schlick_ends_and_closeness_to_the_exact_curve():
    cosine = jnp.asarray(COSINES, DTYPE)
    value = SchlickFresnel(0.04)(cosine)
    assert_close(value[-1], 0.04)
    assert_close(value[0], 1)
    # Schlick's approximation of glass; its known error is a few percent of the full range.
    assert jnp.max(jnp.abs(value - DielectricFresnel(1.5)(cosine))) < 0.05


# --- construction -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Lambert(np.ones((2, 3)) / 2), "albedo"),
        (lambda: CookTorrance(RGB, RGB[:2], 0.2), "channels"),
        (lambda: CookTorrance(RGB, 0.2, RGB), "slope"),
        (lambda: Ward(0.5, 0.2, RGB), "alpha_y"),
        (lambda: ConstantFresnel(1.5), r"\[0, 1\]"),
        (lambda: SchlickFresnel(np.ones((2, 3))), "f0 of shape"),
        (lambda: DielectricFresnel(np.ones((2, 3))), "eta of shape"),
        (lambda: ConductorFresnel(np.ones(2), np.ones(3)), "channels"),
    ],
)
def test_wrong_parameters_are_told(make, message):
    # Under the tests' shape checks jaxtyping refuses a wrong rank of a scalar first, with its own error.
    with pytest.raises(Exception, match=message):
        make()


def test_ensembles_by_vmap():
    slopes = jnp.asarray([0.1, 0.2, 0.3], DTYPE)
    ensemble = eqx.filter_vmap(lambda m: CookTorrance(0.1, 0.5, m, SchlickFresnel(0.04)))(slopes)
    wi, wo = unit(0.3), unit(0.4, 2.0)
    values = eqx.filter_vmap(lambda brdf: brdf(wi, wo))(ensemble)
    expected = jnp.stack([CookTorrance(0.1, 0.5, m, SchlickFresnel(0.04))(wi, wo) for m in slopes])
    assert_close(values, expected)


@each_formula
def test_integer_directions_are_directions(brdf, unchecked):
    pole = [0, 0, 1]
    assert_close(brdf(jnp.asarray(pole), unit(0.3)), brdf(unit(0.0), unit(0.3)))
    assert_close(brdf(jnp.asarray(pole), jnp.asarray(pole)), brdf(unit(0.0), unit(0.0)))


def test_angles_in_place_of_directions_are_refused(unchecked):
    with pytest.raises(ValueError, match=r"directions are unit vectors \(\*batch, 3\), got shape \(5, 2\)"):
        Lambert(0.5)(jnp.zeros((5, 2), DTYPE), directions(0, 5))


def test_an_array_of_factors_makes_one_brdf(unchecked):
    brdf = np.array([0.1, 0.2, 0.3]) * Lambert(0.5)
    assert brdf(unit(0.2), unit(0.3)).shape == (3,)
    with pytest.raises(ValueError, match=r"scale of shape \(\) or \(channels,\), got \(2, 3\)"):
        np.ones((2, 3)) * Lambert(0.5)


def test_sums_and_multiples_are_of_brdfs(unchecked):
    with pytest.raises(ValueError, match="a multiple of a BRDF needs a BRDF, got None"):
        ScaledBRDF(None, jnp.ones(()))
