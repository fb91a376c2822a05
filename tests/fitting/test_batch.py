"""Many materials at once: the same fits as one by one."""

import jax.numpy as jnp
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import Lambert, OrenNayar
from hshjax.fitting import Outcome, project, project_all
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, directions

BASIS = IsotropicBasis(HSH(2))
WI, WO = directions(0, 60), directions(1, 60)
BRDFS = [Lambert(jnp.asarray([0.1, 0.5], DTYPE)), OrenNayar(0.4, 0.3), Lambert(0.9)]
MATERIALS = [Samples.scattered(WI, WO, brdf(WI, WO)) for brdf in BRDFS]


def test_each_is_as_by_itself():
    settings = {"norm": "A", "ridge": 1e-3, "prior": "spectral", "covariance": True}
    for fitted, samples in zip(project_all(BASIS, MATERIALS, **settings), MATERIALS, strict=True):
        alone = project(BASIS, samples, reciprocity=False, **settings)
        assert_close(fitted.model.coefficients, alone.model.coefficients)
        assert_close(fitted.residual, alone.residual)
        assert_close(fitted.relative, alone.relative)
        assert_close(fitted.covariance, alone.covariance)
        assert_close(fitted.noise, alone.noise)
        assert fitted.samples == alone.samples


@pytest.mark.parametrize("part", ["wi", "weight"])
def test_other_directions_or_weights_are_refused(part):
    last = MATERIALS[2]
    changed = {"wi": WO if part == "wi" else WI, "weight": last.weight * (2 if part == "weight" else 1)}
    other = Samples(changed["wi"], WO, last.value, changed["weight"])
    with pytest.raises(ValueError, match=f"material 1 differs from material 0 in {part}"):
        project_all(BASIS, [MATERIALS[0], other])


def test_other_refusals():
    with pytest.raises(ValueError, match="at least one material, got none"):
        project_all(BASIS, [])
    with pytest.raises(ValueError, match="does not measure reciprocity"):
        project_all(BASIS, MATERIALS, reciprocity=True)


@pytest.mark.slow
def test_constraints_are_certified_for_each():
    bright = Samples.scattered(WI, WO, 1.4 * Lambert(1.0)(WI, WO))
    settings = {"norm": "C", "ridge": 1e-6, "prior": "spectral", "constraints": ("non_negative", "energy")}
    for fitted, samples in zip(
        project_all(BASIS, [*MATERIALS[1:], bright], **settings), [*MATERIALS[1:], bright], strict=True
    ):
        alone = project(BASIS, samples, reciprocity=False, **settings)
        assert fitted.result == Outcome.converged
        assert fitted.certificate.holds
        assert fitted.certificate.smallest.shape == (1,)
        # Constraints of the others, which do not bind here, leave room for the rounding of the exchange.
        assert_close(fitted.model.coefficients, alone.model.coefficients, tolerance=1e-6 if X64 else 1e-3)
