"""Models of few, scattered and noisy samples: calibrated error bars, tame where nothing was seen, or a refusal."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HalfVectorBasis, LogWarp
from hshjax.brdfs import GGX, Lambert, LogLinearBRDF
from hshjax.fitting import infer_compact
from hshjax.fitting._compact_posterior import _offered
from hshjax.fitting._infer_compact import prior_deviations
from hshjax.io import load_model, save_model
from hshjax.samples import Samples
from tests.fitting.test_compact import PLASTIC, POOR, far_and_near, scattered
from tests.helpers import DTYPE, X64, directions, slow_unless

needs_x64 = pytest.mark.skipif(not X64, reason="found on the host in float64, whatever the leg")

FEW = 40
"""Functions: enough for these materials, and quick."""


def noisy(brdf, size, seed, sigma=0.05, dark=0.0):
    """Samples with noise of two parts, below 80 degrees."""
    rng = np.random.default_rng(seed)
    wi, wo = (directions(10 * seed + k, size, min_z=0.17) for k in (1, 2))
    truth = np.asarray(brdf(wi, wo))
    value = truth + sigma * np.hypot(truth, dark) * rng.normal(size=truth.shape)
    return Samples.scattered(wi, wo, jnp.asarray(value, DTYPE), isotropic=True), truth


def inside(value, bounds):
    low, high = (np.asarray(bound) for bound in bounds)
    return np.mean((value >= low) & (value <= high))


@needs_x64
@pytest.mark.parametrize("channels", [slow_unless(channels == 3, channels) for channels in (1, 3)])
def test_draws_of_the_prior_are_covered(channels):
    """Materials that are what the prior says: surfaces and new samples lie in 90 % intervals as often as that."""
    basis = HalfVectorBasis(FEW, LogWarp(jnp.asarray(1e-2)))
    deviations = prior_deviations(basis.modes)
    shares = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        coefficients = 0.7 * deviations[:, None] * rng.normal(size=(FEW, channels))
        coefficients[0] = -2
        truth = LogLinearBRDF(basis, list(jnp.asarray(coefficients).T), jnp.eye(channels))
        samples, _ = noisy(truth, 150, seed)
        fresh, surface = noisy(truth, 150, 100 + seed)
        found = infer_compact(samples, FEW, noise=0.05)
        known = found.interval(fresh.wi, fresh.wo), found.interval(fresh.wi, fresh.wo, noise=True)
        shares.append([inside(surface, known[0]), inside(np.asarray(fresh.value), known[1])])
    # Samples of one material are covered together where its surface is wrong: the spread over materials tells.
    error = np.std(shares, axis=0) / np.sqrt(len(shares))
    assert np.all(np.abs(np.mean(shares, axis=0) - 0.9) < 3 * error + 0.01)
    assert np.all(error < 0.03)


@needs_x64
@pytest.mark.parametrize("criterion", ["evidence", "leave-one-out"])
def test_the_number_of_functions_is_chosen(criterion):
    """By what speaks for it, among all that is asked for; a material that few functions hold does not take many."""
    basis = HalfVectorBasis(6, LogWarp(jnp.asarray(0.1)))
    coefficients = jnp.asarray([-1.5, 0.4, 0.3, -0.2, 0.2, 0.1])
    samples, _ = noisy(LogLinearBRDF(basis, [coefficients], jnp.eye(1)), 120, 3, sigma=0.02)
    sizes = (3, 6, FEW)
    found = infer_compact(samples, sizes, alphas=(0.1,), criterion=criterion)
    assert {trial.functions for trial in found.trials} == set(sizes)
    assert found.chosen.functions > 3
    assert found.model.basis.count == found.chosen.functions
    said = {"evidence": lambda trial: trial.evidence, "leave-one-out": lambda trial: trial.predictive}[criterion]
    assert said(found.chosen) >= max(map(said, found.trials)) - 0.1  # linearised anew
    one = infer_compact(samples, found.chosen.functions, alphas=(0.1,), criterion=criterion)
    assert one.noise == pytest.approx(found.noise, rel=0.02)


@needs_x64
@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ({"functions": ()}, "functions must be one positive number or several"),
        ({"criterion": "luck"}, "criterion must be one of evidence, leave-one-out, got 'luck'"),
    ],
)
def test_choices_that_do_not_exist_are_refused(argument, message, unchecked):
    with pytest.raises(ValueError, match=message):
        infer_compact(noisy(PLASTIC, 60, 0)[0], **argument)


@needs_x64
def test_the_material_and_its_noise_are_found():
    samples, _ = noisy(PLASTIC, 600, 0, sigma=0.05, dark=0.02)
    found = infer_compact(samples, FEW)
    assert found.noise == pytest.approx(0.05, rel=0.15)
    assert 0.01 < found.dark < 0.04
    assert 0.8 < found.factor < 1.2
    fresh, truth = noisy(PLASTIC, 600, 1)
    error = np.log(np.asarray(found.model(fresh.wi, fresh.wo)) / truth)
    assert np.sqrt(np.mean(error**2)) < 0.03  # less than the noise: neighbours tell of each other
    best = max(found.trials, key=lambda trial: trial.evidence)
    assert best.evidence == pytest.approx(found.chosen.evidence, abs=0.1)  # linearised anew


@needs_x64
def test_told_noise_narrows_the_surface():
    samples, _ = noisy(PLASTIC, 150, 3)
    told, untold = infer_compact(samples, FEW, noise=0.05), infer_compact(samples, FEW)
    assert told.misfit < untold.misfit == untold.noise
    wi, wo = directions(1, 150), directions(2, 150)
    assert np.all(told.log_deviation(wi, wo) < untold.log_deviation(wi, wo))
    np.testing.assert_array_equal(told.model.coefficients, untold.model.coefficients)


@needs_x64
def test_intervals_are_what_they_say():
    """The surface: ln ρ within deviations; with noise: wider on both sides, by the dark part too; levels are nested."""
    samples, _ = noisy(PLASTIC, 150, 4, dark=0.05)
    found = infer_compact(samples, FEW)
    wi, wo = directions(1, 150), directions(2, 150)
    value, deviation = found.model(wi, wo), found.log_deviation(wi, wo)
    low, high = found.interval(wi, wo)
    np.testing.assert_allclose(np.log(high / value), 1.6448536 * deviation, rtol=1e-6)
    np.testing.assert_allclose(np.log(value / low), 1.6448536 * deviation, rtol=1e-6)
    below, above = found.interval(wi, wo, noise=True)
    part = found.reach(0.9) * found.noise * found.dark
    assert np.all((value - below) ** 2 >= (value - low) ** 2 + part**2 * (1 - 1e-9))
    assert np.all((above - value) ** 2 >= (high - value) ** 2 + part**2 * (1 - 1e-9))
    half = found.interval(wi, wo, 0.5)
    assert np.all(half[0] > low)
    assert np.all(half[1] < high)
    scores = np.abs(found.scores)
    assert np.mean(scores <= found.reach(0.5)) == pytest.approx(76 / 150, abs=0.001)  # ceil(75.5) of 150
    with pytest.raises(ValueError, match=r"150 samples say nothing of a level of 0.999: at most 0.993"):
        found.interval(wi, wo, 0.999)
    with pytest.raises(ValueError, match="a level lies between 0 and 1"):
        found.reach(90.0)


@needs_x64
def test_far_from_samples_deviations_grow():
    """Towards the prior's, which they do not exceed: samples of the normal direction say little of grazing angles."""
    near = noisy(PLASTIC, 150, 5)[0]
    wi, wo = (directions(k, 150, min_z=0.9) for k in (1, 2))
    found = infer_compact(Samples.scattered(wi, wo, PLASTIC(wi, wo), isotropic=True), FEW)
    grazing = (directions(k, 150, min_z=0.17) for k in (3, 4))
    assert np.median(found.log_deviation(*grazing)) > 3 * np.median(found.log_deviation(wi, wo))
    rows = np.asarray(found.model.basis(near.wi, near.wo)) * prior_deviations(found.model.basis.modes)
    prior = found.chosen.deviation * np.linalg.norm(rows, axis=1)
    coefficients = found.log_deviation(near.wi, near.wo) ** 2 - (found.factor * found.misfit) ** 2
    reached = np.sqrt(np.maximum(coefficients, 0)) / max(found.factor, 1.0)
    assert np.all(reached <= prior[:, None] * (1 + 1e-6))


@pytest.mark.slow
@needs_x64
def test_exact_samples_do_not_narrow_what_was_not_sampled():
    """Left out, they are found again better than predicted; of grazing pairs beyond them that says nothing."""
    rough = Lambert([0.2, 0.1, 0.02]) + 0.2 * GGX(1.0, 0.4)
    wi, wo = (directions(k, 100, min_z=0.2) for k in (1, 2))
    found = infer_compact(Samples.scattered(wi, wo, rough(wi, wo), isotropic=True))
    assert found.factor < 0.75
    wi, wo = (directions(k, 1000, min_z=0.01) for k in (3, 4))
    grazing = np.asarray(jnp.minimum(wi[:, 2], wo[:, 2]) < 0.2)
    wi, wo = wi[grazing], wo[grazing]
    left = np.linalg.norm(np.einsum("nf,cfg->cng", found.model.basis(wi, wo), found.roots), axis=-1).T
    expected = np.hypot(left, found.factor * found.misfit)
    np.testing.assert_allclose(found.log_deviation(wi, wo), expected, rtol=1e-9)
    asked = found.suggest(1, (wi, wo))
    (k,) = np.flatnonzero(np.all(np.asarray(wi) == np.asarray(asked.wi), axis=1))
    assert asked.log_deviation[0] == pytest.approx(np.sqrt(np.mean(left[k] ** 2)), rel=1e-9)
    # 0.77 of them; 0.34 where the coefficients were narrowed, too.
    assert inside(np.asarray(rough(wi, wo)), found.interval(wi, wo)) > 0.7


@needs_x64
def test_no_highlight_is_invented():
    """None sampled within 20 degrees: the warp stays as wide as that, to a factor of ten in 1 - cos θ_h."""
    wi, wo = directions(1, 600), directions(2, 600)
    half = wi + wo
    cosine = half[:, 2] / jnp.linalg.norm(half, axis=1)
    far = cosine < np.cos(np.radians(20))
    brdf = Lambert([0.2]) + 0.1 * GGX([1.0], 0.02)
    found = infer_compact(Samples.scattered(wi[far], wo[far], brdf(wi[far], wo[far]), isotropic=True), FEW)
    assert min(trial.alpha for trial in found.trials) >= 0.1 * (1 - np.cos(np.radians(20)))


def distinct(name):
    """One pair again and again; and a value that is far off."""
    one = {"wi": jnp.tile(jnp.asarray([[0.6, 0, 0.8]], DTYPE), (60, 1)), "wo": directions(6, 1).repeat(60, axis=0)}
    if name == "one pair":
        return scattered(n=60, **one)
    value = np.array(PLASTIC(directions(5, 60), directions(6, 60)))
    value[7] = 1e3 if name == "an outlier" else -1e3
    return scattered(n=60, value=jnp.asarray(value))


EXTREME = ("one pair", "an outlier", "far below zero")


@needs_x64
@pytest.mark.parametrize("case", [*POOR, *EXTREME])
def test_poor_data_do_not_explode(case):
    """Nowhere, up to the horizon, beyond three times the largest value, nor below a third of the least above 0."""
    samples = POOR[case]() if case in POOR else distinct(case)
    found = infer_compact(samples, FEW)
    value = np.asarray(found.model(*far_and_near()))
    assert np.all(np.isfinite(value))
    assert value.max() < 3 * float(samples.value.max())
    assert value.min() > float(np.min(samples.value, where=np.asarray(samples.value) > 0, initial=np.inf)) / 3
    low, high = (np.asarray(bound) for bound in found.interval(*far_and_near(), noise=True))
    assert np.all(np.isfinite(low))
    assert np.all(np.isfinite(high))
    assert np.all(low <= value)
    assert np.all(value <= high)


@needs_x64
@pytest.mark.parametrize("unit", [1e-3, slow_unless(False, 1e3)])
def test_samples_in_another_unit_give_the_model_in_that_unit(unit):
    """To rounding, which the decompositions enlarge: all but the density, which is per unit."""
    samples, _ = noisy(PLASTIC, 100, 7, dark=0.02)
    scaled = Samples.scattered(samples.wi, samples.wo, unit * samples.value, isotropic=True)
    one, other = (infer_compact(part, FEW, noise=0.05) for part in (samples, scaled))
    wi, wo = directions(1, 60, min_z=0.0), directions(2, 60, min_z=0.0)
    np.testing.assert_allclose(other.model(wi, wo), unit * one.model(wi, wo), rtol=1e-6)
    np.testing.assert_allclose(other.log_deviation(wi, wo), one.log_deviation(wi, wo), rtol=1e-6)
    for noise in (False, True):
        pairs = zip(other.interval(wi, wo, noise=noise), one.interval(wi, wo, noise=noise), strict=True)
        for bound, expected in pairs:
            np.testing.assert_allclose(bound, unit * expected, rtol=1e-6, atol=1e-9 * unit)
    assert other.alpha == one.alpha
    assert other.dark == pytest.approx(unit * one.dark, rel=1e-6)
    density = one.chosen.evidence - samples.value.size * np.log(unit)
    assert other.chosen.evidence == pytest.approx(density, rel=1e-9)
    np.testing.assert_allclose(other.suggest(3).wi, one.suggest(3).wi)


@needs_x64
def test_dark_channels_are_found_beside_bright_ones():
    """Each as well as the others, three and six orders of magnitude below them."""
    levels = np.array([1.0, 1e-3, 1e-6])
    samples, _ = noisy(PLASTIC, 200, 3)
    dim = Samples.scattered(samples.wi, samples.wo, samples.value * levels[None], isotropic=True)
    found = infer_compact(dim, FEW, noise=0.05)
    fresh, truth = noisy(PLASTIC, 200, 4)
    error = np.abs(np.log(np.asarray(found.model(fresh.wi, fresh.wo)) / (truth * levels)))
    assert np.all(np.median(error, axis=0) < 0.03)  # less than the noise
    for channel, (low, high) in enumerate(zip(*(bound.T for bound in found.interval(fresh.wi, fresh.wo)), strict=True)):
        assert inside(truth[:, channel] * levels[channel], (low, high)) > 0.8


@needs_x64
def test_a_constant_is_one():
    found = infer_compact(POOR["constant"](), FEW)
    np.testing.assert_allclose(found.model(*far_and_near()), 0.2, rtol=1e-3)
    assert np.max(found.log_deviation(directions(1, 150), directions(2, 150))) < 0.02


@needs_x64
def test_masked_samples_do_not_count():
    samples, _ = noisy(PLASTIC, 60, 6)
    value = jnp.concatenate([samples.value, jnp.full((5, 3), jnp.nan)])
    wi, wo = (jnp.concatenate([w, w[:5]]) for w in (samples.wi, samples.wo))
    masked = Samples.scattered(wi, wo, value, jnp.asarray([1.0] * 60 + [0.0] * 5), isotropic=True)
    one, other = infer_compact(samples, FEW), infer_compact(masked, FEW)
    np.testing.assert_array_equal(one.model.coefficients, other.model.coefficients)
    assert one.chosen == other.chosen


@needs_x64
def test_weights_are_precisions():
    """Their common scale means nothing; what has hardly any weight, as well as what has none, moves nothing."""
    samples, _ = noisy(PLASTIC, 60, 6)
    weight = jnp.asarray([1.0] * 59 + [1e-9])
    light = Samples.scattered(samples.wi, samples.wo, samples.value.at[59].set(5.0), weight, isotropic=True)
    one, scaled = infer_compact(light, FEW), infer_compact(light.reweighted(7 * weight), FEW)
    np.testing.assert_allclose(one.model.coefficients, scaled.model.coefficients, rtol=1e-6, atol=1e-9)
    assert one.chosen.evidence == pytest.approx(scaled.chosen.evidence, rel=1e-9)
    without = infer_compact(samples.reweighted(jnp.round(weight)), FEW, alphas=[one.alpha])
    far = directions(1, 60, min_z=0.17), directions(2, 60, min_z=0.17)
    # But for the bounds of ln ρ, which are of all values.
    bounded = np.minimum(one.model(*far), np.exp(without.model.high))
    np.testing.assert_allclose(bounded, without.model(*far), rtol=0.02)


@needs_x64
def test_suggestions_tell_more_than_random_pairs():
    """Mean variance of ln ρ over what can be measured, after twelve more samples by suggestion and by lot."""
    samples, _ = noisy(PLASTIC, 60, 8)
    found = infer_compact(samples, FEW, noise=1.0)  # more than there is: no misfit
    asked = found.suggest(12)
    assert asked.wi.shape == asked.wo.shape == (12, 3)
    offered, rng = [jnp.asarray(w) for w in _offered()], np.random.default_rng(0)

    def left(wi, wo):
        return float(np.mean(found.measured(wi, wo).log_deviation(*offered) ** 2))

    lots = [rng.choice(len(offered[0]), 12, replace=False) for _ in range(10)]
    assert left(asked.wi, asked.wo) < np.min([left(*(w[lot] for w in offered)) for lot in lots])


@needs_x64
def test_suggestions_follow_the_update():
    """Each deviation is what `measured` says after the ones before; candidates are taken at most once."""
    samples, _ = noisy(PLASTIC, 60, 9)
    found = infer_compact(samples, FEW, noise=1.0)  # more than there is: no misfit
    candidates = directions(1, 60, min_z=0.2), directions(2, 60, min_z=0.2)
    asked = found.suggest(60, candidates)
    assert len(np.unique(np.asarray(asked.wi), axis=0)) == 60
    after = found.measured(asked.wi[:5], asked.wo[:5])
    expected = np.sqrt(np.mean(np.asarray(after.log_deviation(asked.wi[5], asked.wo[5])) ** 2))
    assert asked.log_deviation[5] == pytest.approx(expected, rel=1e-9)
    with pytest.raises(ValueError, match="of 60 candidates 1 to 60 can be suggested, got 61"):
        found.suggest(61, candidates)


@needs_x64
def test_one_pair_is_measured_and_none_on_the_horizon(unchecked):
    """`measured` and `suggest` take and refuse the same."""
    found = infer_compact(noisy(PLASTIC, 60, 9)[0], FEW)
    wi, wo = directions(1, 6, min_z=0.2), directions(2, 6, min_z=0.2)
    np.testing.assert_array_equal(found.measured(wi[0], wo[0]).roots, found.measured(wi[:1], wo[:1]).roots)
    batch = found.measured(wi.reshape(2, 3, 3), wo.reshape(2, 3, 3))
    np.testing.assert_array_equal(batch.roots, found.measured(wi, wo).roots)
    against = found.measured(wi[0], wo)
    np.testing.assert_array_equal(against.roots, found.measured(jnp.broadcast_to(wi[0], wo.shape), wo).roots)
    assert found.suggest(1, (wi[0], wo[0])).wi.shape == (1, 3)
    message = "above the horizon, z > 0 in both directions: 1 of 6 do not, the first is pair 4 with z = "
    for z in (0.0, -0.6):
        low = wo.at[4].set(jnp.asarray([np.sqrt(1 - z**2), 0, z]))
        for one, other in ((wi, low), (low, wi)):
            with pytest.raises(ValueError, match=f"{message}{z:g}"):
                found.measured(one, other)
            with pytest.raises(ValueError, match=f"{message}{z:g}"):
                found.suggest(1, (one, other))
    with pytest.raises(ValueError, match=r"directions are unit vectors \(\*batch, 3\), got shape \(6, 2\)"):
        found.measured(wi[:, :2], wo)


@pytest.mark.slow
def test_posteriors_are_compiled_and_follow_the_directions():
    """In either precision; one and the same under jit."""
    samples, _ = noisy(PLASTIC, 60, 2)
    found = infer_compact(samples, FEW)
    wi, wo = directions(1, 7), directions(2, 7)

    def known(found, wi, wo):
        return found.model(wi, wo), found.log_deviation(wi, wo), *found.interval(wi, wo, noise=True)

    # Products of 40 functions in another order.
    for one, other in zip(known(found, wi, wo), eqx.filter_jit(known)(found, wi, wo), strict=True):
        assert one.dtype == other.dtype == DTYPE
        assert one.shape == (7, 3)
        np.testing.assert_allclose(one, other, rtol=1e-10 if X64 else 1e-4)
    assert found.model(wi.astype(jnp.float32), wo.astype(jnp.float32)).dtype == jnp.float32
    assert found.log_deviation(wi.astype(jnp.float32), wo.astype(jnp.float32)).dtype == jnp.float32


def test_models_are_saved(tmp_path):
    samples, _ = noisy(PLASTIC, 60, 2)
    model = infer_compact(samples, FEW).model
    save_model(tmp_path / "few.hshjax", model)
    loaded = load_model(tmp_path / "few.hshjax")
    assert eqx.tree_equal(loaded, model)
    np.testing.assert_array_equal(loaded(samples.wi, samples.wo), model(samples.wi, samples.wo))


REFUSED = {
    "black": (
        lambda: scattered(value=jnp.zeros((600, 3), DTYPE)),
        {},
        "the material is black: no value is above 0$",
    ),
    "a black channel": (
        lambda: scattered(value=jnp.tile(jnp.asarray([[0.2, 0.0, 0.1]], DTYPE), (600, 1))),
        {},
        r"channels \[1\] are black: no value is above 0; leave them out",
    ),
    "infinite": (lambda: scattered(value=jnp.full((600, 3), jnp.inf)), {}, "600 of 600 .* hold NaN or infinite values"),
    "below": (lambda: scattered(wi=-directions(5, 600)), {}, "600 of 600 samples .* below the horizon"),
    "too few": (lambda: scattered(n=19), {}, "19 samples .* are too few for error bars, 20 are needed"),
    "scales": (lambda: scattered(), {"alphas": [0.0]}, "scales are positive"),
    "no scale": (lambda: scattered(), {"alphas": []}, "scales are positive, at least one"),
    "noise": (lambda: scattered(), {"noise": 0.0}, "noise must be > 0"),
    "functions": (lambda: scattered(), {"functions": 0}, "functions must be one positive number or several"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case, unchecked):
    samples, settings, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        infer_compact(samples(), **settings)
