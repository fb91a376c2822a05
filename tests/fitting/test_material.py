"""One material, one call: which basis samples are fitted by."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, HelmholtzBasis, IsotropicBasis
from hshjax.fitting import fit_material
from hshjax.samples import Samples
from tests.helpers import DTYPE, directions


def brushed(wi, wo):
    """Reciprocal, smooth, and different along x and y."""
    return (0.3 + 0.25 * wi[..., :1] * wo[..., :1]).astype(DTYPE)


def scattered(n: int, *, isotropic: bool = False) -> Samples:
    wi, wo = (jnp.asarray(directions(k, n, min_z=0.05), DTYPE) for k in (1, 2))
    return Samples.scattered(wi, wo, brushed(wi, wo), isotropic=isotropic)


def error(found, samples) -> float:
    wanted = np.asarray(samples.value)
    return float(np.linalg.norm(np.asarray(found.model(samples.wi, samples.wo)) - wanted) / np.linalg.norm(wanted))


def test_samples_of_an_anisotropic_material_are_followed():
    basis, samples = IsotropicBasis(HSH(2)), scattered(400)
    found = fit_material(samples, "linear", basis=basis)
    assert found.model.basis == HelmholtzBasis(HSH(2))
    assert "fitted as an anisotropic one, by 45 functions" in found.notes[0]
    assert error(found, scattered(500)) < 0.06  # of a series of order 2, near the horizon above all
    assert error(fit_material(scattered(400, isotropic=True), "linear", basis=basis), samples) > 0.1


@pytest.mark.slow
def test_what_cannot_follow_them_says_so():
    found = fit_material(scattered(40), "linear", basis=IsotropicBasis(HSH(2)))
    assert "40 samples do not determine 45 functions: fitted as an isotropic one" in found.notes[0]
    assert found.model.basis.isotropic
    found = fit_material(scattered(400), "exp", basis=IsotropicBasis(HSH(1)), max_steps=2)
    assert "fitted as an isotropic one all the same; a linear model could follow another" in found.notes[0]


@pytest.mark.slow
def test_isotropic_samples_and_a_chosen_basis_need_no_word():
    assert fit_material(scattered(100, isotropic=True), "linear", basis=IsotropicBasis(HSH(2))).notes == ()
    found = fit_material(scattered(100), "linear", basis=HelmholtzBasis(HSH(1)))
    assert found.model.basis == HelmholtzBasis(HSH(1))
    assert found.notes == ()


def test_light_from_one_azimuth_says_nothing_of_others():
    samples = scattered(100)
    theta = jnp.arccos(samples.wi[:, 2])
    wi = jnp.stack([jnp.sin(theta), jnp.zeros_like(theta), jnp.cos(theta)], axis=1)
    found = fit_material(Samples.scattered(wi, samples.wo, samples.value), "linear", basis=IsotropicBasis(HSH(2)))
    assert found.model.basis.isotropic
    assert found.notes == ("light comes from one azimuth: fitted as an isotropic material",)


@pytest.mark.parametrize("model", ["exp", "ggx", "cook-torrance"])
@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_values_that_are_not_finite_are_refused_by_every_model(model, value):
    samples = scattered(40)
    bad = Samples.scattered(samples.wi, samples.wo, samples.value.at[7].set(value))
    with pytest.raises(ValueError, match=r"1 of 40 .* hold NaN or infinite values \(the first is sample 7\)"):
        fit_material(bad, model)
