"""Rivals of compact models: each finds what lies in its own span."""

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.recipes._compact_metrics import gloss, table
from experiments.recipes._compact_report import classes, random_pairs, summary
from experiments.recipes._compact_rivals import (
    TEMPLATES,
    exponential_series,
    half_vector_series,
    lobe,
    numbers,
)
from hshjax import (
    ABC,
    HSH,
    DielectricFresnel,
    HalfVectorBasis,
    IsotropicBasis,
    Lambert,
    LinearBRDF,
    half_vector_samples,
    total_order,
)
from hshjax.bases import IdentityWarp, RationalWarp
from tests.helpers import X64, directions

pytestmark = pytest.mark.skipif(not X64, reason="studies run in float64")

SHAPE = (24, 8, 3)


def test_half_vector_series_find_their_warp(monkeypatch):
    monkeypatch.setattr("experiments.recipes._compact_rivals.ALPHAS", (1e-3, 1e-2, 1e-1))
    rng = np.random.default_rng(0)
    basis = HalfVectorBasis(total_order(8), RationalWarp(jnp.asarray(0.01)))
    coefficients = jnp.asarray(0.1 * rng.normal(size=(8, 3))).at[0].set(3)  # positive throughout
    truth, flat = LinearBRDF(basis, coefficients), Lambert([0.3, 0.2, 0.1])
    samples = [half_vector_samples(brdf, shape=SHAPE) for brdf in (truth, flat)]
    found = half_vector_series(samples, 8, warped=True)
    assert isinstance(found[0].basis.warp, RationalWarp)
    assert found[0].basis.warp.alpha == pytest.approx(0.01)
    wi, wo = directions(0, 50), directions(1, 50)
    for model, brdf in zip(found, (truth, flat), strict=True):
        np.testing.assert_allclose(model(wi, wo), brdf(wi, wo), rtol=1e-8)
    plain = half_vector_series(samples, 8, warped=False)
    assert all(isinstance(model.basis.warp, IdentityWarp) for model in plain)
    np.testing.assert_allclose(plain[1](wi, wo), flat(wi, wo), rtol=1e-8)
    assert np.max(np.abs(plain[0](wi, wo) / truth(wi, wo) - 1)) > 0.01


def test_exponential_series_find_a_constant():
    samples = half_vector_samples(Lambert([0.3, 0.2, 0.1]), shape=SHAPE)
    (model,) = exponential_series([samples], IsotropicBasis(HSH(2)))
    np.testing.assert_allclose(model(samples.wi, samples.wo), samples.value, rtol=1e-8)


def test_analytic_models_are_counted():
    assert {label: numbers(template()) for label, template in TEMPLATES.items()} == {"GGX": 8, "ABC": 9}


@pytest.mark.slow  # many starts at once take long to compile
def test_analytic_models_are_found():
    truth = ABC(jnp.asarray([0.2, 0.1, 0.05]), jnp.asarray([2.0, 1.5, 1.0]), 300.0, 1.2, DielectricFresnel(1.5))
    samples = half_vector_samples(truth, shape=SHAPE)
    model = lobe(TEMPLATES["ABC"](), samples)
    np.testing.assert_allclose(model(samples.wi, samples.wo), samples.value, rtol=1e-4)


def test_gloss_of_lambert_is_one():
    assert gloss(table(Lambert([0.5, 0.1, 0.3]))) == pytest.approx(1)
    assert gloss(np.array([[1.0, 3.0], [1.0, 1.0], [5.0, 15.0]])) == 5


def rows():
    """Eight materials, of which two are measured; log errors grow with the number of the material."""
    made = []
    for k in range(8):
        for model, n in (
            ("compact", 100),
            ("compact", 150),
            ("HSH", 495),
            ("network", 675),
            ("network, both ways", 675),
        ):
            pairs = None if k > 1 else {100: 2.0, 150: 1.0 + k, 495: 9.0}.get(n, 3.0 if model == "network" else 1.9)
            made.append({
                "n": n, "database": "RGL" if k < 2 else "MERL", "material": f"m{k}", "model": model, "log": n + k,
                "psnr": 30.0, "l2": 0.1, "random_pairs_log": pairs, "max_albedo": 0.5, "seconds": None,
            })  # fmt: skip
    return made


def test_medians_leave_out_what_is_not_there():
    found = {(row["database"], row["model"], row["n"]): row for row in summary(rows())}
    assert found["MERL", "HSH", 495]["log"] == 495 + 4.5
    assert found["MERL", "HSH", 495]["random_pairs_log"] is None
    assert found["RGL", "compact", 150]["random_pairs_log"] == 1.5
    assert found["RGL", "HSH", 495]["seconds"] is None


def test_classes_are_quarters_by_gloss():
    found = classes(rows(), {f"m{k}": 10.0 - k for k in range(8)})
    log = {(row["quarter"], row["model"], row["n"]): row["log"] for row in found}
    assert log == {
        (quarter, model, n): n + k
        for quarter, k in (("smoothest", 6.5), ("sharpest", 0.5))
        for model, n in (("compact", 100), ("compact", 150), ("HSH", 495))
    }


def test_random_pairs_are_compared_material_by_material():
    table, holds = random_pairs(rows(), (100, 150))
    assert [row["material"] for row in table] == ["m0", "m1", "median"]
    assert [row["n = 150 below network"] for row in table] == [True, True, True]
    assert [row["n = 150 below both ways"] for row in table] == [True, False, True]
    assert [row["n = 100 below both ways"] for row in table] == [False, False, False]
    assert list(holds.values()) == [True, False]
