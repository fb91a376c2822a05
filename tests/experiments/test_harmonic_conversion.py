"""What the study of series keeps of a compact fit is the whole fit."""

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import stages
from experiments.recipes.harmonic_conversion import Config, _compact, _model
from hshjax.fitting import fit_compact, half_vector_samples
from tests.helpers import X64

pytestmark = pytest.mark.skipif(not X64, reason="studies choose their own precision")


def base(wi, wo):
    return 0.1 + 0.02 * wi[:, 2:] * wo[:, 2:]


def retro_reflector(wi, wo):
    return base(wi, wo) + 5 * jnp.exp(-jnp.sum((wi - wo) ** 2, axis=-1, keepdims=True) / 0.05**2)


def test_a_model_comes_back_from_its_stage(tmp_path):
    """With a warp of the difference angle and without one."""
    samples = [half_vector_samples(brdf, shape=(12, 40, 4)) for brdf in (retro_reflector, base)]
    kept = _compact(Config.model_construct(coefficients=20), dict(zip("ab", samples, strict=True)))
    stages.save(tmp_path / "kept.npz", kept)
    back = stages.load(tmp_path / "kept.npz")
    fits = [fit_compact(one, 20) for one in samples]
    assert fits[0].beta is not None
    assert fits[1].beta is None
    for one, fit in zip(back, fits, strict=True):
        model, pairs = _model(one), (samples[0].wi, samples[0].wo)
        np.testing.assert_allclose(model(*pairs), fit.model(*pairs), rtol=1e-8)
