"""What scattered samples tell of a compact model, and what they leave open: error bars, and where to measure next."""

from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, Real
from hshjax.bases._base import matmul
from hshjax.brdfs._log_linear import LogLinearBRDF
from hshjax.fitting._compact import half_vector_samples
from hshjax.fitting._compact_equations import EVERYWHERE, visibility
from hshjax.geometry import as_directions

LEVEL = 0.9
"""Share of the samples by which deviations are scaled."""

CELLS = (24, 10, 5)
"""Of the pairs that are offered for measurement, in sqrt(θ_h), θ_d and φ_d, below 80 degrees."""


class Trial(NamedTuple):
    """One choice of `infer_compact`: scale of the warp, dark level [sr^-1], number of functions, deviations, and what
    speaks for it.

    - `deviation`: of the prior. - `noise`: of ln ρ where it is bright.
    - `evidence`: ln of the probability density of all samples, coefficients integrated out.
    - `predictive`: sum of ln of the density of each sample, predicted from all the others.
    """

    alpha: float
    dark: float
    functions: int
    deviation: float
    noise: float
    evidence: float
    predictive: float


class Suggestion(NamedTuple):
    """Pairs of directions to measure, in this order: `wi`, `wo` `(count, 3)`.

    `log_deviation` `(count,)`: that of ln ρ before each is measured and after the ones before it: root mean square over
    channels, as `CompactPosterior.log_deviation` without the misfit.
    """

    wi: Float[Array, "count 3"]
    wo: Float[Array, "count 3"]
    log_deviation: Float[Array, " count"]


class CompactPosterior(eqx.Module):
    """What `infer_compact` has found: ln ρ as a Gaussian process over a half-vector basis.

    - `model`: a `LogLinearBRDF`, exp of the posterior mean of ln ρ, in every channel functions of its own.
    - `roots` `(channels, functions, functions)`: the posterior covariance of the coefficients of a channel is
      root rootᵀ.
    - `noise`: σ, and `dark` [sr^-1]: a sample has the standard deviation σ sqrt(ρ² + dark²).
    - `misfit`: the part of σ that is no noise, but the surface's, and unexplained: all of it unless `infer_compact` was
      told the noise.
    - `scores` `(samples, channels)`: the residual of every sample that has a weight, left out, over the deviation that
      the others predict for it.
    - `chosen`, `trials`: what was chosen and all that was tried.
    """

    model: LogLinearBRDF
    roots: Float[Array, "channels functions functions"]
    noise: float
    dark: float
    misfit: float
    scores: Float[Array, "samples channels"]
    chosen: Trial = eqx.field(static=True)
    trials: tuple[Trial, ...] = eqx.field(static=True)

    @property
    def alpha(self) -> float:
        """The scale of the model's warp."""
        return self.chosen.alpha

    def reach(self, level: float) -> Float[Array, ""]:
        """How many predicted deviations hold that share of samples left out: of Gaussians, 1.64 for 0.9.

        Of n samples a share of ceil((n + 1) level) / n, channels pooled: one more than n is to be covered, and channels
        of a sample err together.

        **Raises:** ValueError for a level outside (0, 1), or one that so few samples say nothing of.

        Source: the order statistic of conformal prediction; Vovk, Gammerman and Shafer, Algorithmic Learning in a
        Random World, 2005.
        """
        if not 0 < level < 1:
            raise ValueError(f"a level lies between 0 and 1, got {level}")
        samples, channels = self.scores.shape
        place = int(np.ceil((samples + 1) * level)) * channels
        if place > self.scores.size:
            raise ValueError(
                f"{samples} samples say nothing of a level of {level}: at most {samples / (samples + 1):.3f}"
            )
        return jnp.sort(jnp.abs(self.scores).ravel())[place - 1]

    @property
    def factor(self) -> Float[Array, ""]:
        """By what predicted deviations are multiplied: `reach` of 0.9 over that of a Gaussian.

        About 1 as a rule. Where it is less (exact samples, or noise with outliers), only the noise and the misfit are
        narrowed, and what the coefficients leave open is not: samples say nothing of what is far from all of them.
        """
        return self.reach(LEVEL) / _gaussian(LEVEL)

    def log_deviation(self, wi: Float[Array, "... 3"], wo: Float[Array, "... 3"]) -> Real:
        """Standard deviation of ln ρ of the surface, `(*batch, channels)`, misfit included, scaled as `factor` says."""
        return self._reached(LEVEL, self._variance(*as_directions(wi, wo)), self.misfit) / _gaussian(LEVEL)

    def interval(
        self, wi: Float[Array, "... 3"], wo: Float[Array, "... 3"], level: float = LEVEL, *, noise: bool = False
    ) -> tuple[Real, Real]:
        """(low, high) [sr^-1], `(*batch, channels)`: where ρ of the surface lies in that share of cases.

        With `noise`, where a new sample would lie, of the weight that samples have on average; it may be negative. Its
        multiplicative part adds to ln ρ, the additive one to ρ, each side in quadrature. Not clipped as the model is:
        far from all samples the interval is as wide as the prior.

        **Raises:** ValueError as `reach` does.
        """
        wi, wo = as_directions(wi, wo)
        value, size = self.model(wi, wo), self.noise if noise else self.misfit
        deviation = self._reached(level, self._variance(wi, wo), size)
        low, high = value * jnp.exp(-deviation), value * jnp.exp(deviation)
        if not noise:
            return low, high
        floor = self.reach(level).astype(wi.dtype) * self.noise * self.dark
        return value - jnp.hypot(value - low, floor), value + jnp.hypot(high - value, floor)

    def _reached(self, level: float, variance: Real, size: float) -> Real:
        """How far ln ρ is in that share of cases, of a variance of the coefficients and a deviation of the rest."""
        reach = self.reach(level).astype(variance.dtype)
        return jnp.sqrt(jnp.maximum(reach, _gaussian(level)) ** 2 * variance + (reach * size) ** 2)

    def _variance(self, wi: Real, wo: Real) -> Real:
        """Of ln ρ, `(*batch, channels)`, from the coefficients alone."""
        shape = jnp.broadcast_shapes(wi.shape, wo.shape)
        rows = self.model.basis(jnp.broadcast_to(wi, shape), jnp.broadcast_to(wo, shape))
        parts = [matmul(rows, root.astype(rows.dtype)) for root in self.roots]
        return jnp.stack([jnp.sum(part * part, axis=-1) for part in parts], axis=-1)

    def suggest(self, count: int = 1, candidates: tuple[Real, Real] | None = None) -> Suggestion:
        """Where to measure next: again and again the pair whose ln ρ is least certain, as if measured already.

        `candidates` (wi, wo) `(n, 3)` are pairs that can be measured; by default cells of half and difference angles
        below 80 degrees. Variances of ln ρ are summed over channels with the weights of compact fits, relative to the
        median of all candidates and channels: what is hardly seen beside it counts less (`hshjax.fit_compact`). On the
        host, in float64.

        **Raises:** ValueError for a count below 1 or above the number of candidates, for candidates on the horizon or
        below it.
        """
        wi, wo = _measurable(*(_offered() if candidates is None else candidates))
        if not 1 <= count <= len(wi):
            raise ValueError(f"of {len(wi)} candidates 1 to {len(wi)} can be suggested, got {count}")
        value, rows, noise = self._told(wi, wo)
        seen = (wi[:, 2:] + wo[:, 2:]) / 2 * value
        weight = visibility(seen, float(np.median(seen)), EVERYWHERE)
        parts = [rows @ np.asarray(root, np.float64) for root in self.roots]
        free, chosen, deviation = np.ones(len(wi), bool), [], []
        for _ in range(count):
            variance = np.stack([np.sum(part**2, axis=1) for part in parts], axis=1)
            k = int(np.argmax(np.where(free, np.sum(weight * variance, axis=1), -1)))
            free[k] = False
            chosen.append(k)
            deviation.append(max(float(self.factor), 1.0) * np.sqrt(np.mean(variance[k])))
            parts = [_updated(part, part[k], noise[k, channel]) for channel, part in enumerate(parts)]
        return Suggestion(jnp.asarray(wi[chosen]), jnp.asarray(wo[chosen]), jnp.asarray(np.array(deviation)))

    def measured(self, wi: Float[Array, "... 3"], wo: Float[Array, "... 3"]) -> "CompactPosterior":
        """What would be known once these pairs, or this one, were measured as well: deviations shrink, the model stays.

        How much a measurement tells does not depend on what it gives, as long as ρ is about what the model says.

        **Raises:** ValueError for directions on the horizon or below it, where there is nothing to measure.
        """
        _, rows, noise = self._told(*_measurable(wi, wo))
        roots = np.asarray(self.roots, np.float64)
        for row, size in zip(rows, noise, strict=True):
            roots = np.stack([_updated(root, row @ root, one) for root, one in zip(roots, size, strict=True)])
        return eqx.tree_at(lambda found: found.roots, self, jnp.asarray(roots, self.roots.dtype))

    def _told(self, wi: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ρ `(n, channels)`, functions `(n, functions)`, variances of ln ρ as measured `(n, channels)`; of the host."""
        pairs = jnp.asarray(wi), jnp.asarray(wo)
        value, rows = (np.asarray(part, np.float64) for part in (self.model(*pairs), self.model.basis(*pairs)))
        return value, rows, self.noise**2 * (1 + (self.dark / value) ** 2)


def _gaussian(level: float) -> float:
    """How many deviations hold that share of a Gaussian."""
    return NormalDist().inv_cdf((1 + level) / 2)


def _updated(root: np.ndarray, seen: np.ndarray, noise: float) -> np.ndarray:
    """Rows `(n, p)` of a covariance root after bᵀ x was measured, with `seen` bᵀ root `(p,)`: it stays a root.

    Source: Potter's square-root update; Bierman, Factorization Methods for Discrete Sequential Estimation, 1977.
    """
    total = seen @ seen + noise
    return root - (root @ seen)[:, None] * (seen / (total + np.sqrt(noise * total)))


def _measurable(wi: Real | np.ndarray, wo: Real | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs `(n, 3)` of whatever batch, above the horizon in both directions, or a ValueError. Host arrays, float64."""
    pair = np.broadcast_arrays(*as_directions(jnp.asarray(wi), jnp.asarray(wo)))
    wi, wo = (np.asarray(w, np.float64).reshape(-1, 3) for w in pair)
    lowest = np.minimum(wi[:, 2], wo[:, 2])
    below = np.flatnonzero(~(lowest > 0))
    if below.size:
        raise ValueError(
            f"pairs to measure lie above the horizon, z > 0 in both directions: {below.size} of {len(wi)} do not, "
            f"the first is pair {below[0]} with z = {lowest[below[0]]:g}"
        )
    return wi, wo


@lru_cache
def _offered() -> tuple[np.ndarray, np.ndarray]:
    """Pairs that any goniometer reaches: centres of cells of half and difference angles."""
    cells = half_vector_samples(lambda wi, wo: wi[:, 2:], shape=CELLS, grazing=0.0)
    return np.asarray(cells.wi, np.float64), np.asarray(cells.wo, np.float64)
