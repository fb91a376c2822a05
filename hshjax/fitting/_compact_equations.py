"""The equations behind compact fits: many materials at the same directions, scale by scale. On the host, in float64."""

from collections.abc import Callable, Iterator, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array
from hshjax.bases import HalfVectorBasis, IdentityWarp, LogWarp, total_order
from hshjax.bases._half_vector import half_chart
from hshjax.brdfs._log_linear import contrasts
from hshjax.fitting._checks import check_samples
from hshjax.fitting._norms import named_norm
from hshjax.samples import Samples

MARGIN = 0.7
"""How far ln ρ may leave the range of the data, a factor of two."""

ROWS = 2**14
"""Samples that are looked at together."""


class Trial(eqx.Module):
    """The coefficients of one material at one α, and what they cost."""

    solution: np.ndarray
    loss: float
    log_error: float


class Problem:
    """Many materials at the same directions, and one number of coefficients. Host arrays, float64."""

    def __init__(self, samples: list[Samples], coefficients, mixing, dark, everywhere, floor, ridge):
        if not samples:
            raise ValueError("there is no material to fit")
        first = samples[0]
        for k, one in enumerate(samples):
            check_samples(one, named_norm("C"), coefficients, ridged=True)
            if (
                any(not np.array_equal(getattr(one, part), getattr(first, part)) for part in ("wi", "wo", "weight"))
                or one.channels != first.channels
            ):
                raise ValueError(f"material {k} differs from material 0 in its directions, weights or channels")
        used = np.asarray(first.weight) > 0
        self.wi, self.wo, self.weight = (np.asarray(a, np.float64)[used] for a in (first.wi, first.wo, first.weight))
        self.value = np.stack([np.asarray(one.value, np.float64)[used] for one in samples])
        self.mixing = contrasts(first.channels) if mixing is None else np.asarray(mixing, np.float64)
        self.sizes = _sizes(coefficients, self.mixing.shape[0])
        self.table = total_order(self.sizes[0])
        self.dark, self.ridge = dark, ridge
        self._check(coefficients, floor)
        self.floored = np.mean(self.value < floor, axis=(1, 2))
        self.value = np.maximum(self.value, floor)
        self.target = np.log(self.value)
        self.low, self.high = self.target.min(axis=1) - MARGIN, self.target.max(axis=1) + MARGIN

        self.o = np.asarray(half_chart(IdentityWarp(), jnp.asarray(self.wi), jnp.asarray(self.wo)).u)
        theta_h = 2 * np.arcsin(np.sqrt(np.minimum(self.o / 2, 1)))
        self.cosine = (self.wi[:, 2:] + self.wo[:, 2:]) / 2
        # Off the highlight there is more to see than a grid that follows it has samples of.
        self.emphasis = (self.weight * (0.5 + 0.75 * np.sqrt(2 * theta_h / np.pi)))[:, None]
        seen = self.cosine * self.value
        self.importance = self.emphasis * ((seen / (dark + seen)) ** 2 + everywhere**2)

    def _check(self, coefficients: int, floor: float) -> None:
        if self.mixing.ndim != 2 or self.mixing.shape[1] != self.value.shape[2]:
            raise ValueError(f"mixing must have shape (components, {self.value.shape[2]}), got {self.mixing.shape}")
        for k, value in enumerate(self.value):
            if not np.any(value > floor):
                raise ValueError(f"material {k} is black: no value is above the floor of {floor:g}")
        if self.weight.size < self.sizes[0]:
            raise ValueError(
                f"{self.weight.size} samples do not determine {self.sizes[0]} functions of {coefficients} coefficients"
            )

    def resolved(self, alphas: Sequence[float]) -> tuple[float, ...]:
        """The scales that the samples resolve: not far below their smallest 1 - cos θ_h, or else the largest."""
        tried = tuple(float(alpha) for alpha in alphas)
        if not tried or min(tried) <= 0:
            raise ValueError(f"scales are positive, at least one, got {tried}")
        return tuple(alpha for alpha in tried if alpha >= 0.1 * self.o.min()) or (max(tried),)

    def fits(self, alpha: float) -> list[Trial]:
        """Every material at one scale."""
        basis = HalfVectorBasis(self.table, LogWarp(jnp.asarray(alpha)))
        blocks = self._blocks(basis)
        equations = [_Equations(self.mixing, self.sizes) for _ in self.value]
        for part, rows in blocks():
            for one, importance, target in zip(equations, self.importance, self.target, strict=True):
                one.add(rows, importance[part], target[part])
        solutions = [one.solution(self.ridge) for one in equations]
        sums = np.zeros((len(solutions), 2))
        for part, rows in blocks():
            for k, solution in enumerate(solutions):
                sums[k] += self._misfit(k, part, rows @ solution)
        sums[:, 1] /= 2 * self.weight.sum() * self.value.shape[2]
        return [Trial(*one) for one in zip(solutions, *sums.T.tolist(), strict=True)]

    def _blocks(self, basis: HalfVectorBasis) -> Callable[[], Iterator[tuple[slice, np.ndarray]]]:
        """Parts of the samples with their design rows, as often as asked for; kept where there is one part only."""
        parts = [slice(start, start + ROWS) for start in range(0, self.weight.size, ROWS)]

        def rows(part):
            return np.asarray(basis(jnp.asarray(self.wi[part]), jnp.asarray(self.wo[part])))

        if len(parts) == 1:
            kept = [(parts[0], rows(parts[0]))]
            return lambda: iter(kept)
        return lambda: ((part, rows(part)) for part in parts)

    def _misfit(self, material: int, part: slice, components: np.ndarray) -> tuple[float, float]:
        """The loss, and the sum of |Δ ln(1 + ρ z)|."""
        logarithm = np.clip(components @ self.mixing, self.low[material], self.high[material])
        value, fitted = self.value[material, part], np.exp(logarithm)
        cosine = self.cosine[part]
        loss = np.sum(self.emphasis[part] * np.log((self.dark + cosine * fitted) / (self.dark + cosine * value)) ** 2)
        error = 0.0
        for z in (self.wi[part, 2:], self.wo[part, 2:]):
            error += np.sum(self.weight[part, None] * np.abs(np.log1p(z * fitted) - np.log1p(z * value)))
        return float(loss), float(error)


def _sizes(coefficients: int, components: int) -> tuple[int, ...]:
    """Coefficients of each component: two thirds for the first, the others alike."""
    if coefficients < components:
        raise ValueError(f"{components} components take as many coefficients at least, got {coefficients}")
    if components == 1:
        return (coefficients,)
    other = max(1, round(coefficients / (3 * (components - 1))))
    return (coefficients - (components - 1) * other, *[other] * (components - 1))


class _Equations:
    """Weighted normal equations of all components at once; each channel has its own weights."""

    def __init__(self, mixing: np.ndarray, sizes: tuple[int, ...]):
        self.mixing, self.sizes = mixing, sizes
        self.gram = np.zeros((mixing.shape[1], sizes[0], sizes[0]))
        self.moment = np.zeros((mixing.shape[1], sizes[0]))

    def add(self, rows: Array | np.ndarray, weight: np.ndarray, target: np.ndarray) -> None:
        for k, root in enumerate(np.sqrt(weight).T):
            weighted = root[:, None] * rows
            self.gram[k] += weighted.T @ weighted
            self.moment[k] += weighted.T @ (root * target[:, k])

    def solution(self, ridge: float) -> np.ndarray:
        """Coefficients `(modes, components)`, 0 where a component has none; the ridge is relative to the diagonal."""
        matrix = np.block([
            [np.tensordot(a * b, self.gram[:, :m, :n], 1) for b, n in zip(self.mixing, self.sizes, strict=True)]
            for a, m in zip(self.mixing, self.sizes, strict=True)
        ])  # fmt: skip
        moment = np.concatenate([a @ self.moment[:, :m] for a, m in zip(self.mixing, self.sizes, strict=True)])
        scale = np.sqrt(np.diag(matrix))
        scale[scale == 0] = 1
        matrix = matrix / np.outer(scale, scale) + ridge * np.eye(scale.size)
        found = np.linalg.solve(matrix, moment / scale) / scale
        ends = np.cumsum(self.sizes)
        return np.stack(
            [np.pad(found[end - n : end], (0, self.sizes[0] - n)) for n, end in zip(self.sizes, ends, strict=True)], 1
        )
