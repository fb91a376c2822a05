"""Every BRDF of the library, bit by bit to a file and back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import (
    HSH,
    SHR,
    AnisotropicHalfVectorBasis,
    HalfVectorBasis,
    HelmholtzBasis,
    IsotropicBasis,
    RationalWarp,
    SphericalHarmonics,
    TensorBasis,
    Zernike,
)
from hshjax.brdfs import LinearBRDF, LogLinearBRDF
from hshjax.io import load_model, save_model
from tests.brdfs.cases import ALL_BRDFS
from tests.helpers import DTYPE, directions


def linear(basis, target="brdf", channels=3):
    rng = np.random.default_rng(0)
    return LinearBRDF(basis, jnp.asarray(rng.normal(size=(len(basis.modes), channels)), DTYPE), target)


MODELS = {
    **ALL_BRDFS,
    **{
        f"linear_{target}": linear(HelmholtzBasis(HSH(2)), target) for target in ("half_foreshortened", "foreshortened")
    },
    "linear_tensor": linear(TensorBasis(Zernike(2))),
    "linear_isotropic": linear(IsotropicBasis(SHR(3)), channels=1),
    "linear_lopsided": linear(IsotropicBasis(HSH(3), bilateral=False)),
    "linear_spherical": linear(HelmholtzBasis(SphericalHarmonics(1))),
    "linear_half_vector": linear(HalfVectorBasis(9, *(RationalWarp(jnp.asarray(a, DTYPE)) for a in (0.02, 0.1)))),
    "log_linear_anisotropic": LogLinearBRDF(AnisotropicHalfVectorBasis(9), list(jnp.ones((3, 9), DTYPE) / 9)),
    "linear_and_analytic": linear(IsotropicBasis(HSH(2))) + 0.5 * ALL_BRDFS["lambert_rgb"],
}


@pytest.mark.parametrize("name", MODELS)
def test_there_and_back(name, tmp_path):
    model = MODELS[name]
    save_model(tmp_path / "a.model", model)
    loaded = load_model(tmp_path / "a.model")
    leaves, tree = jax.tree.flatten(model)
    loaded_leaves, loaded_tree = jax.tree.flatten(loaded)
    # The structure holds the classes and every static field: targets, orders, switches.
    assert loaded_tree == tree
    for a, b in zip(leaves, loaded_leaves, strict=True):
        assert (type(a), a.dtype, a.shape) == (type(b), b.dtype, b.shape)
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    wi, wo = directions(0, 500), directions(1, 500)
    assert np.array_equal(model(wi, wo), loaded(wi, wo))
