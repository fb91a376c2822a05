"""The closed form of very many samples: moments in place of a QR factorisation."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array
from hshjax.bases import AbstractPairBasis, IsotropicBasis
from hshjax.bases._base import matmul
from hshjax.brdfs import HalfVectorTable
from hshjax.brdfs._linear import LinearBRDF
from hshjax.fitting._checks import check_enough, check_samples
from hshjax.fitting._misfit import misfit, ratio
from hshjax.fitting._moments import Equations, has_moments, normal_equations, pay
from hshjax.fitting._norms import Norm, named_norm
from hshjax.fitting._prior import Prior, penalty
from hshjax.fitting._project import _condition, project
from hshjax.fitting._result import Fit
from hshjax.fitting._table_moments import table_equations
from hshjax.geometry import common_dtype
from hshjax.samples import Samples

WELL_CONDITIONED = 300.0
"""Condition number up to which normal equations are solved: squared, it leaves ten digits of float64."""

RESOLVED = 1e-6
"""Share of Σ w f² above which its difference to what the model explains has nine digits."""


def project_by_moments(
    basis: AbstractPairBasis,
    samples: Samples | HalfVectorTable,
    *,
    norm: str = "D",
    ridge: float = 0.0,
    prior: Prior | None = None,
) -> Fit[LinearBRDF]:
    """`project(basis, samples, norm=norm, ridge=ridge, prior=prior)`, sooner where samples are many: the same
    coefficients, residual and condition to about ten digits, from moments of the samples in one pass.

    A table stands for its `node_samples`, folded where the basis is bilateral; line by line its nodes take a fifth of
    the time, and are not written out.

    For an `IsotropicBasis` of `HSH`, `SHR` or `Zernike` and samples that are scattered: every other basis, the nodes of
    an exact rule, samples that are not many more than the products of functions, and those that leave the condition
    number above 300, go to `project`. `method` of the result is "moments" where it was not needed. Found in float64;
    the result has the dtype of the samples. Reciprocity of the data is not measured. Not under `jax.jit`.

    **Raises:** as `project`.
    """
    chosen, gamma = named_norm(norm), penalty(basis, ridge, prior)
    if isinstance(samples, HalfVectorTable):
        table = samples
        if has_moments(basis) and basis.bilateral and pay(basis, table.values[..., 0].size):
            with jax.enable_x64(True):
                fit = _of_table(basis, table, chosen, gamma)
            if fit is not None:
                return _in_dtype(fit, table.values.dtype)
        samples = table.node_samples(folded=isinstance(basis, IsotropicBasis) and basis.bilateral)
    if has_moments(basis) and samples.degree is None and pay(basis, samples.size):
        dtype = common_dtype(samples.wi, samples.wo, samples.value, samples.weight)[2].dtype
        with jax.enable_x64(True):
            fit = _by_moments(basis, samples, chosen, gamma)
        if fit is not None:
            return _in_dtype(fit, dtype)
    return project(basis, samples, norm=norm, ridge=ridge, prior=prior, reciprocity=False)


def _by_moments(basis: IsotropicBasis, samples: Samples, norm: Norm, gamma: Array | None) -> Fit[LinearBRDF] | None:
    """None where the normal equations would cost too many digits."""
    samples = _in_float64(samples)
    used = check_samples(samples, norm, basis.count, ridged=gamma is not None).used
    return _fit(basis, norm, normal_equations(basis, norm, samples), used, gamma, lambda: samples)


def _of_table(basis: IsotropicBasis, table: HalfVectorTable, norm: Norm, gamma: Array | None) -> Fit[LinearBRDF] | None:
    """None also where the nodes are to be looked at one by one: what is wrong with them is said there."""
    found, counts = table_equations(basis, norm, table)
    if not np.all(np.isfinite(found.square)):
        return None
    check_enough(counts, norm, basis.count, ridged=gamma is not None)
    return _fit(basis, norm, found, counts.used, gamma, lambda: _in_float64(table.node_samples(folded=True)))


def _fit(
    basis: IsotropicBasis,
    norm: Norm,
    found: Equations,
    used: int,
    gamma: Array | None,
    samples: Callable[[], Samples],
) -> Fit[LinearBRDF] | None:
    gram, right, square = found
    coefficients, error, condition = _solved(gram, right, square, gamma)
    if not condition <= WELL_CONDITIONED:  # it may be NaN
        return None
    model = LinearBRDF(basis, coefficients, norm.target)
    if norm.judge_series == norm.fit and np.all(error > RESOLVED * square):
        residual, size = jnp.sqrt(error), jnp.sqrt(square)
    else:
        residual, size = misfit(model, samples(), norm.name)
    relative = ratio(residual, size)
    return Fit(
        model, residual, relative, condition, norm=norm.name, method="moments", samples=used, unknowns=basis.count
    )


def _in_dtype(fit: Fit[LinearBRDF], dtype) -> Fit[LinearBRDF]:
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf).astype(dtype)), fit)


@jax.jit
def _solved(gram: Array, right: Array, square: Array, gamma: Array | None) -> tuple[Array, Array, Array]:
    """Coefficients, Σ w |f - f̂|² per channel, and the condition of the design matrix: NaN if not positive definite."""
    whole = gram if gamma is None else gram + jnp.diag(gamma.astype(gram.dtype))
    root = jnp.linalg.cholesky(whole, upper=True)
    coefficients = jax.scipy.linalg.cho_solve((root, False), right)
    error = square - jnp.sum(coefficients * (2 * right - matmul(gram, coefficients)), axis=0)
    return coefficients, error, _condition(root)


def _in_float64(samples: Samples) -> Samples:
    parts = samples.wi, samples.wo, samples.value, samples.weight
    wi, wo, value, weight = (jnp.asarray(np.asarray(part, np.float64)) for part in parts)
    return Samples(wi, wo, value, weight, None, samples.isotropic)
