"""The material of Mitsuba 3 against the library's own evaluation; without Mitsuba, what is said about it."""

import importlib.util
import os
from functools import lru_cache
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
import hshjax.io.mitsuba
from experiments import peers
from hshjax.io import save_model
from hshjax.metrics import albedo
from tests.helpers import DTYPE, directions, mostly_slow, slow_unless
from tests.io.renderers import linear, models

MODELS = models()

needs_mitsuba = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None, reason='Mitsuba 3: pip install "hshjax[mitsuba]"'
)


@pytest.mark.skipif(importlib.util.find_spec("mitsuba") is not None, reason="Mitsuba is there")
def test_without_mitsuba_the_extra_is_named():
    with pytest.raises(ImportError, match=r"hshjax\[mitsuba\]"):
        hshjax.io.mitsuba.register()


@pytest.fixture
def choose():
    """A function that switches Mitsuba to a variant and returns its modules; skips where LLVM is missing."""

    def chosen(variant):
        if variant.startswith("llvm"):
            try:
                os.environ.setdefault("DRJIT_LIBLLVM_PATH", peers.llvm_library())
            except peers.PeerUnavailableError as error:
                pytest.skip(str(error))
        import drjit as dr
        import mitsuba as mi

        hshjax.io.mitsuba.register()
        mi.set_variant(variant)
        return SimpleNamespace(mi=mi, dr=dr)

    return chosen


def material(mitsuba, model, folder, **parameters):
    path = folder / "model.hshjax"
    save_model(path, model)
    return mitsuba.mi.load_dict({"type": "hshjax", "filename": str(path)} | parameters)


def interaction(mitsuba, wi):
    """Seen from `wi`, `(n, 3)`, or `(3,)` in scalar variants."""
    si = mitsuba.dr.zeros(mitsuba.mi.SurfaceInteraction3f, *wi.shape[:-1])
    si.wi = vector(mitsuba, wi)
    return si


def vector(mitsuba, w):
    w = np.asarray(w, np.float32).T
    return mitsuba.mi.Vector3f(w) if w.ndim > 1 else mitsuba.mi.Vector3f(*map(float, w))


def seen(model, eye, light, clamp=True):
    """ρ cos θ of the light, as Mitsuba counts it: paths arrive from the eye, whatever is called wi there."""
    value = np.asarray(model(jnp.asarray(light, DTYPE), jnp.asarray(eye, DTYPE)), float)
    return (np.maximum(value, 0) if clamp else value) * np.asarray(light, float)[..., 2:]


def assert_single(found, expected):
    """To 1e-5 of the largest value: in single precision, sums of terms of both signs."""
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


@needs_mitsuba
@pytest.mark.parametrize("name", mostly_slow(MODELS, ("hsh", "helmholtz", "tensor", "compact")))
def test_values_are_those_of_the_library(name, choose, tmp_path):
    mitsuba = choose("llvm_ad_rgb")
    eye, light = (np.asarray(directions(k, 500, min_z=0.02), np.float32) for k in (5, 6))
    context = mitsuba.mi.BSDFContext()
    for clamp in (True, False):
        bsdf = material(mitsuba, MODELS[name], tmp_path, clamp=clamp)
        value = bsdf.eval(context, interaction(mitsuba, eye), vector(mitsuba, light))
        expected = np.broadcast_to(seen(MODELS[name], eye, light, clamp), (500, 3))
        assert_single(np.array(value).T, expected)
    context.mode = mitsuba.mi.TransportMode.Importance
    value = bsdf.eval(context, interaction(mitsuba, light), vector(mitsuba, eye))
    # From the light on, Mitsuba's cosine is that of the eye.
    assert_single(np.array(value).T * light[:, 2:] / eye[:, 2:], expected)


@needs_mitsuba
@pytest.mark.parametrize("name", mostly_slow(MODELS, ("hsh", "compact")))
def test_scalar_variants_agree(name, choose, tmp_path):
    mitsuba = choose("scalar_rgb")
    bsdf, context = material(mitsuba, MODELS[name], tmp_path), mitsuba.mi.BSDFContext()
    eye, light = (np.asarray(directions(k, 8, min_z=0.02), np.float32) for k in (5, 6))
    samples = np.random.default_rng(0).uniform(size=(8, 3))
    for one, other, (first, *rest) in zip(eye, light, samples, strict=True):
        si, wo = interaction(mitsuba, one), vector(mitsuba, other)
        assert_single(np.array(bsdf.eval(context, si, wo)), np.broadcast_to(seen(MODELS[name], one, other), 3))
        sample, weight = bsdf.sample(context, si, first, mitsuba.mi.Point2f(*rest))
        value, density = bsdf.eval_pdf(context, si, sample.wo)
        assert density == pytest.approx(sample.pdf, rel=1e-3)
        np.testing.assert_allclose(np.array(weight) * density, np.array(value), rtol=1e-3)


@needs_mitsuba
@pytest.mark.parametrize("z", [(-0.5, 0.5), (0.5, -0.5), (0.0, 0.5), (0.5, 0.0)])
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_nothing_is_reflected_below_the_horizon(z, variant, choose, tmp_path):
    mitsuba = choose(variant)
    bsdf, context = material(mitsuba, MODELS["hsh"], tmp_path), mitsuba.mi.BSDFContext()
    eye, light = (np.array([np.sqrt(1 - c * c), 0, c]) for c in z)
    si, wo = interaction(mitsuba, eye), vector(mitsuba, light)
    value, density = bsdf.eval_pdf(context, si, wo)
    assert np.all(np.array(value) == 0)
    assert np.all(np.array(density) == 0)
    if z[0] <= 0:
        sample, weight = bsdf.sample(context, si, 0.3, mitsuba.mi.Point2f(0.2, 0.6))
        assert np.all(np.array(weight) == 0)
        assert np.all(np.array(sample.pdf) == 0)


@needs_mitsuba
@pytest.mark.parametrize(
    ("name", "sampling", "cosine"),
    [
        slow_unless(cosine == 0.15, name, sampling, cosine)
        for name, sampling in (("glossy", "lobe"), ("glossy", "cosine"), ("rough", "lobe"))
        for cosine in (0.15, 0.6, 1.0)
    ],
)
def test_directions_follow_their_density_and_weights_have_the_mean_of_the_albedo(
    name, sampling, cosine, choose, tmp_path
):
    mitsuba = choose("llvm_ad_rgb")
    mi, dr = mitsuba.mi, mitsuba.dr
    model = glossy(0.15 if name == "glossy" else 0.6)
    bsdf = material(mitsuba, model, tmp_path, sampling=sampling)
    wi = [float(np.sqrt(1 - cosine**2)), 0.0, cosine]
    context = mi.BSDFContext()

    def at(n):
        si = dr.zeros(mi.SurfaceInteraction3f, n)
        si.wi = mi.Vector3f(*wi)
        return si

    def sample(points):
        drawn, _ = bsdf.sample(context, at(dr.width(points)), points[0], mi.Point2f(points[1], points[2]))
        return drawn.wo, dr.select(drawn.pdf > 0, 1.0, 0.0)

    test = mi.chi2.ChiSquareTest(
        mi.chi2.SphericalDomain(), sample, lambda wo: bsdf.pdf(context, at(dr.width(wo)), wo), sample_dim=3,
        sample_count=200_000, res=61, ires=16,
    )  # fmt: skip
    assert test.run(quiet=True), test.messages  # includes that the density integrates to 1

    n = 200_000
    u = mi.Float(np.random.default_rng(3).uniform(size=n)), np.random.default_rng(4).uniform(size=(2, n))
    drawn, weight = bsdf.sample(context, at(n), u[0], mi.Point2f(u[1].astype(np.float32)))
    weights = np.array(weight).T
    error = weights.std(0) / np.sqrt(n)
    expected = np.asarray(albedo(model, jnp.asarray(wi, DTYPE), hshjax.hemisphere_rule(400)))
    assert np.all(np.abs(weights.mean(0) - expected) < 4 * error + 1e-4), (weights.mean(0), expected, error)
    value, density = bsdf.eval_pdf(context, at(n), drawn.wo)
    # Near mirrors a density amplifies what single precision loses of the half vector.
    inside = np.array(drawn.pdf) > 1e-3
    np.testing.assert_allclose(np.array(density)[inside], np.array(drawn.pdf)[inside], rtol=5e-3)
    np.testing.assert_allclose(
        (weights * np.array(drawn.pdf)[:, None])[inside], np.array(value).T[inside], rtol=5e-3, atol=1e-5
    )


@lru_cache
def glossy(alpha):
    """A positive model with a lobe: a compact one of GGX over a diffuse base."""
    specular, diffuse = (jnp.asarray(rgb, DTYPE) for rgb in ((0.5, 0.4, 0.3), (0.1, 0.2, 0.3)))
    return hshjax.fit_compact(hshjax.GGX(specular, alpha) + hshjax.Lambert(diffuse), 40).model


@needs_mitsuba
def test_coefficients_can_be_read_differentiated_and_changed(choose, tmp_path):
    mitsuba = choose("llvm_ad_rgb")
    mi, dr = mitsuba.mi, mitsuba.dr
    model = MODELS["hsh"]
    bsdf = material(mitsuba, model, tmp_path, clamp=False)
    parameters = mi.traverse(bsdf)
    np.testing.assert_allclose(parameters["coefficients"], np.asarray(model.coefficients).ravel(), rtol=1e-6)
    eye, light = (np.asarray(directions(k, 3, min_z=0.1), np.float32) for k in (7, 8))
    dr.enable_grad(parameters["coefficients"])
    value = bsdf.eval(mi.BSDFContext(), interaction(mitsuba, eye), vector(mitsuba, light))
    dr.backward(dr.sum(value.y))
    rows = np.asarray(model.basis(jnp.asarray(light), jnp.asarray(eye))) * light[:, 2:]
    gradient = np.array(dr.grad(parameters["coefficients"])).reshape(-1, 3)
    assert_single(gradient[:, 1], rows.sum(0))
    assert np.all(gradient[:, [0, 2]] == 0)
    parameters["coefficients"] = mi.Float(2 * np.asarray(model.coefficients, np.float32).ravel())
    parameters.update()
    value = bsdf.eval(mi.BSDFContext(), interaction(mitsuba, eye), vector(mitsuba, light))
    assert_single(np.array(value).T, 2 * seen(model, eye, light, clamp=False))


@needs_mitsuba
def test_colours_of_other_variants(choose, tmp_path):
    eye, light = (np.asarray(directions(k, 5, min_z=0.1), np.float32) for k in (7, 8))
    mitsuba = choose("llvm_ad_mono")
    bsdf = material(mitsuba, MODELS["hsh"], tmp_path)
    value = bsdf.eval(mitsuba.mi.BSDFContext(), interaction(mitsuba, eye), vector(mitsuba, light))
    luminance = seen(MODELS["hsh"], eye, light) @ (0.212671, 0.715160, 0.072169)
    assert_single(np.array(value).ravel(), luminance)
    for variant in ("llvm_ad_spectral", "scalar_spectral"):
        mitsuba = choose(variant)
        with pytest.raises(RuntimeError, match=f"1 channel in {variant}, got 3"):
            material(mitsuba, MODELS["hsh"], tmp_path)
    mitsuba = choose("llvm_ad_spectral")
    bsdf = material(mitsuba, MODELS["shr grey"], tmp_path)
    value = bsdf.eval(mitsuba.mi.BSDFContext(), interaction(mitsuba, eye), vector(mitsuba, light))
    assert_single(np.array(value).T, np.broadcast_to(seen(MODELS["shr grey"], eye, light), (5, 4)))
    mitsuba = choose("scalar_spectral_polarized")
    with pytest.raises(RuntimeError, match="no polarisation"):
        material(mitsuba, MODELS["shr grey"], tmp_path)


@needs_mitsuba
@pytest.mark.parametrize(
    ("model", "parameters", "message"),
    [
        (hshjax.Lambert(0.5), {}, "got Lambert"),
        (linear(hshjax.IsotropicBasis(hshjax.HSH(1)), channels=2), {}, "1 or 3 channels in scalar_rgb, got 2"),
        (MODELS["hsh"], {"sampling": "uniform"}, '"lobe" or "cosine", got'),
        (MODELS["hsh"], {"roughness": 0.1}, "roughness"),
    ],
    ids=["analytic", "two channels", "sampling", "unknown"],
)
def test_what_cannot_be_rendered_is_refused(model, parameters, message, choose, tmp_path):
    mitsuba = choose("scalar_rgb")
    with pytest.raises(RuntimeError, match=message):
        material(mitsuba, model, tmp_path, **parameters)


@needs_mitsuba
def test_a_file_that_is_no_model_is_named(choose, tmp_path):
    mitsuba = choose("scalar_rgb")
    (tmp_path / "no.hshjax").write_text("nothing")
    with pytest.raises(RuntimeError, match="hshjax: line 1: expected"):
        mitsuba.mi.load_dict({"type": "hshjax", "filename": str(tmp_path / "no.hshjax")})


@needs_mitsuba
def test_a_material_says_what_it_is(choose, tmp_path):
    mitsuba = choose("scalar_rgb")
    text = str(material(mitsuba, MODELS["helmholtz"], tmp_path))
    assert "series in HelmholtzBasis(HSH(order=2)), 45 functions, 3 channels" in text
    assert "smallest value met = " in text
