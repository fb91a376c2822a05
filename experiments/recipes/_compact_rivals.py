"""What compact models race against: series without logarithm or without warp, series of products, analytic lobes.

Fits of many materials at the same directions, three channels each.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import tree_leaves

import hshjax
from experiments.recipes._compact_metrics import log_error, measure
from hshjax import (
    ABC,
    GGX,
    AbstractBRDF,
    HalfVectorBasis,
    IsotropicBasis,
    Lambert,
    LinearBRDF,
    LogLinearBRDF,
    Samples,
    SchlickFresnel,
)
from hshjax.bases import IdentityWarp, LogWarp, RationalWarp
from hshjax.bases._warp import AbstractWarp
from hshjax.fitting import LogCosineWeighted, SampleMisfit, initial_guesses, multi_start
from hshjax.fitting._compact import ALPHAS
from hshjax.fitting._compact_equations import DARK, EVERYWHERE, FLOOR, MARGIN, floored, visibility

CUT = 1e-10
"""Singular values of a design, relative to the largest, below which nothing is determined."""

STARTS = 16
STEPS = 60


def numbers(brdf: AbstractBRDF) -> int:
    """How many parameters a model has."""
    return sum(leaf.size for leaf in tree_leaves(eqx.filter(brdf, eqx.is_inexact_array)))


def joined(models: Sequence[LinearBRDF]) -> LinearBRDF:
    """Series over one basis as one of all their channels."""
    return LinearBRDF(models[0].basis, jnp.concatenate([model.coefficients for model in models], axis=1))


def product_series(samples: Sequence[Samples], basis: IsotropicBasis) -> list[LinearBRDF]:
    """ρ = series of products, by least squares under z_i z_o dω_i dω_o (norm A) on the nodes of a rule."""
    return [fit.model for fit in hshjax.project_all(basis, samples, norm="A")]


def half_vector_series(samples: Sequence[Samples], count: int, *, warped: bool) -> list[LinearBRDF]:
    """ρ = series of `count` functions of half and difference vector, by the same least squares on cells.

    `warped`: each material under the warp, of two kinds and 13 scales, that has the least log error on the samples.
    """
    first = samples[0]
    wi, wo = np.asarray(first.wi), np.asarray(first.wo)
    root = np.sqrt(np.asarray(first.weight) * measure(wi, wo) * wi[:, 2] * wo[:, 2])[:, None]
    value = np.concatenate([np.asarray(one.value) for one in samples], axis=1)
    parts = np.cumsum([one.channels for one in samples])[:-1]
    best, errors = [None] * len(samples), np.full(len(samples), np.inf)
    kinds = (LogWarp, RationalWarp) if warped else ()
    tried: list[AbstractWarp] = [kind(jnp.asarray(alpha)) for kind in kinds for alpha in ALPHAS] or [IdentityWarp()]
    for warp in tried:
        basis = HalfVectorBasis(hshjax.total_order(count), warp)
        design = np.asarray(basis(first.wi, first.wo))
        coefficients = _least_squares(root * design, root * value, CUT)
        fitted = np.maximum(design @ coefficients, 0)
        for k, (own, columns) in enumerate(
            zip(np.split(fitted, parts, axis=1), np.split(coefficients, parts, axis=1), strict=True)
        ):
            error = log_error(np.asarray(samples[k].value), own, wi, wo)
            if error < errors[k]:
                best[k], errors[k] = LinearBRDF(basis, jnp.asarray(columns)), error
    return best


def exponential_series(samples: Sequence[Samples], basis: IsotropicBasis) -> list[LogLinearBRDF]:
    """ρ = exp(series), each channel by itself: least squares in ln ρ, bounded as compact fits are, on like weights."""
    models, first = [], samples[0]
    design = np.asarray(basis(first.wi, first.wo))
    cosine = np.asarray(first.wi[:, 2:] + first.wo[:, 2:]) / 2
    for one in samples:
        value = floored(np.asarray(one.value), FLOOR)
        target = np.log(value)
        roots = np.sqrt(np.asarray(one.weight)[:, None] * visibility(cosine * value, DARK, EVERYWHERE))
        columns = [
            jnp.asarray(_least_squares(root[:, None] * design, (root * logarithm)[:, None], 1e-6)[:, 0])
            for root, logarithm in zip(roots.T, target.T, strict=True)
        ]
        bounds = (jnp.asarray(part) for part in (target.min(axis=0) - MARGIN, target.max(axis=0) + MARGIN))
        models.append(LogLinearBRDF(basis, columns, jnp.eye(len(columns)), *bounds))
    return models


def _least_squares(design: np.ndarray, value: np.ndarray, cut: float) -> np.ndarray:
    """As `np.linalg.lstsq` does, with `cut` for rcond, after a QR factorisation of both: a fifth of its time."""
    triangle = np.linalg.qr(np.concatenate([design, value], axis=1), mode="r")
    count = design.shape[1]
    return np.linalg.lstsq(triangle[:, :count], triangle[:, count:], rcond=cut)[0]


def _ggx() -> AbstractBRDF:
    black = jnp.zeros(3)
    return Lambert(black) + GGX(black, jnp.asarray(0.3), SchlickFresnel(jnp.asarray(0.04)))


def _abc() -> AbstractBRDF:
    black = jnp.zeros(3)
    return ABC(black, black, jnp.asarray(100.0), jnp.asarray(1.0))


TEMPLATES = {"GGX": _ggx, "ABC": _abc}
"""The analytic models that are fitted; made when they are asked for, in the precision of the run."""


def lobe(template: AbstractBRDF, samples: Samples) -> AbstractBRDF:
    """An analytic model from many starts: least squares in ln(1 + ρ z_i z_o)."""
    starts = initial_guesses(template, samples, STARTS)
    found = multi_start(starts, {"data": SampleMisfit(samples, LogCosineWeighted())}, max_steps=STEPS, throw=False)
    return jax.block_until_ready(found.best.model)
