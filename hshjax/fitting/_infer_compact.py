"""Compact models from few, scattered and noisy samples: what is not seen is left to a prior, and all is weighed."""

from collections.abc import Sequence
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np

from hshjax.bases import HalfVectorBasis, IdentityWarp, LogWarp, total_order
from hshjax.bases._half_vector import COST, Mode, half_chart
from hshjax.brdfs._log_linear import LogLinearBRDF, leading_terms
from hshjax.fitting._checks import check_samples
from hshjax.fitting._compact import ALPHAS
from hshjax.fitting._compact_equations import MARGIN
from hshjax.fitting._compact_posterior import CompactPosterior, Trial
from hshjax.fitting._evidence import Posterior, evidence, posterior, spectrum
from hshjax.fitting._generalised_log import linearised, log_density
from hshjax.fitting._lapack import suited_threads
from hshjax.fitting._norms import named_norm
from hshjax.samples import Samples

LEAST = 20
"""Samples below which there is nothing to infer error bars from."""

FLOOR = 1e-6
"""Share of a channel's typical value below which ln ρ is not begun, and hardly falls."""

DARKS = FLOOR, 30.0
"""Where additive noise is as large as multiplicative noise: from that share of the darkest channel's typical value to
that of the brightest one's, every half decade is tried."""

BEGIN = 0.1
"""Share of the brightest channel's typical value that is tried first."""

NEAR = (10**-0.25, 1.0, 10**0.25)
"""Steps from the best of them that are tried."""

RATIOS = np.logspace(-2, 7, 91)
"""Variances of prior and noise, one over the other, that are tried."""

WIDE: dict[Mode, float] = {(0, 0, 0): 10.0, (1, 0, 0): 3.0, (0, 2, 0): 3.0}
"""The constant, and what every highlight and every grazing angle need: their deviations, times the general ones."""

ROUNDS = 3
"""Linearisations after the choice."""


def prior_deviations(modes: Sequence[Mode]) -> np.ndarray:
    """Of coefficients of ln ρ, relative, `(modes,)`: (1 + cost)^-2 with the cost of `total_order`, wider for trends."""
    cost = np.abs(np.array(modes)) @ np.array(COST)
    return np.array([WIDE.get(mode, 1.0) for mode in modes]) / (1 + cost) ** 2


Criterion = Literal["evidence", "leave-one-out"]


def infer_compact(
    samples: Samples,
    functions: int | Sequence[int] = 150,
    *,
    alphas: Sequence[float] | None = None,
    noise: float | None = None,
    criterion: Criterion = "evidence",
) -> CompactPosterior:
    """A compact model of an isotropic material from few, scattered and noisy samples, with error bars.

    ln ρ = Σ_a c_a B_a over a `HalfVectorBasis`, c_a ~ N(0, s² γ_a²) with deviations γ_a that fall with the order of the
    function, around the mean of the samples; the constant and two trends are nearly free. A sample is ρ plus noise of
    deviation σ sqrt(ρ² + dark²). The posterior is Gaussian, about a linearisation at its mean. Samples in another unit
    give the same model in that unit: what is small is so beside the median of a channel.

    What is chosen, and by what: s and σ by the largest evidence; the scale α of the warp, `dark` and, where several are
    given, the number of functions by evidence as well, or by the density of samples that are left out (cross-validation
    in closed form). All are common to the channels. With one number of functions the prior stands for the order: higher
    functions are smaller under it. Deviations are scaled such that samples left out are covered as often as they should
    be (`CompactPosterior.factor`).

    What was not sampled: α is at least a tenth of the smallest 1 - cos θ_h among the samples, so that no highlight is
    invented; ln ρ is held within a factor of two of the samples' range; deviations grow towards those of the prior,
    which nothing checks, and are not scaled down.

    **Arguments:**

    - `samples`: [sr^-1, no cosine], any channels, 20 at least. Weights count as relative precision; 0 masks. Values
      may be negative, but no channel without one above 0.
    - `functions`: of the basis, in every channel; several numbers are tried, the scales with the largest of them. More
      than samples is no harm: the prior decides. Time grows with their square and more.
    - `alphas`: scales to try; 13 from 1e-6 to 1 by default.
    - `noise`: standard deviation of the samples relative to ρ, where it is known. What the samples scatter beyond it
      counts as a misfit of the surface; without it, all does, and error bars of the surface never become smaller than
      the scatter of the samples.
    - `criterion`: "evidence" or "leave-one-out".

    Found on the host in float64; not under `jax.jit`. Energy is not constrained: see `hshjax.albedo`.

    **Returns:** a `CompactPosterior`.

    **Raises:** ValueError, naming the count, for fewer than 20 samples; for samples that are not finite, not of unit
    length or below the horizon; for a channel with no value above 0; for scales, a noise or numbers of functions that
    are not positive, and for another criterion.

    Source: MacKay, Bayesian Interpolation, Neural Computation 4(3), 1992; Rocke and Durbin, A model for measurement
    error for gene expression arrays, Journal of Computational Biology 8(6), 2001 (the noise).
    """
    if noise is not None and not noise > 0:
        raise ValueError(f"noise must be > 0, got {noise}")
    usable = check_samples(samples, named_norm("C"), 1, ridged=True).used
    if usable < LEAST:
        raise ValueError(f"{usable} samples with a positive weight are too few for error bars, {LEAST} are needed")
    if criterion not in get_args(Criterion):
        raise ValueError(f"criterion must be one of {', '.join(get_args(Criterion))}, got {criterion!r}")
    sizes = sorted({functions} if isinstance(functions, int) else set(functions))
    if not sizes or sizes[0] < 1:
        raise ValueError(f"functions must be one positive number or several, got {functions}")
    with jax.enable_x64(True), suited_threads(sizes[-1]):
        search = _Search(samples, sizes, ALPHAS if alphas is None else alphas, criterion)
        trial, parts, offset = search.found()
    modes, deviations = search.modes[: trial.functions], search.deviations[: trial.functions]
    # The model has the caller's default float, or a caller without float64 cannot load it again.
    basis = HalfVectorBasis(modes, LogWarp(jnp.asarray(trial.alpha)))
    channels = len(parts)
    coefficients = np.stack([deviations * part.mean for part in parts])
    coefficients[:, 0] += offset
    terms = leading_terms([len(modes)] * channels)
    bounds = (jnp.asarray(part) for part in (search.low, search.high))
    model = LogLinearBRDF(
        basis, jnp.asarray(coefficients.ravel()), jnp.eye(channels), *bounds, terms=jnp.asarray(terms)
    )
    roots = jnp.asarray(np.stack([deviations[:, None] * part.root for part in parts]))
    scores = jnp.asarray(np.stack([part.scores for part in parts], axis=1))
    misfit = np.sqrt(max(trial.noise**2 - (noise or 0.0) ** 2, 0.0))
    return CompactPosterior(
        model, roots, trial.noise, trial.dark, float(misfit), scores, trial, tuple(search.trials.values())
    )


class _Search:
    """Hyperparameters of one material, by coordinates: α, then the dark level, then neighbours, then the number of
    functions. Host arrays."""

    def __init__(self, samples: Samples, sizes: Sequence[int], alphas: Sequence[float], criterion: Criterion):
        self.sizes, self.criterion = sizes, criterion
        used = np.asarray(samples.weight) > 0
        parts = (samples.wi, samples.wo, samples.weight, samples.value)
        self.wi, self.wo, weight, self.value = (np.asarray(part, np.float64)[used] for part in parts)
        typical = _typical(self.value)
        self.weight = (weight / weight.mean())[:, None]
        self.modes = total_order(sizes[-1])  # of fewer functions, a prefix
        self.deviations = prior_deviations(self.modes)
        # What is not above 0 counts as the least that is: noise, not a surface of another order of magnitude.
        positive = np.where(self.value > 0, self.value, np.inf).min(axis=0)
        bright = np.log(np.maximum(self.value, np.maximum(positive, FLOOR * typical)))
        self.low, self.high = bright.min(axis=0) - MARGIN, bright.max(axis=0) + MARGIN
        self.alphas = self._resolved(alphas)
        self.begin = BEGIN * float(typical.max())
        least, most = DARKS[0] * typical.min(), DARKS[1] * typical.max()
        self.darks = np.geomspace(least, most, 1 + int(np.ceil(2 * np.log10(most / least)))).tolist()
        self.designs: dict[float, np.ndarray] = {}
        self.trials: dict[tuple[float, float, int], Trial] = {}
        self.logarithm = bright

    def _resolved(self, alphas: Sequence[float]) -> tuple[float, ...]:
        """The scales that the samples resolve, or else the largest, increasing."""
        tried = tuple(sorted(float(alpha) for alpha in alphas))
        if not tried or tried[0] <= 0:
            raise ValueError(f"scales are positive, at least one, got {tried}")
        smallest = half_chart(IdentityWarp(), jnp.asarray(self.wi), jnp.asarray(self.wo)).u.min()
        return tuple(alpha for alpha in tried if alpha >= 0.1 * float(smallest)) or tried[-1:]

    def _design(self, alpha: float) -> np.ndarray:
        """The functions at the samples, `(samples, functions)`, in units of their prior deviations."""
        if alpha not in self.designs:
            basis = HalfVectorBasis(self.modes, LogWarp(jnp.asarray(alpha)))
            self.designs[alpha] = np.asarray(basis(jnp.asarray(self.wi), jnp.asarray(self.wo))) * self.deviations
        return self.designs[alpha]

    def _try(self, alpha: float, dark: float, functions: int | None = None) -> tuple[list[Posterior], np.ndarray]:
        """Posteriors of the channels and the means of their samples, about the last ln ρ, which they replace."""
        response, weight = linearised(self.value, self.logarithm, dark)
        weight = weight * self.weight
        offset = np.sum(weight * response, axis=0) / np.sum(weight, axis=0)
        functions = functions or self.sizes[-1]
        design, roots = self._design(alpha)[:, :functions], np.sqrt(weight)
        spectra = [
            spectrum(root[:, None] * design, root * target)
            for root, target in zip(roots.T, (response - offset).T, strict=True)
        ]
        known, variances = evidence(spectra, RATIOS)
        best = int(np.argmax(known))
        ratio, variance = float(RATIOS[best]), float(variances[best])
        parts = [posterior(one, ratio, variance) for one in spectra]
        # In densities of ρ: those of responses times their derivative, which the weights cancel but for this.
        density = log_density(self.value, dark) + self.value.shape[1] * np.sum(np.log(self.weight)) / 2
        predictive = sum(-np.sum(part.scores**2 + np.log(2 * np.pi * part.variances)) / 2 for part in parts)
        self.trials[alpha, dark, functions] = Trial(
            alpha, dark, functions, float(np.sqrt(ratio * variance)), float(np.sqrt(variance)),
            float(known[best] + density), float(predictive + density),
        )  # fmt: skip
        means = np.stack([part.mean for part in parts], axis=1)
        self.logarithm = np.clip(offset + design @ means, self.low, self.high)
        return parts, offset

    def found(self) -> tuple[Trial, list[Posterior], np.ndarray]:
        """The choice, its posteriors and the offsets of the channels."""
        dark = self.begin
        # From the smoothest one on, each about the result of the last.
        for alpha in (self.alphas[-1], *self.alphas[::-1]):
            self._try(alpha, dark)
        for darks in (self.darks, None):
            best = self._best()
            for level in darks or (best.dark * step for step in NEAR):
                self._try(best.alpha, level)
            best = self._best()
            place = self.alphas.index(best.alpha)
            for alpha in self.alphas[max(place - 1, 0) : place + 2]:
                self._try(alpha, best.dark)
        best = self._best()
        for functions in self.sizes[:-1]:
            self._try(best.alpha, best.dark, functions)
        best = self._best()
        for _ in range(ROUNDS - 1):
            self._try(best.alpha, best.dark, best.functions)
        parts, offset = self._try(best.alpha, best.dark, best.functions)
        return self.trials[best.alpha, best.dark, best.functions], parts, offset

    def _best(self) -> Trial:
        speaks = {"evidence": lambda trial: trial.evidence, "leave-one-out": lambda trial: trial.predictive}
        return max(self.trials.values(), key=speaks[self.criterion])


def _typical(value: np.ndarray) -> np.ndarray:
    """The median of what is above 0, `(channels,)`: what is small and what is large is so beside it."""
    black = np.flatnonzero(np.all(value <= 0, axis=0))
    if black.size == value.shape[1]:
        raise ValueError("the material is black: no value is above 0")
    if black.size:
        # Zeros agree with any model: they would pass for samples without noise, and narrow the other channels.
        raise ValueError(f"channels {black.tolist()} are black: no value is above 0; leave them out")
    return np.array([np.median(one[one > 0]) for one in value.T])
