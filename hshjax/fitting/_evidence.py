"""Linear models under a Gaussian prior of unknown scale and noise of unknown size: one decomposition tells all."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

PSEUDO, TYPICAL = 2.0, 0.01
"""As if so many residuals of this size had been seen: noise is never found to be 0."""

FULL = 1 - 1e-9
"""Leverage of a sample that decides alone; rounding leaves the last digits."""


class Spectrum(NamedTuple):
    """y = A x + noise, taken apart: Aᵀ A = U diag(λ) Uᵀ. Host arrays, float64.

    - `rows` A `(n, p)`, `target` y `(n,)`: in units in which noise is alike and coefficients are a priori.
    - `values` λ `(p,)`, `vectors` U `(p, p)`, `moments` Uᵀ Aᵀ y `(p,)`.
    """

    rows: np.ndarray
    target: np.ndarray
    values: np.ndarray
    vectors: np.ndarray
    moments: np.ndarray


def spectrum(rows: np.ndarray, target: np.ndarray) -> Spectrum:
    """The decomposition of one problem."""
    values, vectors = np.linalg.eigh(rows.T @ rows)
    return Spectrum(rows, target, np.maximum(values, 0), vectors, vectors.T @ (rows.T @ target))


def evidence(spectra: Sequence[Spectrum], ratios: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ln p(all y) for every ratio of the variances of prior and noise, `(ratios,)`, and the variance of the noise.

    x ~ N(0, r σ² 1), noise ~ N(0, σ² 1), the same for all problems; σ² is the most probable one at each r.

    Source: MacKay, Bayesian Interpolation, Neural Computation 4(3), 1992.
    """
    count = sum(one.target.size for one in spectra)
    logarithm, square = np.zeros_like(ratios), np.full_like(ratios, PSEUDO * TYPICAL**2)
    for one in spectra:
        gain = ratios[:, None] / (1 + ratios[:, None] * one.values)
        logarithm -= np.sum(np.log1p(ratios[:, None] * one.values), axis=1) / 2
        square += np.maximum(one.target @ one.target - gain @ one.moments**2, 0)
    variance = square / (count + PSEUDO)
    return logarithm - (count * np.log(2 * np.pi * variance) + square / variance) / 2, variance


class Posterior(NamedTuple):
    """x ~ N(mean, root rootᵀ), and what each sample is when it is left out, hyperparameters held.

    - `mean` `(p,)`, `root` `(p, p)`.
    - `scores` `(n,)`: residual of a sample over the deviation predicted for it. - `variances` `(n,)`: of that.
    """

    mean: np.ndarray
    root: np.ndarray
    scores: np.ndarray
    variances: np.ndarray


def posterior(one: Spectrum, ratio: float, variance: float) -> Posterior:
    """Mean, deviation and closed-form leave-one-out of one problem at a ratio and a variance of the noise.

    Left out, a sample of leverage h and residual e misses by e / (1 - h), and was predicted with variance
    σ² / (1 - h), its own noise included. Source: Rasmussen and Williams, Gaussian Processes for Machine Learning,
    2006, Eq. 5.12.
    """
    gain = ratio / (1 + ratio * one.values)
    mean = one.vectors @ (gain * one.moments)
    leverage = np.minimum((one.rows @ one.vectors) ** 2 @ gain, FULL)
    predicted = variance / (1 - leverage)
    residual = (one.target - one.rows @ mean) / (1 - leverage)
    return Posterior(mean, one.vectors * np.sqrt(variance * gain), residual / np.sqrt(predicted), predicted)
