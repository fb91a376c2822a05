"""The closed form: the best BRDF of a basis in a named norm, by inner products or by QR.

On the nodes of a rule that is exact for the basis, under a flat weight, the coefficients are inner products (divided
by 1 + Γ). In every other case they are the weighted least squares

    argmin_c  Σ_k w_k |f_k - B_k c|² + cᵀ Γ c,     f = (z_i z_o)^p ρ,

solved by a QR factorisation of [sqrt(w) B, sqrt(w) f] that is carried through the samples block by block: neither the
design matrix nor Q is ever held, one factorisation serves all channels, and the condition number is never squared.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.scipy.linalg import solve_triangular
from jax.sharding import Mesh

from hshjax._typing import Array, Float
from hshjax.bases import AbstractPairBasis, AbstractProductBasis
from hshjax.bases._base import matmul
from hshjax.brdfs._linear import LinearBRDF, cosine_power
from hshjax.fitting._blocks import ROWS
from hshjax.fitting._checks import check_determined, check_isotropy, check_numbers, check_samples
from hshjax.fitting._constraints import check_constraints
from hshjax.fitting._lapack import suited_threads
from hshjax.fitting._mesh import flat_mesh, fold_each, gathered, spread
from hshjax.fitting._misfit import misfit, ratio
from hshjax.fitting._norms import Norm, named_norm
from hshjax.fitting._outcome import Outcome
from hshjax.fitting._prior import Prior, penalty
from hshjax.fitting._result import Fit
from hshjax.fitting._valid import constrained
from hshjax.geometry import common_dtype
from hshjax.metrics import ReciprocityError, reciprocity_error
from hshjax.quadrature import PairRule
from hshjax.samples import Samples

WHOLE = (2 * np.pi) ** 2
"""Solid angle of both hemispheres together [sr²]: what the weights of a whole rule add up to."""

SEARCHED = 200_000
"""Samples up to which the data's own reciprocity is measured unasked."""


def project(
    basis: AbstractPairBasis,
    samples: Samples,
    *,
    norm: str = "D",
    ridge: float = 0.0,
    prior: Prior | None = None,
    covariance: bool = False,
    reciprocity: bool | None = None,
    constraints: tuple[str, ...] = (),
    rounds: int = 16,
    mesh: Mesh | None = None,
) -> Fit[LinearBRDF]:
    """The BRDF in the span of `basis` nearest to `samples`, in closed form.

    **Arguments:**

    - `basis`: any pair basis; a reciprocal one filters out what violates Helmholtz reciprocity (claim 6 of the paper).
    - `samples`: values [sr^-1, no cosine]. Weight 0 masks a sample, whatever its value. Other weights are solid angles
      [sr²] or confidences, and enter as they are.
    - `norm`: "A" ... "E": what is minimised, and in which norm the residual is reported; see `NORMS`. The default "D"
      fits z_i z_o ρ.
    - `ridge`, `prior`: Γ = ridge x diag(prior). None is 1 throughout; "spectral" is (n(n+1) + p(p+1))², which leaves
      the constant free and damps fine detail; an array `(modes,)` >= 0 is taken as it is. Scattered data never cover
      the grazing band: a small spectral ridge keeps the unseen directions tame. Γ is not scaled by the number of
      samples.
    - `covariance`: also the posterior covariance of the coefficients, and the noise to multiply it by (NaN where there
      are no more samples than unknowns).
    - `reciprocity`: also the violation of reciprocity in the data (a search among all samples, on the host) and in the
      model. By default up to 200 000 samples, where it takes under a second.
    - `constraints`: any of "non_negative" (ρ >= 0) and "energy" (directional albedo <= 1): the best fit among those
      that are physically valid, with a `certificate` of it (see `Certificate`). Found on the host in float64, by
      exchange of at most `rounds` rounds, all channels on one set of directions; where they do not suffice, the fit
      comes with `result` `Outcome.uncertified`. Not under `jax.jit`, `jax.vmap` or `jax.grad`. Both
      constraints together force a series for sqrt(z_i z_o) ρ or z_i z_o ρ to vanish at the horizon, where its albedo
      would be infinite otherwise. The price is what `relative` gains over a fit without constraints.
    - `mesh`: devices that share the samples (`device_mesh`), of any shape and axes. Each factorises its part, and the
      factors are merged by one more QR: the result is that of one device, to rounding. Where some of the devices are of
      other processes, every process makes the same call with the same samples. Inside a transformation, jax refuses
      arrays that were put on one device (`jax.device_put`), and values and derivatives stay on the mesh.

    **Returns:** a `Fit`. Beside the samples, memory holds a few blocks and two matrices of unknowns x unknowns.

    **Raises:** ValueError, naming the count, for samples that are not finite, not of unit length or below the horizon;
    for weights that are negative or all zero; for isotropic samples and a basis that is not; for fewer samples than
    unknowns, or samples that do not determine the unknowns, without a ridge; for constraints that are unknown, inside
    a transformation of jax, or beyond anything in the span of the basis; for a mesh of several processes inside a
    transformation. Inside `jax.jit` values cannot be seen:
    there an undetermined fit returns coefficients that are not finite, samples with a `degree` are taken for the whole
    rule, and reciprocity is not measured.
    """
    chosen = named_norm(norm)
    check_constraints(constraints, rounds)
    if constraints and not isinstance(basis, AbstractProductBasis):
        raise ValueError(f"constraints are for products of functions of one direction, got {basis}")
    gamma = penalty(basis, ridge, prior)
    unknowns = basis.count
    visible = not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(samples))
    samples = _in_one_dtype(samples)
    check_isotropy(basis, samples)
    check_numbers(samples)
    used, total = samples.size, WHOLE
    if visible:
        _, used, _, total = check_samples(samples, chosen, unknowns, ridged=gamma is not None)

    inner = not covariance and chosen.orthonormal and _exact(basis, samples, total)
    mesh = None if mesh is None else flat_mesh(mesh)
    shared = samples if mesh is None else spread(samples, mesh)
    if inner:
        coefficients = gathered(_inner_products(basis, chosen, mesh, shared), mesh)
        condition, posterior, noise = jnp.ones((), coefficients.dtype), None, None
        diagonal = jnp.ones(unknowns, coefficients.dtype)
        if gamma is not None:  # BᵀWB is the identity: the penalty shrinks every coefficient by itself
            diagonal = diagonal + gamma.astype(coefficients.dtype)
            coefficients = coefficients / diagonal[:, None]
            condition = jnp.sqrt(jnp.max(diagonal) / jnp.min(diagonal))
        root = jnp.diag(jnp.sqrt(diagonal)) if constraints else None
    else:
        with suited_threads(unknowns + samples.channels):
            coefficients, condition, factor, root = _least_squares(basis, chosen, mesh, shared, gamma)
            if visible:
                root.block_until_ready()  # before the limit ends: calls return before their work is done
        if visible:
            check_determined(condition, unknowns, ridged=gamma is not None)
        posterior = noise = None
        if covariance:
            counted = jnp.sum(samples.weight * chosen.fit_weight(samples.wi, samples.wo) > 0)
            posterior, noise = posterior_of(factor, root, coefficients, counted)

    certificate, result = None, Outcome.converged
    if constraints:
        assert isinstance(basis, AbstractProductBasis)  # or it was refused
        assert root is not None  # of both branches above
        coefficients, certificate = constrained(basis, chosen.target, tuple(constraints), rounds, coefficients, root)
        result = Outcome.converged if certificate.holds else Outcome.uncertified

    model = LinearBRDF(basis, coefficients, chosen.target)
    residual, size = gathered(misfit(model, shared, norm, mesh), mesh)
    if reciprocity is None:
        reciprocity = samples.size <= SEARCHED
    before, after = _reciprocity(model, samples) if reciprocity and visible else (None, None)
    return Fit(
        model,
        residual,
        ratio(residual, size),
        condition,
        norm=norm,
        method="inner products" if inner else "QR",
        samples=used,
        unknowns=unknowns,
        reciprocity_before=before,
        reciprocity_after=after,
        covariance=posterior,
        noise=noise,
        certificate=certificate,
        result=result,
    )


def _in_one_dtype(samples: Samples) -> Samples:
    """One dtype throughout."""
    wi, wo, value, weight = common_dtype(samples.wi, samples.wo, samples.value, samples.weight)
    return Samples(wi, wo, value, weight, samples.degree, samples.isotropic)


def _exact(basis: AbstractPairBasis, samples: Samples, total: float) -> bool:
    """Whether the samples' own weights, `total` in all, make the Gram matrix of the basis the identity."""
    if not isinstance(basis, AbstractProductBasis) or not basis.basis.hemispherical:
        return False
    if samples.degree is None or samples.degree < 2 * basis.basis.order:
        return False
    # Samples may have been taken out or masked in spite of their degree. Rounding of a sum is far below sqrt(eps).
    return abs(total / WHOLE - 1) < 10 * float(jnp.finfo(samples.weight.dtype).eps) ** 0.5


def _series(norm: Norm, wi: Array, wo: Array, value: Array) -> Array:
    """f = (z_i z_o)^p ρ: what the norm's series stands for."""
    return cosine_power(wi, wo, norm.exponent)[:, None] * value


def _block_size(unknowns: int) -> int:
    """Samples a block, such that a block of design rows keeps to some 10 MB."""
    return max(64, min(ROWS, 2**20 // unknowns))


@partial(jax.jit, static_argnums=(0, 1, 2))
def _inner_products(
    basis: AbstractPairBasis, norm: Norm, mesh: Mesh | None, samples: Samples
) -> Float[Array, "modes channels"]:
    def visit(_, sums, wi, wo, value, weight):
        return sums + matmul(basis(wi, wo).T, weight[:, None] * _series(norm, wi, wo, value))

    unknowns = basis.count
    empty = jnp.zeros((unknowns, samples.channels), samples.value.dtype)
    return jnp.sum(fold_each(mesh, samples, _block_size(unknowns), empty, visit), axis=0)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _least_squares(
    basis: AbstractPairBasis, norm: Norm, mesh: Mesh | None, samples: Samples, gamma: Array | None
) -> tuple[Array, Array, Array, Array]:
    """Coefficients, condition estimate, R of the data, and the triangular root of BᵀWB + Γ."""
    factor = gathered(factorize(basis, norm, samples, mesh), mesh)
    coefficients, condition, root = solve_factor(factor, gamma, basis.count)
    return coefficients, condition, factor, root


@_least_squares.defjvp
def _(basis, norm, mesh, primals, tangents):
    """By the implicit function theorem, at the optimum: (BᵀWB + Γ) dc = d[BᵀW(f - Bc) - Γc] with c held.

    Not through the factorisation: R's last columns are singular where a channel lies in the span of the basis, and the
    derivative of QR is wrong there without a sign of it. Condition, R and its root count as constants; the solve knows
    its matrix as a function of the samples, for the sake of second derivatives.
    """
    here, penalty_here = primals
    coefficients, condition, factor, root = _least_squares(basis, norm, mesh, here, penalty_here)

    def residual(samples, gamma):
        return _normal_residual(basis, norm, mesh, samples, gamma, coefficients)

    def product(v):  # (BᵀWB + Γ) v: the residual is affine in c
        def at(c):
            return _normal_residual(basis, norm, mesh, here, penalty_here, c)

        return -jax.jvp(at, (coefficients,), (v,))[1]

    def solve(_, right):
        return solve_triangular(root, solve_triangular(root, right, trans=1))

    tangent = jax.jvp(residual, primals, tangents)[1]
    tangent = jax.lax.custom_linear_solve(product, tangent, solve, symmetric=True)
    constants = (condition, factor, root)
    return (coefficients, *constants), (tangent, *(jnp.zeros_like(constant) for constant in constants))


@partial(jax.jit, static_argnums=(0, 1, 2))
def _normal_residual(
    basis: AbstractPairBasis,
    norm: Norm,
    mesh: Mesh | None,
    samples: Samples,
    gamma: Array | None,
    coefficients: Array,
) -> Float[Array, "modes channels"]:
    """BᵀW(f - Bc) - Γc: zero at the optimum."""

    @jax.checkpoint  # a transpose keeps the samples and forms the rows again
    def visit(coefficients, sums, wi, wo, value, weight):
        rows = basis(wi, wo)
        misfit = _series(norm, wi, wo, value) - matmul(rows, coefficients)
        return sums + matmul(rows.T, (weight * norm.fit_weight(wi, wo))[:, None] * misfit)

    empty = jnp.zeros(coefficients.shape, coefficients.dtype)
    sums = jnp.sum(fold_each(mesh, samples, _block_size(basis.count), empty, visit, coefficients), axis=0)
    return sums if gamma is None else sums - gamma.astype(sums.dtype)[:, None] * coefficients


@partial(jax.jit, static_argnums=(0, 1, 3))
def factorize(
    basis: AbstractPairBasis, norm: Norm, samples: Samples, mesh: Mesh | None = None
) -> Float[Array, "columns columns"]:
    """R of [sqrt(w) B, sqrt(w) f]: everything that least squares needs to know of the samples.

    With a flat mesh, over which they are `spread`: R of the shares' own R, one above the other.
    """
    columns = basis.count + samples.channels

    def visit(_, factor, wi, wo, value, weight):
        root = jnp.sqrt(weight * norm.fit_weight(wi, wo))[:, None]
        block = root * jnp.concatenate([basis(wi, wo), _series(norm, wi, wo, value)], axis=1)
        return jnp.linalg.qr(jnp.concatenate([factor, block]), mode="r")

    empty = jnp.zeros((columns, columns), samples.value.dtype)
    factors = fold_each(mesh, samples, max(ROWS, 4 * columns), empty, visit)
    return factors[0] if mesh is None else jnp.linalg.qr(factors.reshape(-1, columns), mode="r")


@partial(jax.jit, static_argnums=2)
def solve_factor(factor: Array, gamma: Array | None, unknowns: int) -> tuple[Array, Array, Array]:
    """Coefficients, condition estimate, and the triangular root of BᵀWB + Γ."""
    if gamma is not None:
        rows = jnp.pad(jnp.diag(jnp.sqrt(gamma.astype(factor.dtype))), ((0, 0), (0, factor.shape[1] - unknowns)))
        factor = jnp.linalg.qr(jnp.concatenate([factor, rows]), mode="r")
    root = factor[:unknowns, :unknowns]
    return solve_triangular(root, factor[:unknowns, unknowns:]), _condition(root), root


def _condition(root: Float[Array, "n n"]) -> Float[Array, ""]:
    """Estimate of the 2-norm condition number of a triangular matrix, by power iterations with it and its inverse.

    A lower bound, within a small factor after ten steps; an exact singularity gives infinity.
    """

    def norm(apply):
        def step(_, state):
            v, _ = state
            v = apply(v)
            length = jnp.linalg.norm(v)
            return v / length, length

        # Any start that no singular vector is orthogonal to; this one has no symmetry.
        start = jnp.cos(jnp.arange(root.shape[0], dtype=root.dtype) ** 2 + 1)
        return jnp.sqrt(jax.lax.fori_loop(0, 10, step, (start, jnp.zeros((), root.dtype)))[1])

    largest = norm(lambda v: matmul(root.T, matmul(root, v)))
    inverse = norm(lambda v: solve_triangular(root, solve_triangular(root, v, trans=1)))
    condition = largest * inverse
    return jnp.where(jnp.isfinite(condition), condition, jnp.inf)


@jax.jit
def posterior_of(factor: Array, root: Array, coefficients: Array, counted: Array) -> tuple[Array, Array]:
    """(BᵀWB + Γ)^-1, and the noise variance from the residual of the data and its degrees of freedom.

    `counted` samples have a weight in the fit: what a norm does not see is no degree of freedom.
    """
    unknowns, channels = coefficients.shape
    inverse = solve_triangular(root, jnp.eye(unknowns, dtype=root.dtype))
    misfit = matmul(factor, jnp.concatenate([coefficients, -jnp.eye(channels, dtype=root.dtype)]))
    covariance = matmul(inverse, inverse.T)
    # Of the unknowns, tr((BᵀWB + Γ)^-1 BᵀWB) are determined by the data; without a ridge, all.
    determined = jnp.sum(matmul(factor[:, :unknowns], inverse) ** 2)
    freedom = counted.astype(root.dtype) - determined
    # With as many unknowns as samples the residual is rounding, and says nothing of the noise.
    enough = freedom > 0.5
    return covariance, jnp.where(enough, jnp.sum(misfit**2, axis=0) / jnp.where(enough, freedom, 1), jnp.nan)


def _reciprocity(model: LinearBRDF, samples: Samples) -> tuple[ReciprocityError, ReciprocityError]:
    """The data's violation, over pairs of samples; the model's, over an even choice of the samples' directions."""
    used = np.flatnonzero(np.asarray(samples.weight) > 0)
    some = used[np.linspace(0, used.size - 1, min(used.size, 4096)).astype(int)]
    directions = PairRule(samples.wi[some], samples.wo[some], samples.weight[some], 0, samples.isotropic)
    return reciprocity_error(samples), reciprocity_error(model, directions)
