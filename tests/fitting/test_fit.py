"""`fit` against closed forms, by every kind of solver, and what it says when it cannot."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx
import pytest

from hshjax.bases import HSH, HelmholtzBasis, IsotropicBasis, TensorBasis, Zernike, to_matrix
from hshjax.brdfs import GGX, CookTorrance, Lambert, LinearBRDF
from hshjax.fitting import (
    CosineWeighted,
    Jaxopt,
    LevenbergMarquardt,
    Outcome,
    Prior,
    Reciprocity,
    SampleMisfit,
    Sparsity,
    fit,
    project,
)
from hshjax.fitting._terms import AbstractTerm
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, directions, mostly_slow

BASIS = IsotropicBasis(HSH(2))
WI, WO = directions(0, 120), directions(1, 120)
NOISE = jnp.asarray(np.random.default_rng(2).normal(size=(120, 2)), DTYPE)
SAMPLES = Samples.scattered(WI, WO, NOISE, jnp.asarray(np.random.default_rng(3).uniform(0.5, 2, 120), DTYPE))
RIDGE = 0.7


def zeros(basis=BASIS, channels=2):
    return LinearBRDF(basis, jnp.zeros((basis.count, channels), DTYPE))


OBJECTIVE = {"data": SampleMisfit(SAMPLES), "ridge": RIDGE * Prior(zeros())}
FINE = 1e-10 if X64 else 1e-5


def jaxopt_solver(name, **options):
    import jaxopt

    return Jaxopt(getattr(jaxopt, name), **options)


# Solver and the relative agreement with the closed form in float64. Newton-like solvers end at rounding; those that
# see gradients only end where the loss, flat to sqrt(eps), tells nothing more, or at their tolerance.
SOLVERS = {
    "GaussNewton": (optx.GaussNewton(rtol=FINE, atol=FINE), 1e-12),
    "LevenbergMarquardt": (LevenbergMarquardt(rtol=FINE, atol=FINE), 1e-10),
    "optimistix_LevenbergMarquardt": (optx.LevenbergMarquardt(rtol=FINE, atol=FINE), 1e-10),
    "Dogleg": (optx.Dogleg(rtol=FINE, atol=FINE), 1e-10),
    "BFGS": (optx.BFGS(rtol=FINE, atol=FINE), 1e-6),
    "LBFGS": (optx.LBFGS(rtol=FINE, atol=FINE), 1e-6),
    "NonlinearCG": (optx.NonlinearCG(rtol=FINE, atol=FINE), 1e-6),
    "optax": (optx.OptaxMinimiser(optax.adam(0.05), rtol=1e-8 if X64 else 1e-5, atol=1e-8 if X64 else 1e-5), 1e-3),
    "jaxopt_LevenbergMarquardt": (jaxopt_solver("LevenbergMarquardt", tol=1e-9 if X64 else 1e-3), 1e-8),
    "jaxopt_LBFGS": (jaxopt_solver("LBFGS", tol=1e-9 if X64 else 1e-3), 1e-8),
    "jaxopt_LBFGSB": (jaxopt_solver("LBFGSB", tol=1e-7 if X64 else 1e-3), 1e-7),
}


@pytest.mark.parametrize("name", mostly_slow(SOLVERS, ("GaussNewton", "LevenbergMarquardt", "BFGS", "optax")))
def test_every_solver_finds_the_closed_form(name):
    solver, tolerance = SOLVERS[name]
    exact = project(BASIS, SAMPLES, norm="C", ridge=RIDGE, reciprocity=False).model.coefficients
    # optax mixes integers and floats in its schedules.
    with jax.numpy_dtype_promotion("standard" if name == "optax" else "strict"):
        found = fit(zeros(), OBJECTIVE, solver, max_steps=3000, throw=X64)
    scale = float(jnp.max(jnp.abs(exact)))
    assert_close(found.model.coefficients / scale, exact / scale, tolerance=tolerance if X64 else 5e-3)
    steps = int(found.steps)
    assert_close(found.curve[0], sum(found.start_losses.values()))
    assert_close(found.curve[steps:], jnp.full(3001 - steps, found.loss))
    assert_close(found.losses["data"] + found.losses["ridge"], found.loss)
    assert found.loss < sum(found.start_losses.values())
    if X64:
        assert found.result == Outcome.converged
        assert found.message == "converged"


@pytest.mark.slow
def test_soft_reciprocity_becomes_the_helmholtz_fit():
    """A heavy penalty on A - Aᵀ and the basis that knows no other: the same coefficients."""
    tensor, helmholtz = TensorBasis(Zernike(1)), HelmholtzBasis(Zernike(1))
    exact = to_matrix(helmholtz, project(helmholtz, SAMPLES, norm="C", reciprocity=False).model.coefficients)
    distances = []
    for weight in (1e2, 1e4, 1e6, 1e10 if X64 else 1e6):
        objective = {"data": SampleMisfit(SAMPLES), "swap": weight * Reciprocity()}
        found = fit(zeros(tensor), objective, optx.GaussNewton(rtol=FINE, atol=FINE), throw=X64)
        distances.append(float(jnp.max(jnp.abs(to_matrix(tensor, found.model.coefficients) - exact))))
    scale = float(jnp.max(jnp.abs(exact)))
    assert distances[0] > distances[1] > distances[2]
    assert distances[-1] < (1e-8 if X64 else 1e-3) * scale


TRUTH = CookTorrance(0.3, 0.5, 0.3)
RULE = isotropic_pair_rule(12, dtype=DTYPE)
CLEAN = Samples.from_function(TRUTH, RULE)


def test_bounded_parameters_are_recovered():
    found = fit(CookTorrance(0.5, 0.5, 0.5), {"data": SampleMisfit(CLEAN)}, throw=X64)
    for got, true in zip(jax.tree.leaves(found.model), jax.tree.leaves(TRUTH), strict=True):
        assert_close(got, true, tolerance=1e-6 if X64 else 1e-3)
    assert not any(np.any(where) for where in found.on_bound.values())


def test_a_fit_that_ends_on_a_bound_says_so():
    too_bright = CLEAN.reweighted(CLEAN.weight)
    too_bright = eqx.tree_at(lambda s: s.value, too_bright, 3 + 0 * CLEAN.value)
    found = fit(Lambert(0.5), {"data": SampleMisfit(too_bright)}, throw=X64)
    assert_close(found.model.albedo, 1.0)
    assert found.on_bound == {"albedo": True}
    assert found.message == "converged; on a bound: albedo" or not X64


BEYOND = Samples(CLEAN.wi, CLEAN.wo, 3 * GGX(1.0, 0.3)(CLEAN.wi, CLEAN.wo), CLEAN.weight)
"""Three times what a lobe can be."""


def test_a_fit_ends_on_the_upper_bound_of_a_box_that_does_not_begin_at_0():
    """Half a lobe of roughness 1 and less towards the normal: no roughness in [0.001, 1] is rough enough."""
    z = CLEAN.wi[:, 2:] * CLEAN.wo[:, 2:]
    flat = Samples(CLEAN.wi, CLEAN.wo, GGX(0.4, 1.0)(CLEAN.wi, CLEAN.wo) * (1.2 - z), CLEAN.weight)
    found = fit(GGX(0.3, 0.6), {"data": SampleMisfit(flat)}, throw=X64)
    assert found.model.roughness == 1
    assert found.on_bound["roughness"]
    again = fit(found.model, {"data": SampleMisfit(flat)}, throw=X64)  # it is in its own box
    assert_close(again.model.specular, found.model.specular, tolerance=1e-6 if X64 else 1e-3)


class Difference(AbstractTerm):
    """To something that the term closes over."""

    function: Callable = eqx.field(static=True)

    def __call__(self, model):
        return self.function(model)


def test_what_a_term_closes_over_is_mapped_and_differentiated():
    def end(value):
        terms = {"data": Difference(lambda model: jnp.exp(model.albedo) - value)}
        return fit(Lambert(0.5), terms, throw=False).model.albedo

    values = jnp.asarray([1.2, 1.5, 2.0], DTYPE)
    tolerance = 1e-7 if X64 else 1e-3
    assert_close(jax.vmap(end)(values), jnp.log(values), tolerance=tolerance)
    assert_close(jax.vmap(jax.grad(end))(values), 1 / values, tolerance=tolerance)
    assert_close(jax.jit(jax.grad(end))(values[0]), 1 / values[0], tolerance=tolerance)


def test_the_gradient_tells_a_bound_that_is_left_from_one_that_holds():
    """At albedo 0, one step before the end: the loss falls towards the inside."""
    found = fit(Lambert(0.0), {"data": SampleMisfit(BEYOND)}, max_steps=1, throw=False)
    assert found.gradient_norm > 1e-2
    assert fit(Lambert(0.0), {"data": SampleMisfit(BEYOND)}, throw=False).gradient_norm == 0


@pytest.mark.slow
def test_a_fit_to_a_bound_takes_no_more_steps_than_another():
    """The lobe is pushed beyond specular 1: no slope of a transformation vanishes on the way."""
    objective = {"data": SampleMisfit(BEYOND, CosineWeighted())}
    found = fit(Lambert(0.2) + GGX(0.5, 0.3), objective, throw=X64, trainable=lambda b: (b.a, b.b.specular))
    assert found.on_bound["b.specular"]
    assert found.model.b.specular == 1
    assert found.gradient_norm < 1e-6 or not X64
    assert found.steps < 20
    # From the bound itself there is a way back.
    assert fit(found.model, {"data": SampleMisfit(CLEAN)}, throw=False).model.b.specular < 1


@pytest.mark.slow
@pytest.mark.skipif(not X64, reason="finite differences")
def test_the_derivative_of_a_fit_to_a_bound():
    """What ends on its bound stays there; the rest follows the data."""

    def end(scale):
        data = Samples(CLEAN.wi, CLEAN.wo, scale / 3 * BEYOND.value, CLEAN.weight)
        found = fit(Lambert(0.2) + GGX(0.5, 0.5), {"data": SampleMisfit(data, CosineWeighted())}, throw=False)
        return jnp.stack([found.model.a.albedo, found.model.b.specular, found.model.b.roughness])

    slope = jax.jacfwd(end)(3.0)
    step = 1e-4
    assert abs(slope[1]) < 1e-30
    # Fits end at 1e-8 of the optimum, and 1e-4 is small against the curvature.
    assert_close(slope, (end(3 + step) - end(3 - step)) / (2 * step), tolerance=1e-5)


def test_only_what_is_trainable_moves():
    start = CookTorrance(0.5, 0.4, 0.5)
    found = fit(start, {"data": SampleMisfit(CLEAN)}, trainable=lambda b: (b.diffuse, b.slope), throw=X64)
    assert found.model.specular == start.specular
    assert found.model.slope != start.slope
    mask = eqx.tree_at(lambda b: b.specular, jax.tree.map(lambda _: True, start), False)
    same = fit(start, {"data": SampleMisfit(CLEAN)}, trainable=mask, throw=X64)
    assert_close(same.model.slope, found.model.slope, tolerance=1e-6 if X64 else 1e-3)


def test_steps_do_not_depend_on_units():
    """Of the residuals, nor of a parameter: the damping is relative."""
    start = CookTorrance(0.5, 0.5, 0.5)
    plain, heavy = (
        fit(start, {"data": weight * SampleMisfit(CLEAN)}, max_steps=30, throw=X64) for weight in (1.0, 1e6)
    )
    assert plain.steps == heavy.steps or not X64
    assert_close(plain.model.slope, heavy.model.slope, tolerance=1e-6 if X64 else 1e-3)

    class Milli(AbstractTerm):
        """The same model in other units of its slope."""

        def __call__(self, model):
            return SampleMisfit(CLEAN)(CookTorrance(model["diffuse"], 0.5, model["slope"] / 1000))

    small = {"diffuse": jnp.asarray(0.5, DTYPE), "slope": jnp.asarray(500.0, DTYPE)}
    found = fit(small, {"data": Milli()}, max_steps=30, throw=X64)
    assert_close(found.model["slope"] / 1000, TRUTH.slope, tolerance=1e-6 if X64 else 1e-3)


@pytest.mark.parametrize("name", mostly_slow(["LBFGSB", "ProjectedGradient"], ["ProjectedGradient"]))
def test_a_solver_that_keeps_boxes(name):
    """On the box constraint of a quadratic: the unconstrained optimum is outside."""
    value = jnp.broadcast_to(jnp.asarray([[0.1, 2.0]], DTYPE), (CLEAN.size, 2))
    bright = Samples(CLEAN.wi, CLEAN.wo, value, CLEAN.weight)
    solver = jaxopt_solver(name, tol=1e-7 if X64 else 1e-4)
    found = fit(Lambert(jnp.asarray([0.5, 0.5], DTYPE)), {"data": SampleMisfit(bright)}, solver, max_steps=500)
    assert_close(found.model.albedo, jnp.asarray([0.1 * np.pi, 1.0]), tolerance=1e-6 if X64 else 1e-3)
    assert list(found.on_bound["albedo"]) == [False, True]


@pytest.mark.slow
def test_sparsity_is_a_soft_threshold():
    """On an orthonormal design the L1 optimum is the projection, shrunk towards 0 by the weight."""
    rule = isotropic_pair_rule(4, dtype=DTYPE)
    samples = Samples(rule.wi, rule.wo, jnp.sin(5 * rule.wi[:, :1] + 3 * rule.wo[:, 1:2]), rule.weight)
    plain = project(BASIS, Samples(*jax.tree.leaves(samples), rule.degree, True), norm="C", reciprocity=False)
    coefficients = plain.model.coefficients
    weight = float(jnp.median(jnp.abs(coefficients)))
    solver = jaxopt_solver("ProximalGradient", tol=1e-9 if X64 else 1e-5)
    objective = {"data": SampleMisfit(samples), "sparse": weight * Sparsity()}
    found = fit(zeros(channels=1), objective, solver, max_steps=500)
    expected = jnp.sign(coefficients) * jnp.maximum(jnp.abs(coefficients) - weight, 0)
    assert_close(found.model.coefficients, expected, tolerance=1e-7 if X64 else 1e-4)
    assert jnp.sum(found.model.coefficients == 0) >= BASIS.count // 2
    assert_close(found.losses["sparse"], weight * jnp.sum(jnp.abs(expected)), tolerance=1e-6 if X64 else 1e-3)


def test_a_batch_of_materials_is_each_by_itself():
    truths = [CookTorrance(0.2, 0.6, 0.25), CookTorrance(0.5, 0.3, 0.4)]
    values = jnp.stack([truth(RULE.wi, RULE.wo) for truth in truths])

    def one(value):
        samples = Samples(RULE.wi, RULE.wo, value, RULE.weight)
        return fit(CookTorrance(0.5, 0.5, 0.5), {"data": SampleMisfit(samples)}, throw=False)

    both = eqx.filter_vmap(one)(values)
    assert both.curve.shape == (2, 257)
    for i, truth in enumerate(truths):
        for got, true in zip(jax.tree.leaves(both.model), jax.tree.leaves(truth), strict=True):
            assert_close(got[i], true, tolerance=1e-6 if X64 else 2e-3)


def test_a_batch_of_materials_under_jit_and_gradients_of_a_fit():
    """d(fitted albedo)/d(datum) of a Lambert surface is in closed form: its weight over the sum of weights, times π."""

    @jax.jit
    def albedo(value):
        samples = Samples(WI, WO, value, SAMPLES.weight)
        return fit(Lambert(0.5), {"data": SampleMisfit(samples)}, throw=False).model.albedo

    value = jnp.full((120, 1), 0.1, DTYPE)
    assert_close(albedo(value), 0.1 * np.pi)
    gradient = jax.grad(albedo)(value)
    assert_close(gradient[:, 0], np.pi * SAMPLES.weight / jnp.sum(SAMPLES.weight), tolerance=1e-7 if X64 else 1e-4)


@pytest.mark.skipif(not X64, reason="a difference quotient of a fit in float32 has no digits")
@pytest.mark.parametrize("name", mostly_slow(["LevenbergMarquardt", "BFGS", "jaxopt_LBFGS"], ["BFGS"]))
def test_gradient_of_a_fit_against_differences(name):
    def slope(scale):
        samples = eqx.tree_at(lambda s: s.value, CLEAN, CLEAN.value * (1 + scale * CLEAN.wi[:, 2:]))
        return fit(
            CookTorrance(0.4, 0.4, 0.4), {"data": SampleMisfit(samples)}, SOLVERS[name][0], max_steps=500
        ).model.slope

    step = 1e-4
    assert_close(jax.grad(slope)(0.1), (slope(0.1 + step) - slope(0.1 - step)) / (2 * step), tolerance=1e-6)


def test_held_parts_are_differentiable():
    def diffuse(specular):
        start = CookTorrance(0.5, specular, 0.3)
        return fit(start, {"data": SampleMisfit(CLEAN)}, trainable=lambda b: b.diffuse, throw=False).model.diffuse

    slope = jax.grad(diffuse)(jnp.asarray(0.4, DTYPE))
    step = 1e-2  # diffuse is linear in specular: any step is exact
    assert_close(slope, (diffuse(0.4 + step) - diffuse(0.4 - step)) / (2 * step), tolerance=1e-6 if X64 else 2e-2)


class Activated(eqx.Module):
    """A model with a part that is no array."""

    value: jax.Array
    activation: Callable

    def __call__(self, wi, wo):
        return jnp.broadcast_to(self.activation(self.value), (wi.shape[0], 1))


@pytest.mark.parametrize("solver", [None, jaxopt_solver("LBFGS", tol=1e-7 if X64 else 1e-3)], ids=["default", "jaxopt"])
def test_a_model_may_hold_what_is_no_array(solver):
    samples = Samples.scattered(WI, WO, jnp.full((120, 1), 0.2, DTYPE))
    start = Activated(jnp.asarray(-1.0, DTYPE), jax.nn.softplus)
    found = fit(start, {"data": SampleMisfit(samples)}, solver, throw=X64)
    assert_close(found.model(WI, WO), samples.value, tolerance=1e-7 if X64 else 1e-3)


def test_a_start_outside_its_bounds_is_no_start_under_jit():
    found = jax.jit(lambda albedo: fit(Lambert(albedo), {"data": SampleMisfit(CLEAN)}, throw=False).result)(5.0)
    assert found == Outcome.nonfinite_start


def test_steps_are_reported():
    seen = []
    found = fit(zeros(), OBJECTIVE, on_step=lambda step, loss: seen.append((int(step), float(loss))), throw=False)
    jax.effects_barrier()
    assert [step for step, _ in sorted(seen)] == list(range(int(found.steps)))
    assert_close([loss for _, loss in sorted(seen)], found.curve[: int(found.steps)])


# --- what is refused, and how -----------------------------------------------------------------------------------------


class Wrong(AbstractTerm):
    """A term that returns integers."""

    def __call__(self, model):
        return jnp.arange(3)


class Nan(AbstractTerm):
    """A term without a value at any model."""

    def __call__(self, model):
        return jnp.log(-jnp.abs(model.albedo) - 1)


@pytest.mark.parametrize(
    ("model", "objective", "settings", "message"),
    [
        (Lambert(0.5), {}, {}, "objective must map names to terms"),
        (Lambert(0.5), {"data": 3}, {}, "'data' must be a term such as SampleMisfit, got int"),
        (Lambert(0.5), {"wrong": Wrong()}, {}, "'wrong' must return floating arrays"),
        (Lambert(0.5), {"sparse": Sparsity()}, {}, "L1 norm"),
        (Lambert(1.5), {"data": SampleMisfit(CLEAN)}, {}, r"start of albedo lies outside its bounds \[0, 1\]"),
        (Lambert(jnp.nan), {"data": SampleMisfit(CLEAN)}, {}, "start of albedo is not finite"),
        (Lambert(0.5), {"data": SampleMisfit(CLEAN)}, {"max_steps": 0}, "max_steps must be at least 1"),
        (Lambert(0.5), {"data": SampleMisfit(CLEAN)}, {"trainable": False}, "nothing is trainable"),
        (Lambert(0.5), {"data": SampleMisfit(SAMPLES)}, {}, r"the samples have \(120, 2\)"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_what_is_refused(model, objective, settings, message):
    with pytest.raises(ValueError, match=message):
        fit(model, objective, **settings)


def test_a_loss_that_is_not_finite_at_the_start():
    found = fit(Lambert(0.5), {"data": SampleMisfit(CLEAN), "bad": Nan()}, throw=False)
    assert found.result == Outcome.nonfinite_start
    assert jnp.isnan(found.start_losses["bad"])
    with pytest.raises(RuntimeError, match=r"not finite at the start.*losses at the start: .*bad nan"):
        fit(Lambert(0.5), {"data": SampleMisfit(CLEAN), "bad": Nan()})


def test_a_parameter_that_is_not_finite_is_told_where_the_loss_is_finite():
    """Cook-Torrance has no highlight at a slope of NaN, but a value; only under jit can such a start come this far."""
    found = jax.jit(lambda slope: fit(CookTorrance(0.5, 0.5, slope), {"data": SampleMisfit(CLEAN)}, throw=False))(
        jnp.asarray(jnp.nan, DTYPE)
    )
    assert found.result == Outcome.nonfinite_start
    assert jnp.isfinite(found.start_losses["data"])


def test_too_few_steps():
    start = CookTorrance(0.5, 0.5, 0.9)
    found = fit(start, {"data": SampleMisfit(CLEAN)}, max_steps=2, throw=False)
    assert found.result == Outcome.step_limit
    assert found.steps == 2
    with pytest.raises(RuntimeError, match=r"raise max_steps.*Steps: 2; losses at the start: data"):
        fit(start, {"data": SampleMisfit(CLEAN)}, max_steps=2)


def test_a_diverging_step_is_no_success():
    solver = optx.OptaxMinimiser(optax.sgd(1e30), rtol=1e-6, atol=1e-6)
    found = fit(zeros(), OBJECTIVE, solver, max_steps=50, throw=False)
    assert found.result in (Outcome.nonfinite, Outcome.step_limit)
    assert found.result != Outcome.converged
