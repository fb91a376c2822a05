"""The equations behind compact fits: many materials at the same directions, scale by scale. On the host, in float64."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array
from hshjax.bases import HalfVectorBasis, IdentityWarp, LogWarp, total_order
from hshjax.bases._half_vector import half_chart
from hshjax.brdfs._log_linear import contrasts, leading_terms
from hshjax.fitting._checks import check_samples
from hshjax.fitting._eliminate import eliminate
from hshjax.fitting._furnace import LIMIT, Furnace, conserved
from hshjax.fitting._norms import named_norm
from hshjax.samples import Samples

DARK, EVERYWHERE, FLOOR = 0.03, 0.1, 1e-4
"""Defaults of what `fit_compact` says of them."""

MARGIN = 0.7
"""How far ln ρ may leave the range of the data, a factor of two."""

ROWS = 2**14
"""Samples that are looked at together."""

GLANCE = 3000
"""Samples that tell one scale from another."""

SPARE = 10
"""A function is chosen out of two, and of these more."""


class Choice(eqx.Module):
    """The functions of one material at one α, their coefficients, and how far they are from the samples."""

    terms: np.ndarray
    coefficients: np.ndarray
    log_error: float
    albedo: float


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
        self.coefficients = coefficients
        self.leading = _sizes(coefficients, self.mixing.shape[0])
        self.dark, self.ridge = dark, ridge
        self._check(floor)
        # Few samples do not tell which functions matter.
        limit = self.weight.size // 3
        self.candidates = tuple(max(size, min(2 * size + SPARE, limit)) for size in self.leading)
        self.floored = np.mean(self.value < floor, axis=(1, 2))
        self.value = np.maximum(self.value, floor)
        self.target = np.log(self.value)
        self.low, self.high = self.target.min(axis=1) - MARGIN, self.target.max(axis=1) + MARGIN

        self.o = np.asarray(half_chart(IdentityWarp(), jnp.asarray(self.wi), jnp.asarray(self.wo)).u)
        theta_h = 2 * np.arcsin(np.sqrt(np.minimum(self.o / 2, 1)))
        self.cosine = (self.wi[:, 2:] + self.wo[:, 2:]) / 2
        # Off the highlight there is more to see than a grid that follows it has samples of.
        self.emphasis = (self.weight * (0.5 + 0.75 * np.sqrt(2 * theta_h / np.pi)))[:, None]
        self.importance = self.emphasis * visibility(self.cosine * self.value, dark, everywhere)
        self.alike = self.importance.mean(axis=2, keepdims=True)
        self.glance = np.sort(np.random.default_rng(0).permutation(self.weight.size)[:GLANCE])

    def _check(self, floor: float) -> None:
        if self.mixing.ndim != 2 or self.mixing.shape[1] != self.value.shape[2]:
            raise ValueError(f"mixing must have shape (components, {self.value.shape[2]}), got {self.mixing.shape}")
        for k, value in enumerate(self.value):
            if not np.any(value > floor):
                raise ValueError(f"material {k} is black: no value is above the floor of {floor:g}")
        if self.weight.size < self.leading[0]:
            raise ValueError(
                f"{self.weight.size} samples do not determine {self.leading[0]} functions "
                f"of {self.coefficients} coefficients"
            )

    def resolved(self, alphas: Sequence[float]) -> tuple[float, ...]:
        """The scales that the samples resolve: not far below their smallest 1 - cos θ_h, or else the largest."""
        tried = tuple(float(alpha) for alpha in alphas)
        if not tried or min(tried) <= 0:
            raise ValueError(f"scales are positive, at least one, got {tried}")
        return tuple(alpha for alpha in tried if alpha >= 0.1 * self.o.min()) or (max(tried),)

    def best(self, alphas: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
        """The number of the best scale of every material, and the losses `(alphas, materials)` of leading functions.

        The best of those, and its neighbours, are tried again with functions of each material's own.
        """
        everyone = list(range(len(self.value)))
        losses = np.stack([self._losses(alpha, self.leading, everyone) for alpha in alphas])
        first, again = np.argmin(losses, axis=0), np.full_like(losses, np.inf)
        for k, alpha in enumerate(alphas):
            near = np.flatnonzero(np.abs(first - k) <= 1).tolist()
            again[k, near] = self._losses(alpha, self.candidates, near)
        return np.argmin(again, axis=0), losses

    def _losses(self, alpha: float, sizes: tuple[int, ...], materials: list[int]) -> np.ndarray:
        """Σ (Δ ln(1 + ρ z / dark))², weighted, at one scale and at a glance: all channels share their weights."""
        blocks = self._blocks(alpha, sizes, self.glance)
        sums = np.zeros(len(materials))
        for place, (k, equations) in enumerate(self._equations(materials, sizes, self.alike, blocks)):
            columns = equations.columns(*equations.solution(self.coefficients, self.ridge))
            for part, rows in blocks():
                value, fitted, cosine = self.value[k, part], self._fitted(k, columns, rows), self.cosine[part]
                difference = np.log((self.dark + cosine * fitted) / (self.dark + cosine * value))
                sums[place] += np.sum(self.emphasis[part] * difference**2)
        return sums

    def choices(self, alpha: float, materials: Sequence[int], *, energy: bool) -> list[Choice]:
        """Some materials at one scale, each with functions of its own; with `energy` no albedo is above 1."""
        blocks = self._blocks(alpha, self.candidates, np.arange(self.weight.size))
        furnace, found = Furnace(leading_basis(alpha, self.candidates)), []
        for k, equations in self._equations(materials, self.candidates, self.importance, blocks):
            terms, coefficients = equations.solution(self.coefficients, self.ridge)
            columns, bounds = equations.columns(terms, coefficients), (self.low[k], self.high[k])
            albedo = furnace.albedo(columns @ self.mixing, *bounds).max()
            if energy and albedo > LIMIT:
                matrix = equations.matrix(terms, self.ridge)
                coefficients = conserved(furnace, matrix, terms, coefficients, self.mixing, *bounds)
                columns = equations.columns(terms, coefficients)
                albedo = furnace.albedo(columns @ self.mixing, *bounds).max()
            error = 0.0
            for part, rows in blocks():
                value, fitted = self.value[k, part], self._fitted(k, columns, rows)
                for z in (self.wi[part, 2:], self.wo[part, 2:]):
                    error += np.sum(self.weight[part, None] * np.abs(np.log1p(z * fitted) - np.log1p(z * value)))
            mean = float(error / (2 * self.weight.sum() * self.value.shape[2]))
            found.append(Choice(terms, coefficients, mean, float(albedo)))
        return found

    def _fitted(self, material: int, columns: np.ndarray, rows: Array) -> np.ndarray:
        logarithm = np.asarray(rows).T @ (columns @ self.mixing)
        return np.exp(np.clip(logarithm, self.low[material], self.high[material]))

    def _equations(self, materials, sizes, weight: np.ndarray, blocks) -> Iterator[tuple[int, "_Equations"]]:
        found = {k: _Equations(self.mixing, sizes) for k in materials}
        for part, rows in blocks():
            for k, one in found.items():
                one.add(rows, weight[k, part], self.target[k, part])
        yield from found.items()

    def _blocks(self, alpha, sizes, samples: np.ndarray) -> Callable[[], Iterator[tuple[np.ndarray, Array]]]:
        """Parts of the samples with functions `(functions, samples)`, as often as asked for; a single part is kept."""
        basis = leading_basis(alpha, sizes)
        parts = [samples[start : start + ROWS] for start in range(0, samples.size, ROWS)]

        def rows(part):
            return basis(jnp.asarray(self.wi[part]), jnp.asarray(self.wo[part])).T

        if len(parts) == 1:
            kept = [(parts[0], rows(parts[0]))]
            return lambda: iter(kept)
        return lambda: ((part, rows(part)) for part in parts)


def leading_basis(alpha: float, sizes: Sequence[int]) -> HalfVectorBasis:
    """The functions that components of these sizes need, the first of which is the largest, at one scale."""
    return HalfVectorBasis(total_order(sizes[0]), LogWarp(jnp.asarray(alpha)))


def visibility(seen: np.ndarray, dark: float, everywhere: float) -> np.ndarray:
    """Squared weights of differences in ln ρ that make them count as |Δ ln(1 + ρ z / dark)|; `seen` is ρ z."""
    return (seen / (dark + seen)) ** 2 + everywhere**2


def _sizes(coefficients: int, components: int) -> tuple[int, ...]:
    """Coefficients of each component: two thirds for the first, the others alike."""
    if coefficients < components:
        raise ValueError(f"{components} components take as many coefficients at least, got {coefficients}")
    if components == 1:
        return (coefficients,)
    other = max(1, round(coefficients / (3 * (components - 1))))
    return (coefficients - (components - 1) * other, *[other] * (components - 1))


class _Equations:
    """Weighted normal equations of all components at once; each channel has its own weights, or all have the same."""

    def __init__(self, mixing: np.ndarray, sizes: tuple[int, ...]):
        self.mixing, self.sizes = mixing, sizes
        self.gram: Any = 0.0
        self.moment: Any = 0.0
        self.terms = leading_terms(sizes)

    def add(self, rows: Array, weight: np.ndarray, target: np.ndarray) -> None:
        self.gram = self.gram + np.asarray(_gram(rows, jnp.asarray(weight.T)))
        self.moment = self.moment + (np.asarray(rows) @ (weight * target)).T

    def _system(self) -> np.ndarray:
        products = self.mixing[:, None] * self.mixing[None]
        if len(self.gram) == 1:
            products = products.sum(axis=2, keepdims=True)
        return np.block([
            [np.tensordot(products[i, j], self.gram[:, :m, :n], 1) for j, n in enumerate(self.sizes)]
            for i, m in enumerate(self.sizes)
        ])  # fmt: skip

    def matrix(self, terms: np.ndarray, ridge: float) -> np.ndarray:
        """The normal matrix of some terms, with the ridge."""
        place = np.cumsum([0, *self.sizes[:-1]])[terms[:, 1]] + terms[:, 0]
        found = self._system()[np.ix_(place, place)]
        return found + ridge * np.diag(np.diag(found))

    def solution(self, count: int, ridge: float) -> tuple[np.ndarray, np.ndarray]:
        """The `count` terms (function, component) that matter most, and their coefficients."""
        moment = np.concatenate([(a @ self.moment)[:n] for a, n in zip(self.mixing, self.sizes, strict=True)])
        kept, coefficients = eliminate(self._system(), moment, count, ridge=ridge)
        return self.terms[kept], coefficients

    def columns(self, terms: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients `(functions, components)`, 0 where there is no term."""
        found = np.zeros((self.sizes[0], len(self.sizes)))
        found[terms[:, 0], terms[:, 1]] = coefficients
        return found


@jax.jit
def _gram(rows: Array, weight: Array) -> Array:
    """Σ_s w_s B_as B_bs for the weights of each channel, `(weights, functions, functions)`, one after the other."""
    return jax.lax.map(lambda one: (rows * one[None]) @ rows.T, weight)
