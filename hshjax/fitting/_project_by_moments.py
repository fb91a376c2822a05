"""The closed form of very many samples: moments in place of a QR factorisation."""

import jax
import jax.numpy as jnp
import numpy as np

from hshjax.bases import AbstractPairBasis
from hshjax.bases._base import matmul
from hshjax.brdfs._linear import LinearBRDF
from hshjax.fitting._checks import check_samples
from hshjax.fitting._misfit import misfit, ratio
from hshjax.fitting._moments import has_moments, normal_equations
from hshjax.fitting._norms import named_norm
from hshjax.fitting._prior import Prior, penalty
from hshjax.fitting._project import _condition, project
from hshjax.fitting._result import Fit
from hshjax.samples import Samples

WELL_CONDITIONED = 300.0
"""Condition number up to which normal equations are solved: squared, it leaves ten digits of float64."""

RESOLVED = 1e-6
"""Share of Σ w f² above which its difference to what the model explains has nine digits."""


def project_by_moments(
    basis: AbstractPairBasis, samples: Samples, *, norm: str = "D", ridge: float = 0.0, prior: Prior | None = None
) -> Fit[LinearBRDF]:
    """`project(basis, samples, norm=norm, ridge=ridge, prior=prior)`, sooner where samples are many: to about ten digits
    the same coefficients, residual and condition, from moments of the samples in one pass.

    For an `IsotropicBasis` of `HSH`, `SHR` or `Zernike`. Every other basis, and samples that leave the condition number
    above 300, go to `project`: `method` of the result is "moments" where it was not needed. Found in float64; the
    result has the dtype of the samples. Reciprocity of the data is not measured. Not under `jax.jit`.

    **Raises:** as `project`.
    """
    chosen, gamma = named_norm(norm), penalty(basis, ridge, prior)
    with jax.enable_x64(True):
        if has_moments(basis):
            dtype = np.result_type(samples.value)
            wide = _in_float64(samples)
            used, _ = check_samples(wide, chosen, basis.count, ridged=gamma is not None)
            gram, right, square = normal_equations(basis, chosen, wide)  # pyright: ignore[reportArgumentType]
            whole = gram if gamma is None else gram + jnp.diag(jnp.asarray(np.asarray(gamma, np.float64)))
            root = jnp.linalg.cholesky(whole, upper=True)  # NaN where it is not positive definite
            condition = _condition(root)
            if bool(condition <= WELL_CONDITIONED):
                coefficients = jax.scipy.linalg.cho_solve((root, False), right)
                error = square - jnp.sum(coefficients * (2 * right - matmul(gram, coefficients)), axis=0)
                model = LinearBRDF(basis, coefficients, chosen.target)
                if chosen.judge_series == chosen.fit and bool(jnp.all(error > RESOLVED * square)):
                    residual, size = jnp.sqrt(error), jnp.sqrt(square)
                else:
                    residual, size = misfit(model, wide, norm)
                found = model.coefficients, residual, ratio(residual, size), condition
                found = [np.asarray(array).astype(dtype) for array in found]
                count = used
            else:
                found = None
        else:
            found = None
    if found is None:
        return project(basis, samples, norm=norm, ridge=ridge, prior=prior, reciprocity=False)
    coefficients, residual, relative, condition = map(jnp.asarray, found)
    model = LinearBRDF(basis, coefficients, chosen.target)
    return Fit(
        model, residual, relative, condition, norm=norm, method="moments", samples=count, unknowns=basis.count
    )


def _in_float64(samples: Samples) -> Samples:
    parts = (jnp.asarray(np.asarray(part, np.float64)) for part in (samples.wi, samples.wo, samples.value, samples.weight))
    return Samples(*parts, None, samples.isotropic)
