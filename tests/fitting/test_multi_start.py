"""Guesses and fits from many starts."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import (
    GGX,
    BlinnPhong,
    CookTorrance,
    Lambert,
    LinearBRDF,
    OrenNayar,
    Ward,
    bounded,
)
from hshjax.fitting import (
    CosineWeighted,
    LogRelative,
    Outcome,
    SampleMisfit,
    fit,
    initial_guesses,
    multi_start,
)
from hshjax.fitting._guess import _best_distinct, _spread
from hshjax.fitting._mappings import AbstractMapping
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, slow_unless

RULE = isotropic_pair_rule(12, dtype=DTYPE)
TRUTH = CookTorrance(np.array([0.3, 0.2, 0.1]), 0.4, 0.15)
CLEAN = Samples.from_function(TRUTH, RULE)
COSINE_WEIGHTED = CosineWeighted()


def objective(samples):
    return {"data": SampleMisfit(samples, CosineWeighted())}


def first(guesses):
    return jax.tree.map(lambda leaf: leaf[0], guesses)


def losses(guesses, samples, mapping=COSINE_WEIGHTED):
    return eqx.filter_vmap(lambda model: jnp.sum(SampleMisfit(samples, mapping)(model) ** 2) / 2)(guesses)


class NotKnownToBeLinear(AbstractMapping):
    def __call__(self, rho, wi, wo):
        return COSINE_WEIGHTED(rho, wi, wo)


# --- guesses ----------------------------------------------------------------------------------------------------------

# Truth, and a template of the same structure and channels whose values are far off.
GUESSED = {
    "cook_torrance": (TRUTH, CookTorrance(np.ones(3), 1.0, 1.0)),
    "ggx_lambert": (Lambert(0.3) + GGX(0.3, 0.2), Lambert(1.0) + GGX(0.0, 1.0)),
    "oren_nayar": (OrenNayar(0.6, 0.5), OrenNayar(0.0, 0.0)),
    "oren_nayar_full": (OrenNayar(0.6, 0.5, full=True), OrenNayar(0.0, 0.0, full=True)),
    "blinn_phong": (Lambert(0.3) + BlinnPhong(0.2, 60.0), Lambert(0.0) + BlinnPhong(0.0, 1.0)),
    "ward": (Lambert(0.3) + Ward(0.3, 0.2, 0.2), Lambert(0.0) + Ward(0.0, 0.9, 0.9)),
}


@pytest.mark.parametrize("name", [slow_unless(n == "cook_torrance", n) for n in GUESSED])
def test_the_best_guess_is_within_half_of_the_truth(name):
    """Of every parameter. 64 candidates in one dimension lie 6 % apart, in two some 50 %: one cell at most."""
    truth, template = GUESSED[name]
    samples = Samples.from_function(truth, RULE)
    guesses = initial_guesses(template, samples)
    for got, true in zip(jax.tree.leaves(guesses), jax.tree.leaves(truth), strict=True):
        assert got.shape == (16, *true.shape)
        assert got.dtype == true.dtype
        assert jnp.all(jnp.abs(got[0] - true) <= 0.5 * true)
    found = losses(guesses, samples)
    assert jnp.all(found[1:] >= found[:-1])


def test_amplitudes_are_least_squares_in_their_box():
    """Those of a linear solver at the slope that is held; beyond the box, one at its edge and the other best for it."""
    slope = 0.15
    basis = jnp.stack([CookTorrance(*p, slope)(RULE.wi, RULE.wo)[:, 0] for p in ((1.0, 0.0), (0.0, 1.0))], axis=1)
    root = (jnp.sqrt(RULE.weight) * RULE.wi[:, 2] * RULE.wo[:, 2])[:, None]
    template = CookTorrance(0.5, 0.5, slope)

    def solved(value):
        samples = Samples(RULE.wi, RULE.wo, value[:, None], RULE.weight)
        found = first(initial_guesses(template, samples, trainable=lambda b: (b.diffuse, b.specular)))
        assert found.slope == template.slope
        return jnp.stack([found.diffuse, found.specular])

    wiggly = basis @ jnp.asarray([0.3, 0.4], DTYPE) * (1 + 0.3 * jnp.sin(9 * RULE.wi[:, 0]))
    exact = jnp.linalg.lstsq(root * basis, root[:, 0] * wiggly)[0]
    assert_close(solved(wiggly), exact, tolerance=1e-8 if X64 else 1e-4)
    bright = basis @ jnp.asarray([0.3, 1.5], DTYPE)
    column, rest = root[:, 0] * basis[:, 0], root[:, 0] * (bright - basis[:, 1])
    assert_close(solved(bright), jnp.stack([jnp.clip(column @ rest / (column @ column), 0, 1), jnp.ones((), DTYPE)]))


def test_a_model_of_amplitudes_only_has_one_guess():
    samples = Samples.from_function(Lambert(np.array([0.1, 0.7])), RULE)
    assert_close(initial_guesses(Lambert(np.zeros(2)), samples).albedo, [[0.1, 0.7]], tolerance=1e-6)


def test_of_a_product_the_inner_amplitude_is_taken_and_the_outer_where_it_must():
    def scaled(truth, template):
        guess = first(initial_guesses(template, Samples.from_function(truth, RULE)))
        return guess.scale, guess.brdf.albedo

    scale, albedo = scaled(Lambert(0.3), 7.0 * Lambert(0.9))
    assert_close(scale, 1.0, tolerance=1e-6)
    assert_close(albedo, 0.3, tolerance=1e-6)
    # Brighter than an albedo may be, and of more channels than the inner one has.
    scale, albedo = scaled(2.5 * Lambert(1.0), 7.0 * Lambert(0.9))
    assert_close(scale * albedo, 2.5, tolerance=1e-6)
    assert albedo == 1
    scale, albedo = scaled(Lambert(np.array([0.2, 0.4])), jnp.ones(2) * Lambert(0.9))
    assert_close(scale * albedo, [0.2, 0.4], tolerance=1e-6)


def test_the_amplitudes_beside_a_product_are_solved_with_it():
    truth = Lambert(np.array([0.3, 0.2])) + jnp.asarray([0.4, 0.8]) * GGX(0.5, 0.4)
    template = Lambert(np.ones(2)) + jnp.ones(2) * GGX(1.0, 0.4)
    samples = Samples.from_function(truth, RULE)
    held = eqx.tree_at(lambda b: b.b.brdf.roughness, jax.tree.map(lambda _: True, template), False)
    guess = first(initial_guesses(template, samples, trainable=held))
    assert_close(guess.a.albedo, truth.a.albedo, tolerance=1e-4)
    assert_close(guess.b.scale * guess.b.brdf.specular, truth.b.scale * 0.5, tolerance=1e-4)


def test_masked_samples_count_for_nothing():
    used = jnp.arange(CLEAN.size) % 3 > 0
    spoilt = Samples(
        jnp.where(used[:, None], CLEAN.wi, jnp.nan),
        CLEAN.wo,
        jnp.where(used[:, None], CLEAN.value, jnp.nan),
        jnp.where(used, CLEAN.weight, 0),
    )
    kept = Samples(CLEAN.wi[used], CLEAN.wo[used], CLEAN.value[used], CLEAN.weight[used])
    for got, expected in zip(*(jax.tree.leaves(initial_guesses(TRUTH, s, 2)) for s in (spoilt, kept)), strict=True):
        assert_close(got, expected, tolerance=1e-8 if X64 else 1e-3)


def test_another_mapping_orders_by_its_own_misfit():
    guesses = initial_guesses(TRUTH, CLEAN, 4, mapping=LogRelative())
    found = losses(guesses, CLEAN, LogRelative())
    assert jnp.all(found[1:] >= found[:-1])
    assert abs(guesses.slope[0] - TRUTH.slope) < 0.1 * TRUTH.slope


@pytest.mark.parametrize("trainable", [None, lambda brdf: (brdf.specular, brdf.slope)], ids=["all", "diffuse held"])
def test_a_misfit_by_moments_is_the_misfit(trainable):
    """The same guesses in the same order, whether the model is evaluated once more or not."""
    noisy = 1 + 0.1 * np.random.default_rng(0).normal(size=CLEAN.value.shape)
    samples = Samples(CLEAN.wi, CLEAN.wo, CLEAN.value * jnp.asarray(noisy, DTYPE), CLEAN.weight.at[:9].set(0))
    by_moments, by_misfit = (
        initial_guesses(TRUTH, samples, 8, mapping=mapping, trainable=trainable)
        for mapping in (COSINE_WEIGHTED, NotKnownToBeLinear())
    )
    for a, b in zip(jax.tree.leaves(by_moments), jax.tree.leaves(by_misfit), strict=True):
        assert_close(a, b)
    found = losses(by_moments, samples)
    assert jnp.all(found[1:] >= found[:-1])


def test_candidates_are_spread_evenly():
    """A tenth of the square holds a tenth of 1000 points, to a few; each of 50 equal intervals has its share of 100."""
    points = _spread(2, 1000)
    assert abs(np.sum(np.all(points < np.sqrt(0.1), axis=1)) - 100) <= 5
    assert set(np.bincount((50 * _spread(1, 100)[:, 0]).astype(int), minlength=50)) <= {1, 2, 3}


def test_guesses_kept_are_distinct():
    points = np.array([[0.0], [0.001], [0.5], [0.501], [0.9]])
    losses = jnp.asarray([0.0, 0.1, 0.3, 0.2, 0.4], DTYPE)
    assert list(_best_distinct(losses, points, 3)) == [0, 3, 4]
    # Neighbours when there is nobody else; what is not finite last.
    assert list(_best_distinct(losses.at[4].set(jnp.nan), points, 5)) == [0, 1, 3, 2, 4]


@pytest.mark.parametrize(
    ("template", "settings", "message"),
    [
        (TRUTH, {"count": 0}, "count must be at least 1, got 0"),
        (TRUTH, {"trainable": False}, "nothing is trainable"),
        (Lambert(0.5), {}, r"the model gives values of shape \(\d+, 1\), the samples have \(\d+, 3\)"),
        (
            LinearBRDF(IsotropicBasis(HSH(1)), jnp.zeros((IsotropicBasis(HSH(1)).count, 3), DTYPE)), {},
            "coefficients is no amplitude and has no finite range",
        ),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("unchecked")
def test_what_no_guess_can_be_made_of(template, settings, message):
    with pytest.raises(ValueError, match=message):
        initial_guesses(template, CLEAN, **settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"search": (0.5, 2.0)}, r"a search range lies in the box \[0, 1\], got \(0.5, 2.0\)"),
        ({"search": (0.0, 1.0), "logarithmic": True}, "a logarithmic search needs a range above 0"),
        ({"logarithmic": True}, "a logarithmic search needs a range above 0, got None"),
    ],
)
def test_a_search_that_cannot_be(settings, message):
    with pytest.raises(ValueError, match=message):
        bounded(0.0, 1.0, **settings)


# --- many starts ------------------------------------------------------------------------------------------------------

GREY = CookTorrance(0.3, 0.3, 0.15)
OF_GREY = objective(Samples.from_function(GREY, RULE))


def started(*slopes, diffuse=0.5, specular=0.5):
    """Starts of these slopes."""
    return jax.vmap(lambda slope: CookTorrance(diffuse, specular, slope))(jnp.asarray(slopes, DTYPE))


@pytest.mark.slow
def test_one_start_sticks_where_many_do_not():
    """From a highlight too narrow for the samples to see, its width has no slope, and a fit ends as another diffuse."""
    starts = started(0.01, 0.05, 0.3)
    alone = fit(first(starts), OF_GREY, throw=False)
    found = multi_start(starts, OF_GREY, throw=X64)
    assert alone.loss > 0.01
    assert found.best.loss < 1e-6
    assert_close(found.best.model.slope, GREY.slope, tolerance=1e-6 if X64 else 1e-3)
    assert found.chosen in (1, 2)
    assert found.losses[0] > 0.01
    assert found.losses[found.chosen] == found.best.loss
    assert jnp.all(found.losses <= found.start_losses)
    if X64:
        assert found.best.result == Outcome.converged


def test_screening_goes_on_from_where_it_stopped():
    """All steps together are those of the plain fit: the same loss, and the steps of both stages are counted."""
    found = multi_start(started(0.1, 0.9), OF_GREY, screening_steps=2, throw=X64)
    assert found.best.start_losses["data"] < found.start_losses[found.chosen]
    assert found.steps[found.chosen] == 2 + found.best.steps
    assert found.steps[1 - found.chosen] == 2


def test_how_many_starts_agree():
    found = multi_start(started(0.01, 0.1, 0.15, 0.2), OF_GREY, screening_steps=40, throw=X64)
    noise = 1e-10  # all that is left at an exact fit
    close = eqx.tree_at(lambda f: f.losses, found, found.losses + noise)
    close = eqx.tree_at(lambda f: f.best.losses["data"], close, found.best.loss + noise)
    assert close.agreeing() == (3 if X64 else close.agreeing())
    assert close.agreeing(relative=1e12) == 4


@pytest.mark.slow
def test_a_batch_of_materials_is_each_by_itself():
    truths = [CookTorrance(0.2, 0.6, 0.25), CookTorrance(0.5, 0.3, 0.12)]
    values = jnp.stack([truth(RULE.wi, RULE.wo) for truth in truths])

    @eqx.filter_jit
    def one(value):
        samples = Samples(RULE.wi, RULE.wo, value, RULE.weight)
        guesses = initial_guesses(CookTorrance(0.5, 0.5, 0.5), samples, 4)
        return multi_start(guesses, objective(samples), throw=False)

    both = eqx.filter_jit(eqx.filter_vmap(one))(values)
    assert both.losses.shape == (2, 4)
    for i, truth in enumerate(truths):
        alone = one(values[i])
        leaves = (jax.tree.leaves(model) for model in (both.best.model, alone.best.model, truth))
        for got, single, true in zip(*leaves, strict=True):
            assert_close(got[i], single, tolerance=1e-7 if X64 else 1e-3)
            assert_close(got[i], true, tolerance=1e-6 if X64 else 2e-3)


def test_only_what_is_trainable_moves():
    starts = started(0.1, 0.4, specular=0.3)
    found = multi_start(starts, OF_GREY, trainable=lambda b: (b.diffuse, b.slope), throw=X64)
    assert found.best.model.specular == starts.specular[0]
    assert_close(found.best.model.slope, GREY.slope, tolerance=1e-6 if X64 else 1e-3)


def test_a_start_that_is_not_finite_never_wins():
    found = multi_start(started(jnp.nan, 0.2), OF_GREY, throw=X64)
    assert found.chosen == 1
    assert list(found.results == Outcome.nonfinite_start) == [True, False]
    assert_close(found.best.model.slope, GREY.slope, tolerance=1e-6 if X64 else 1e-3)
    hopeless = multi_start(started(jnp.nan, jnp.nan), OF_GREY, throw=False)
    assert hopeless.best.result == Outcome.nonfinite_start
    with pytest.raises(RuntimeError, match="not finite at the start"):
        multi_start(started(jnp.nan, jnp.nan), OF_GREY)


def test_too_few_steps():
    found = multi_start(started(0.9, 0.95), OF_GREY, screening_steps=1, max_steps=1, throw=False)
    assert found.best.result == Outcome.step_limit
    with pytest.raises(RuntimeError, match="raise max_steps"):
        multi_start(started(0.9, 0.95), OF_GREY, screening_steps=1, max_steps=1)


@pytest.mark.parametrize(
    ("starts", "settings", "message"),
    [
        (GREY, {}, "leading axis on every floating array, but diffuse is a scalar"),
        (CookTorrance(np.ones(3) / 3, np.ones(3) / 3, 0.5), {}, "leading axis on every floating array, but slope is"),
        (eqx.tree_at(lambda b: b.slope, started(0.1, 0.2), jnp.ones(3, DTYPE) / 2), {}, r"disagree.*'slope': 3"),
        (eqx.tree_at(lambda b: b.slope, started(0.1, 0.2), jnp.ones(0, DTYPE)), {}, r"disagree.*'slope': 0"),
        (started(), {}, "no start"),
        (started(0.1, 2.0), {}, r"start of slope lies outside its bounds \[0.001, 1\]"),
        (started(0.1, 0.2), {"screening_steps": 0}, "must be at least 1, got 0 and 256"),
        (started(0.1, 0.2), {"trainable": False}, "nothing is trainable"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_what_is_refused(starts, settings, message):
    with pytest.raises(ValueError, match=message):
        multi_start(starts, OF_GREY, **settings)
