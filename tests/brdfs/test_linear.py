"""The series that is a BRDF: its targets, its horizon, its shapes."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, SHR, HelmholtzBasis, IsotropicBasis, TensorBasis, Zernike
from hshjax.brdfs import LinearBRDF
from tests.helpers import DTYPE, X64, assert_close, directions, slow_unless

TARGETS = {"brdf": 0.0, "half_foreshortened": 0.5, "foreshortened": 1.0}
"""p of the factor (z_i z_o)^p between the BRDF and the series."""

BASES = {
    "tensor": TensorBasis(Zernike(2)),
    "helmholtz": HelmholtzBasis(HSH(2)),
    "isotropic": IsotropicBasis(SHR(3), bilateral=False),
}
each_target = pytest.mark.parametrize("target", TARGETS)
# A target is a factor, whatever the basis: every pair of them runs in `make test-slow`.
KEPT = (("tensor", "brdf"), ("helmholtz", "half_foreshortened"), ("isotropic", "foreshortened"))
each_target_and_basis = pytest.mark.parametrize(
    ("target", "basis"),
    [
        slow_unless((name, target) in KEPT, target, basis, id=f"{name}-{target}")
        for target in TARGETS
        for name, basis in BASES.items()
    ],
)


def model(basis, target, channels=2):
    rng = np.random.default_rng(0)
    return LinearBRDF(basis, jnp.asarray(rng.normal(size=(len(basis.modes), channels)), DTYPE), target)


@each_target_and_basis
def test_the_series_is_that_of_the_target(basis, target):
    brdf = model(basis, target)
    wi, wo = directions(1, 50, min_z=0.05), directions(2, 50, min_z=0.05)
    foreshortening = (wi[:, 2:] * wo[:, 2:]) ** TARGETS[target]
    assert_close(brdf(wi, wo), basis(wi, wo) @ brdf.coefficients / foreshortening)
    assert brdf.channels == 2
    assert brdf(wi, wo[0]).shape == (50, 2)
    assert brdf(wi[0], wo[0]).shape == (2,)
    assert brdf(wi[:0], wo[:0]).shape == (0, 2)
    assert_close(jax.jit(lambda b, i, o: b(i, o))(brdf, wi, wo), brdf(wi, wo))


def test_the_target_is_the_brdf_unless_stated():
    assert LinearBRDF(BASES["tensor"], jnp.zeros((36, 1), DTYPE)).target == "brdf"


@each_target
def test_finite_on_the_open_hemisphere(target):
    """rho = g / (z_i z_o) is large towards grazing, and finite for every z that the dtype holds comfortably."""
    z = jnp.asarray([1e-12 if X64 else 1e-6], DTYPE)
    grazing = jnp.stack([jnp.sqrt(1 - z * z), jnp.zeros_like(z), z], axis=-1)
    value = model(BASES["tensor"], target)(grazing, grazing)
    assert jnp.all(jnp.isfinite(value))
    assert jnp.all(value != 0)


@each_target_and_basis
def test_zero_with_zero_gradient_outside_the_open_hemisphere(basis, target):
    brdf = model(basis, target)
    up = jnp.asarray([0.6, 0.0, 0.8], DTYPE)
    outside = [jnp.asarray(w, DTYPE) for w in ([0.6, 0.0, -0.8], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0])]
    wi, wo = (jnp.stack(side) for side in zip(*[(w, up) for w in outside], *[(up, w) for w in outside], strict=True))
    value, pullback = jax.vjp(lambda b, i, o: b(i, o), brdf, wi, wo)
    assert jnp.all(value == 0)
    for leaf in jax.tree.leaves(pullback(jnp.ones_like(value))):
        assert jnp.all(leaf == 0)


@pytest.mark.skipif(not X64, reason="differences need float64")
@each_target_and_basis
def test_gradients_are_those_of_differences(basis, target):
    """In directions and coefficients, by central differences."""
    brdf = model(basis, target)
    rng = np.random.default_rng(3)
    point = (brdf.coefficients, directions(4, 6, min_z=0.2), directions(5, 6, min_z=0.2))
    tangent = tuple(jnp.asarray(rng.normal(size=a.shape)) for a in point)

    @jax.jit
    def value(coefficients, wi, wo):
        return jnp.sum(LinearBRDF(basis, coefficients, target)(wi, wo) ** 2)

    slope = sum(jnp.sum(g * t) for g, t in zip(jax.grad(value, (0, 1, 2))(*point), tangent, strict=True))
    step = 1e-5
    there, back = (value(*(p + s * t for p, t in zip(point, tangent, strict=True))) for s in (step, -step))
    assert_close(slope, (there - back) / (2 * step), tolerance=1e-6)  # step² times third derivatives


@pytest.mark.parametrize("dtype", ["float32", "float64"] if X64 else ["float32"])
@each_target
def test_the_dtype_is_that_of_the_directions(target, dtype):
    wi, wo = (w.astype(dtype) for w in (directions(6, 4), directions(7, 4)))
    assert model(BASES["helmholtz"], target)(wi, wo).dtype == dtype


@pytest.mark.parametrize("shape", [(36,), (35, 1), (37, 3), (36, 3, 1), ()])
def test_coefficients_of_another_shape_are_refused(shape):
    with pytest.raises(ValueError, match=re.escape(f"must have shape (36, channels), got {shape}")):
        LinearBRDF(BASES["tensor"], jnp.zeros(shape, DTYPE))


def test_unknown_targets_are_refused():
    with pytest.raises(
        ValueError, match=r"target must be one of brdf, half_foreshortened, foreshortened, got 'cosine'"
    ):
        LinearBRDF(BASES["tensor"], jnp.zeros((36, 1), DTYPE), "cosine")


def test_batches_of_coefficients():
    """A constructor that checks must still let `vmap` pass."""
    basis, coefficients = BASES["helmholtz"], model(BASES["helmholtz"], "brdf", 3).coefficients
    wi, wo = directions(8, 5), directions(9, 5)
    batch = jax.vmap(lambda c: LinearBRDF(basis, c[:, None])(wi, wo), in_axes=1)(coefficients)
    assert_close(jnp.moveaxis(batch[..., 0], 0, 1), LinearBRDF(basis, coefficients)(wi, wo))
