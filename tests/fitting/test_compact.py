"""Compact fits: what they promise of materials that are known, and of data that are not good."""

import re

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HalfVectorBasis, LogWarp
from hshjax.brdfs import GGX, Lambert, LogLinearBRDF
from hshjax.fitting import Outcome, fit_compact, fit_compact_all, half_vector_samples
from hshjax.fitting._blocks import evaluated
from hshjax.fitting._compact import ALPHAS
from hshjax.fitting._furnace import furnace_rule
from hshjax.fitting._least_distance import InfeasibleError
from hshjax.geometry import direction
from hshjax.io import save_model
from hshjax.metrics import albedo
from hshjax.quadrature import hemisphere_rule
from hshjax.samples import Samples
from tests.helpers import X64, directions

pytestmark = pytest.mark.skipif(not X64, reason="found on the host in float64, whatever the leg")

SHAPE = (24, 10, 4)
PLASTIC = Lambert([0.3, 0.1, 0.05]) + 0.1 * GGX(1.0, 0.1)


def plastic():
    return half_vector_samples(PLASTIC, shape=SHAPE)


def far_and_near():
    """A dense set of pairs, up to the horizon."""
    return directions(0, 20000), directions(1, 20000)


def test_samples_follow_the_highlight_and_are_folded():
    """Means over the swap and the mirror image; cells of equal width in sqrt(θ_h)."""

    def crooked(wi, wo):
        return (1 + wi[:, 2:] + 0.5 * (wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0])[:, None]) * jnp.ones((1, 2))

    samples = half_vector_samples(crooked, shape=SHAPE)
    mean = 1 + (samples.wi[:, 2:] + samples.wo[:, 2:]) / 2
    np.testing.assert_allclose(samples.value, np.repeat(mean, 2, axis=1), rtol=1e-12)
    half = samples.wi + samples.wo
    theta = np.arccos(np.minimum(half[:, 2] / np.linalg.norm(half, axis=1), 1))
    cells = np.sqrt(2 * theta / np.pi) * SHAPE[0] - 0.5
    np.testing.assert_allclose(cells, np.round(cells), atol=1e-5)
    lowest = np.minimum(samples.wi[:, 2], samples.wo[:, 2])
    assert lowest.min() > np.cos(np.radians(89.5))
    np.testing.assert_array_equal(samples.weight, np.where(lowest > np.cos(np.radians(80)), 1, 0.05))
    assert half_vector_samples(crooked, shape=SHAPE, grazing=0.0).size == np.sum(lowest > np.cos(np.radians(80)))
    assert samples.isotropic


def test_a_model_is_found_again():
    """ρ in the span, its scale among those tried: to the ridge."""
    rng = np.random.default_rng(0)
    basis = HalfVectorBasis(20, LogWarp(jnp.asarray(1e-3)))
    truth = LogLinearBRDF(basis, [jnp.asarray(0.2 * rng.normal(size=n)) for n in (20, 5, 5)])
    found = fit_compact(half_vector_samples(truth, shape=SHAPE), 30, energy=False)  # it reflects more than it gets
    assert found.alpha == pytest.approx(1e-3)
    assert found.model.count == 30
    assert found.log_error < 1e-5
    np.testing.assert_allclose(found.model.matrix[:20], truth.matrix, atol=1e-3)
    assert np.all(found.model.matrix[20:] == 0)


@pytest.mark.slow
def test_more_coefficients_tell_more():
    samples = plastic()
    errors = [fit_compact(samples, n).log_error for n in (10, 25, 60)]
    assert errors[0] > 2 * errors[1] > 4 * errors[2]
    assert errors[2] < 0.003


def test_the_error_is_what_it_says():
    samples = plastic()
    found = fit_compact(samples, 25)
    difference = 0
    for w in (samples.wi, samples.wo):
        z = np.asarray(w[:, 2:])
        fitted = np.asarray(found.model(samples.wi, samples.wo))
        errors = np.abs(np.log1p(z * np.asarray(samples.value)) - np.log1p(z * fitted))
        difference += np.average(errors.mean(axis=1), weights=np.asarray(samples.weight)) / 2
    assert found.log_error == pytest.approx(difference, rel=1e-9)
    assert found.losses.shape == (len(found.alphas),)


def test_many_materials_are_fitted_as_one_by_one():
    both = [plastic(), half_vector_samples(GGX([0.9, 0.6, 0.3], 0.3), shape=SHAPE)]
    for one, together in zip(both, fit_compact_all(both, 25), strict=True):
        alone = fit_compact(one, 25)
        assert alone.alpha == together.alpha
        np.testing.assert_array_equal(alone.model.terms, together.model.terms)
        np.testing.assert_allclose(alone.model.coefficients, together.model.coefficients, rtol=1e-6, atol=1e-8)


def glossy():
    """Reflects 1.15 at 60 degrees and beyond, in the first channel; the second conserves energy."""
    return Lambert([0.95, 0.2]) + GGX([0.2, 0.2], 0.2)


def albedos(brdf):
    """By an independent rule, up to 80 degrees."""
    wo = direction(jnp.radians(jnp.linspace(0.0, 80, 9)), jnp.zeros(9))
    return np.asarray(albedo(brdf, wo, hemisphere_rule(200)))


@pytest.mark.slow
def test_energy_is_conserved_where_it_was_not():
    """Least squares under the constraint: albedos of at most 1, at little more error than without."""
    samples = half_vector_samples(glossy(), shape=SHAPE)
    free, held = fit_compact(samples, 40, energy=False), fit_compact(samples, 40)
    assert albedos(glossy()).max() > 1.1
    assert free.albedo > 1.1
    assert held.albedo <= 1
    assert albedos(free.model).max() == pytest.approx(free.albedo, rel=0.01)
    assert albedos(held.model).max() < 1.005
    assert free.log_error < held.log_error < 0.05
    tame = half_vector_samples(PLASTIC, shape=SHAPE)
    np.testing.assert_array_equal(
        fit_compact(tame, 25).model.coefficients, fit_compact(tame, 25, energy=False).model.coefficients
    )


def test_grazing_angles_do_not_run_away():
    """A sharp highlight, all of the hemisphere: what is reflected is what the material reflects."""
    brdf = Lambert([0.3]) + GGX([0.05], 0.02)
    found = fit_compact(brdf, 60)
    np.testing.assert_allclose(found.albedo, albedos(brdf).max(), rtol=0.05)


def test_blocks_change_nothing(monkeypatch):
    samples = plastic()
    whole = fit_compact(samples, 25)
    monkeypatch.setattr("hshjax.fitting._compact_rows.BLOCK", 100)
    parts = fit_compact(samples, 25)
    np.testing.assert_allclose(parts.losses, whole.losses, rtol=1e-6)
    np.testing.assert_allclose(parts.model.coefficients, whole.model.coefficients, rtol=1e-4, atol=1e-6)


def scattered(n=600, **changes):
    given = {"wi": directions(5, n), "wo": directions(6, n)} | changes
    value = changes.get("value", PLASTIC(given["wi"], given["wo"]))
    return Samples.scattered(given["wi"], given["wo"], value, isotropic=True)


def mirrored(w):
    return w.at[:, :2].multiply(-1)


POOR = {
    "scattered": lambda: scattered(),
    "a sliver": lambda: scattered(wi=directions(5, 600, min_z=0.98), wo=directions(6, 600, min_z=0.98)),
    "one incidence": lambda: scattered(wi=jnp.broadcast_to(jnp.asarray([0.6, 0, 0.8]), (600, 3))),
    "constant": lambda: scattered(value=jnp.full((600, 3), 0.2)),
    "negative values": lambda: scattered(value=jnp.asarray(np.random.default_rng(0).normal(0.1, 0.2, (600, 3)))),
    "one channel": lambda: scattered(value=GGX(1.0, 0.2)(directions(5, 600), directions(6, 600))),
    "thirty": lambda: scattered(n=30),
    "back to the light": lambda: scattered(wo=directions(5, 600)),
    "mirror directions": lambda: scattered(wo=mirrored(directions(5, 600))),
}


@pytest.mark.parametrize("case", POOR)
def test_poor_data_do_not_explode(case):
    """Nowhere, up to the horizon, beyond three times the largest value, nor below a third of the least that counts."""
    samples = POOR[case]()
    found = fit_compact(samples, 30)
    more = np.asarray(fit_compact(samples, 60).model(*far_and_near())) if case != "thirty" else np.zeros(1)
    assert np.all(np.isfinite(more))
    assert more.max() < 3 * float(samples.value.max())
    value = np.asarray(found.model(*far_and_near()))
    assert np.all(np.isfinite(value))
    assert value.max() < 3 * float(samples.value.max())
    # Where all that was seen is bright, energy brings the bound down to 1/2π.
    assert value.min() > min(max(float(samples.value.min()), 1e-4) / 3, 0.159)
    assert (found.floored > 0) == (case == "negative values")


@pytest.mark.parametrize(
    ("samples", "settings", "message"),
    [
        (lambda: scattered(value=jnp.zeros((600, 3))), {}, "material 0 is black"),
        (lambda: scattered(value=jnp.full((600, 3), jnp.inf)), {}, "600 of 600 samples .* hold NaN or infinite values"),
        (lambda: scattered(wi=-directions(5, 600)), {}, "600 of 600 samples .* below the horizon"),
        (lambda: scattered(n=10), {}, "10 samples do not determine 20 functions of 30 coefficients"),
        (lambda: scattered(), {"alphas": [0.0]}, "scales are positive"),
        (lambda: scattered(), {"dark": 0.0}, "dark must be > 0"),
        (lambda: scattered(), {"mixing": np.ones((2, 2))}, r"shape \(components, 3\), got \(2, 2\)"),
    ],
    ids=["black", "infinite", "below", "too few", "a scale of 0", "dark", "mixing"],
)
def test_refusals(samples, settings, message, unchecked):
    with pytest.raises(ValueError, match=message):
        fit_compact(samples(), 30, **settings)


def batch():
    """Two materials that can be fitted, and between and beside them some that cannot: a number, and why."""
    good = [scattered(), scattered(value=2 * scattered().value)]
    spoilt = scattered().value.at[7, 1].set(jnp.nan)
    bad = {
        0: (scattered(value=jnp.zeros((600, 3))), "is black"),
        2: (scattered(value=spoilt), "1 of 600 samples .* hold NaN .*the first is sample 7"),
        3: (scattered(n=500), "differs from material 1 in its directions"),
        5: (scattered(value=scattered().value[:, :2]), "differs from material 1 .* channels"),
    }
    rest = iter(good)
    return [bad[k][0] if k in bad else next(rest) for k in range(6)], good, {k: why for k, (_, why) in bad.items()}


def test_one_bad_material_is_named(unchecked):
    samples, _, bad = batch()
    for k, why in bad.items():
        why = why.replace("material 1", "material 0")
        with pytest.raises(ValueError, match=rf"^material 1 (cannot be fitted: )?{why}"):
            fit_compact_all([samples[1], samples[k]], 25)
    with pytest.raises(ValueError, match=r"material 0 is black.*; material 2 .*; material 3 .*; and 1 more$"):
        fit_compact_all(samples, 25)


def test_the_others_are_kept(unchecked):
    """The same as by themselves, in their places; what is wrong stands where nothing could be fitted."""
    samples, good, bad = batch()
    found = fit_compact_all(samples, 25, throw=False)
    assert len(found) == 6
    for k, alone in zip((1, 4), fit_compact_all(good, 25), strict=True):
        assert found[k].result == Outcome.converged
        assert found[k].message == "converged"
        np.testing.assert_array_equal(found[k].model.coefficients, alone.model.coefficients)
        assert found[k].log_error == alone.log_error
    for k, why in bad.items():
        assert found[k].result == Outcome.unusable
        assert re.match(rf"material {k} (cannot be fitted: )?{why}", found[k].message)
        assert np.isnan(found[k].log_error)
        assert found[k].samples == 0
        assert found[k].model.count == 25
        assert np.all(np.isnan(found[k].model(*directions_of(good[0]))))
    with pytest.raises(ValueError, match=r"material 0 is black.*; material 1 is black"):
        fit_compact_all([samples[0], samples[0]], 25, throw=False)


def test_an_albedo_that_cannot_be_held_is_no_loss(monkeypatch):
    """Of the others; the fit without the constraint is there, and says so."""

    def infeasible(*_):
        raise InfeasibleError("no point satisfies all inequalities")

    monkeypatch.setattr("hshjax.fitting._compact_equations.conserved", infeasible)
    tame = Lambert([0.3, 0.2]) + 0.1 * GGX(1.0, 0.2)
    both = [half_vector_samples(brdf, shape=SHAPE) for brdf in (glossy(), tame)]
    with pytest.raises(ValueError, match=r"material 0 has an albedo of 1\.\d+, and no coefficients .* energy=False"):
        fit_compact_all(both, 25)
    found, other = fit_compact_all(both, 25, throw=False)
    assert found.result == Outcome.uncertified
    assert "material 0 has an albedo" in found.message
    free = fit_compact(both[0], 25, energy=False)
    np.testing.assert_array_equal(found.model.coefficients, free.model.coefficients)
    assert found.albedo == free.albedo > 1
    assert other.result == Outcome.converged


def test_a_brdf_that_fails_is_named():
    def fails(wi, wo):
        raise ArithmeticError("lost")

    with pytest.raises(ArithmeticError, match="lost") as caught:
        fit_compact_all([PLASTIC, fails], 25)
    assert caught.value.__notes__ == ["with material 1"]


def directions_of(samples):
    return samples.wi[:5], samples.wo[:5]


def test_what_is_no_material(unchecked, tmp_path):
    with pytest.raises(ValueError, match=r"got a str; .* reads a file"):
        fit_compact("paper.bsdf", 30)
    with pytest.raises(TypeError, match="a CompactFit is the result of a fit"):
        save_model(tmp_path / "fit.hshjax", fit_compact(scattered(), 30))


def test_materials_that_differ(unchecked):
    with pytest.raises(ValueError, match="material 1 differs from material 0"):
        fit_compact_all([scattered(), scattered(n=500)], 30)
    with pytest.raises(ValueError, match="no material"):
        fit_compact_all([], 30)
    with pytest.raises(ValueError, match="takes several materials"):
        fit_compact_all(scattered(), 30)
    with pytest.raises(ValueError, match="3 components take as many coefficients"):
        fit_compact(scattered(), 2)
    with pytest.raises(ValueError, match=r"at most 1000 coefficients, got 2000: .* makes a table"):
        fit_compact(scattered(), 2000)


@pytest.mark.parametrize("value", [1.0, 3.0, 100.0])
def test_what_reflects_more_than_it_gets_is_held(value):
    """Constants above 1/π, as of data in other units: the bounds of ln ρ give way, and no error is obscure."""
    samples = scattered(value=jnp.full((600, 3), value))
    held = fit_compact(samples, 30)
    assert held.albedo <= 1
    assert float(held.model(*far_and_near()).max()) < 3 * value
    free = fit_compact(samples, 30, energy=False).model(*far_and_near())
    np.testing.assert_allclose(free, value, rtol=0.01)  # the ridge draws ln ρ to 0 by some 1e-3


def test_the_highlight_alone():
    """Samples of it and nothing else: albedos are held, though all that was seen is bright."""
    brdf = Lambert([0.1]) + GGX([0.9], 0.1)
    wi = directions(5, 600, min_z=0.3)
    wo = mirrored(wi) + 0.03 * directions(6, 600)
    wo = wo / jnp.linalg.norm(wo, axis=1, keepdims=True)
    found = fit_compact(scattered(wi=wi, wo=wo, value=brdf(wi, wo)), 30)
    assert found.albedo <= 1


@pytest.mark.slow
def test_albedos_hold_between_the_angles_that_are_looked_at():
    """A narrow lobe that reflects all it gets: every two degrees, by more nodes than the fit takes."""
    found = fit_compact(Lambert([0.1]) + GGX([1.0], 0.05), 150)
    largest = 0.0
    for angle in np.radians(np.arange(1, 80, 2)):
        wi, wo, weight = furnace_rule(float(angle), (200, 64))
        value = evaluated(found.model, wi, np.broadcast_to(wo, wi.shape))
        largest = max(largest, float((weight @ value).max()))
    assert found.albedo <= 1
    assert largest < 1.005


def test_scales_in_any_order():
    samples = plastic()
    backwards = fit_compact(samples, 25, alphas=ALPHAS[::-1])
    assert backwards.alphas == fit_compact(samples, 25).alphas
    assert backwards.alpha == fit_compact(samples, 25).alpha


def retro_reflector():
    """A lobe about wi = wo, 3 degrees wide, over a dull base."""
    base = LogLinearBRDF(HalfVectorBasis([(0, 0, 0)]), [jnp.asarray([np.log(0.1)])])

    def brdf(wi, wo):
        return base(wi, wo) + 5 * jnp.exp(-jnp.sum((wi - wo) ** 2, axis=-1, keepdims=True) / 0.05**2)

    return brdf


@pytest.mark.slow
def test_retro_reflection_takes_a_warp_of_its_own():
    """Without one a lobe about wi = wo is out of reach; with one, fewer coefficients do much better."""
    samples = half_vector_samples(retro_reflector(), shape=(12, 90, 4))
    without, found = fit_compact(samples, 40, betas=()), fit_compact(samples, 20)
    assert without.beta is None
    assert found.beta is not None
    assert found.log_error < 0.2 * without.log_error
    assert fit_compact(plastic(), 20).beta is None


def test_dark_materials_are_fitted_as_bright_ones():
    """All values below 1e-4: the floor follows, and the model scales with the material."""
    dark = half_vector_samples(lambda wi, wo: 1e-4 * PLASTIC(wi, wo), shape=SHAPE)
    found = fit_compact(dark, 40)
    value = np.asarray(dark.value)
    assert value.max() < 0.01
    error = np.abs(np.asarray(found.model(dark.wi, dark.wo)) / value - 1)
    assert np.median(error) < 0.02
    assert found.floored < 0.05


def test_spectra_share_a_few_components():
    """31 channels, four of whose components say all: as many coefficients as a material of one channel takes."""
    weights = np.stack([np.ones(31), *np.cos(np.pi * np.arange(1, 3)[:, None] * (np.arange(31) + 0.5) / 31)])
    truth = LogLinearBRDF(
        HalfVectorBasis(12, LogWarp(jnp.asarray(1e-2))),
        [jnp.asarray(0.3 * np.random.default_rng(j).normal(size=n)) for j, n in enumerate((12, 6, 6))],
        jnp.asarray(weights),
    )
    found = fit_compact(half_vector_samples(truth, shape=SHAPE), 36, mixing=weights, energy=False)
    assert found.model.channels == 31
    assert found.log_error < 1e-3


def test_rounds_bring_differences_down():
    """Weights that follow the fit: closer in ln(1 + ρ z), in the mean, than least squares; none is refused."""
    samples = half_vector_samples(Lambert([0.2]) + GGX([0.8], 0.05), shape=(48, 12, 4))
    once, again = fit_compact(samples, 20, rounds=0), fit_compact(samples, 20)
    assert again.log_error < 0.97 * once.log_error
    with pytest.raises(ValueError, match="rounds must be >= 0, got -1"):
        fit_compact(samples, 20, rounds=-1)


def test_albedo_is_held_where_samples_are_noisy():
    """1000 noisy samples of a sharp highlight: free fits reflect more than they get, by any factor."""
    rng = np.random.default_rng(2)
    wi, wo = directions(3, 1000), directions(4, 1000)
    brdf = Lambert([0.1]) + GGX([0.9], 0.03)
    value = np.asarray(brdf(wi, wo)) * (1 + 0.1 * rng.normal(size=(1000, 1)))
    found = [
        fit_compact(Samples.scattered(wi, wo, jnp.asarray(value), isotropic=True), 90, energy=held)
        for held in (False, True)
    ]
    assert found[1].albedo <= 1
    assert found[1].albedo <= found[0].albedo
