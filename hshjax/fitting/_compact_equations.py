"""Compact fits of many materials with samples at the same directions. On the host, in float64."""

from collections import OrderedDict
from collections.abc import Sequence
from threading import Lock
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from hshjax.bases import HalfVectorBasis, IdentityWarp, LogWarp, total_order
from hshjax.bases._half_vector import half_chart
from hshjax.brdfs._log_linear import contrasts, leading_terms
from hshjax.fitting._checks import check_samples
from hshjax.fitting._compact_grid import GridRows, find_grid
from hshjax.fitting._compact_rows import AbstractRows, ScatteredRows
from hshjax.fitting._eliminate import eliminate
from hshjax.fitting._furnace import LIMIT, Furnace, conserved
from hshjax.fitting._least_distance import InfeasibleError
from hshjax.fitting._norms import named_norm
from hshjax.samples import Samples

DARK, EVERYWHERE, FLOOR = 0.05, 0.1, 1e-4
"""Defaults of what `fit_compact` says of them."""

DARKEST = 1e-4
"""Share of a material's largest value up to which its floor goes, where that is less."""

MARGIN = 0.7
"""How far ln ρ may leave the range of the data, a factor of two."""

MOST = 1000
"""Coefficients: time grows with their third power."""

GLANCE = 3000
"""Scattered samples that tell one scale from another."""

KEPT = 24
"""Scales at which functions at samples are kept, those asked for last."""

SPARE = 10
"""A function is chosen out of two, and of these more."""

WORTH = 0.9
"""Share of the loss without one that such a warp must get below."""

SHARP = 0.005
"""Differences of ln(1 + ρ z / dark) beyond which a sample counts by its distance, not by its square."""


class Scale(NamedTuple):
    """Of the two warps; None for no warp of the difference angle."""

    alpha: float
    beta: float | None = None


class Candidate(NamedTuple):
    """Coefficients of terms (function, component) at one scale, and their loss."""

    loss: float
    scale: Scale
    terms: np.ndarray
    coefficients: np.ndarray


class Choice(NamedTuple):
    """What a material's fit is made of, and how far it is from the samples."""

    scale: Scale
    terms: np.ndarray
    coefficients: np.ndarray
    low: np.ndarray
    losses: np.ndarray
    log_error: float
    albedo: float
    fault: str = ""
    """What was asked for and is not so, after the name of the material."""


def fault_of(samples: Samples, first: Samples, coefficients: int, name: str = "material 0") -> str:
    """Why a material cannot be fitted beside the `first`, which is called `name`: words to follow its own name. "" if
    it can be."""
    try:
        check_samples(samples, named_norm("C"), coefficients, ridged=True)
    except ValueError as error:
        return f"cannot be fitted: {error}"
    if (
        any(not np.array_equal(getattr(samples, part), getattr(first, part)) for part in ("wi", "wo", "weight"))
        or samples.channels != first.channels
    ):
        return f"differs from {name} in its directions, weights or channels"
    if not np.any(np.asarray(samples.value)[np.asarray(samples.weight) > 0] > 0):
        return "is black: no value is above 0"
    return ""


class Problem:
    """Many materials at the same directions, none with a `fault_of`, and one number of coefficients. Host arrays,
    float64."""

    def __init__(self, samples: list[Samples], coefficients, mixing, dark, everywhere, floor, ridge):
        first = samples[0]
        used = np.asarray(first.weight) > 0
        self.wi, self.wo, self.weight = (np.asarray(a, np.float64)[used] for a in (first.wi, first.wo, first.weight))
        self.value = np.stack([np.asarray(one.value, np.float64)[used] for one in samples])
        self.mixing = contrasts(first.channels) if mixing is None else np.asarray(mixing, np.float64)
        self.coefficients = coefficients
        self.leading = _sizes(coefficients, self.mixing.shape[0])
        self.dark, self.everywhere, self.ridge = dark, everywhere, ridge
        self._check()
        # Few samples do not tell which functions matter.
        limit = self.weight.size // 3
        self.candidates = tuple(max(size, min(2 * size + SPARE, limit)) for size in self.leading)
        raised = np.stack([floored(value, floor) for value in self.value])
        self.floored = np.mean(self.value < raised, axis=(1, 2))
        self.value = raised
        self.target = np.log(self.value)
        self.low, self.high = self.target.min(axis=1) - MARGIN, self.target.max(axis=1) + MARGIN

        chart = half_chart(IdentityWarp(), jnp.asarray(self.wi), jnp.asarray(self.wo))
        self.o, self.o_d = np.asarray(chart.u), np.asarray(chart.v)
        theta_h = 2 * np.arcsin(np.sqrt(np.minimum(self.o / 2, 1)))
        self.cosine = (self.wi[:, 2:] + self.wo[:, 2:]) / 2
        # Off the highlight there is more to see than a grid that follows it has samples of.
        self.emphasis = (self.weight * (0.5 + 0.75 * np.sqrt(2 * theta_h / np.pi)))[:, None]

        self.grid = find_grid(self.wi, self.wo, float(jnp.finfo(first.wi.dtype).eps))
        everyone = np.arange(self.weight.size)
        some = np.sort(np.random.default_rng(0).permutation(everyone)[:GLANCE])
        self.glance = everyone if self.grid is not None else some
        self.furnace = Furnace()
        self._rows: OrderedDict[tuple[Scale, int], AbstractRows] = OrderedDict()
        self._lock = Lock()

    def _check(self) -> None:
        if self.mixing.ndim != 2 or self.mixing.shape[1] != self.value.shape[2]:
            raise ValueError(f"mixing must have shape (components, {self.value.shape[2]}), got {self.mixing.shape}")
        if self.weight.size < self.leading[0]:
            raise ValueError(
                f"{self.weight.size} samples do not determine {self.leading[0]} functions of {self.coefficients} "
                "coefficients: ask for fewer, or take hshjax.infer_compact"
            )

    def resolved(self, alphas: Sequence[float], betas: Sequence[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The scales that the samples resolve: not far below their smallest 1 - cos θ_h (or else the largest), and
        1 - cos θ_d.
        """
        alphas, betas = (tuple(sorted({float(scale) for scale in tried})) for tried in (alphas, betas))
        if not alphas or min((*alphas, *betas)) <= 0:
            raise ValueError(f"scales are positive, at least one alpha, got {alphas} and betas {betas}")
        return (
            tuple(alpha for alpha in alphas if alpha >= 0.1 * self.o.min()) or (max(alphas),),
            tuple(beta for beta in betas if beta >= 0.1 * self.o_d.min()),
        )

    def choice(self, k: int, alphas: Sequence[float], betas: Sequence[float], rounds: int, *, energy: bool) -> Choice:
        """The fit of material k: its scales, functions of its own, coefficients; with `energy` no albedo is above 1.

        Scales are told apart by the functions that lead in `total_order`; the best and its neighbours are tried with
        functions of the material's own, and the best of these in so many `rounds` of weights.
        """
        losses = np.array([self._leading(k, Scale(alpha)) for alpha in alphas])
        best = int(np.argmin(losses))
        beta = self._back(k, alphas[best], betas, losses[best])
        near = [Scale(alpha, beta) for alpha in alphas[max(best - 1, 0) : best + 2]]
        first = min(rounds, 1)
        found = min((self._own(k, scale, self.glance, first) for scale in near), key=lambda one: one.loss)
        everyone = np.arange(self.weight.size)
        if self.glance.size == everyone.size:
            found = self._own(k, found.scale, everyone, rounds - first, found)
        else:
            found = self._own(k, found.scale, everyone, rounds)
        return self._finished(k, found, losses, energy=energy)

    def _back(self, k: int, alpha: float, betas: Sequence[float], loss: float) -> float | None:
        """The scale of a lobe about wi = wo, if there is one: a warp of θ_d must pay."""
        losses = [self._leading(k, Scale(alpha, beta)) for beta in betas]
        if not losses or min(losses) > WORTH * loss:
            return None
        return betas[int(np.argmin(losses))]

    def _leading(self, k: int, scale: Scale) -> float:
        """The loss of the functions that lead, at a glance, all channels under the same weights."""
        equations = self._equations(k, scale, self.glance, self._weight(k, self.glance).mean(axis=1, keepdims=True))
        terms = leading_terms(self.leading)
        return self._loss(k, self.glance, self._logarithm(k, scale, self.glance, terms, equations.solve(terms)))

    def _own(self, k: int, scale: Scale, part: np.ndarray, rounds: int, last: Candidate | None = None) -> Candidate:
        """The best of some rounds of functions of the material's own, reweighted by how far the last round was off."""
        if last is None:
            last = self._chosen(k, scale, part, self._weight(k, part))
        tried = [last]
        for _ in range(rounds):
            logarithm = self._logarithm(k, scale, part, last.terms, last.coefficients)
            last = self._chosen(k, scale, part, self._weight(k, part, logarithm))
            tried.append(last)
        return min(tried, key=lambda one: one.loss)

    def _chosen(self, k: int, scale: Scale, part: np.ndarray, weight: np.ndarray) -> Candidate:
        """Least squares under some weights, in functions of the material's own."""
        terms, coefficients = self._equations(k, scale, part, weight).choose(self.coefficients)
        logarithm = self._logarithm(k, scale, part, terms, coefficients)
        return Candidate(self._loss(k, part, logarithm), scale, terms, coefficients)

    def _equations(self, k: int, scale: Scale, part: np.ndarray, weight: np.ndarray) -> "_Equations":
        rows = self.rows(scale, part)
        target = self.target[k, part]
        return _Equations(rows.gram(weight), rows.moment(weight * target), self.mixing, self.candidates, self.ridge)

    def rows(self, scale: Scale, part: np.ndarray) -> AbstractRows:
        """Candidate functions at some samples; kept for all materials, those asked for last."""
        with self._lock:
            key = scale, part.size
            if key not in self._rows:
                basis, pairs = leading_basis(scale, self.candidates), (self.wi[part], self.wo[part])
                self._rows[key] = ScatteredRows(basis, *pairs) if self.grid is None else GridRows(basis, self.grid)
                if len(self._rows) > KEPT:
                    self._rows.popitem(last=False)
            self._rows.move_to_end(key)
            return self._rows[key]

    def _logarithm(self, k, scale, part, terms, coefficients, low=None) -> np.ndarray:
        """ln ρ of a fit, within its bounds, `(n, channels)`."""
        logarithm = self.rows(scale, part).evaluate(self._columns(terms, coefficients))
        return np.clip(logarithm, self.low[k] if low is None else low, self.high[k])

    def _columns(self, terms: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients of every candidate function in every channel."""
        found = np.zeros((self.candidates[0], len(self.mixing)))
        found[terms[:, 0], terms[:, 1]] = coefficients
        return found @ self.mixing

    def _loss(self, k: int, part: np.ndarray, logarithm: np.ndarray) -> float:
        """Σ |Δ ln(1 + ρ z)|, with emphasis, z the mean of both cosines."""
        cosine = self.cosine[part]
        difference = np.log1p(cosine * np.exp(logarithm)) - np.log1p(cosine * self.value[k, part])
        return float(np.sum(self.emphasis[part] * np.abs(difference)))

    def _weight(self, k: int, part: np.ndarray, logarithm: np.ndarray | None = None) -> np.ndarray:
        """Squared weights of differences in ln ρ, `(n, channels)`.

        At first what makes them count as (Δ ln(1 + ρ z / dark))², to first order; of a fit, what makes its own count as
        |Δ ln(1 + ρ z / dark)|, exactly, beyond `SHARP`.
        """
        seen = self.cosine[part] * self.value[k, part]
        if logarithm is None:
            return self.emphasis[part] * visibility(seen, self.dark, self.everywhere)
        off = logarithm - self.target[k, part]
        difference = np.log((self.dark + self.cosine[part] * np.exp(logarithm)) / (self.dark + seen))
        near = np.abs(off) < 1e-6
        slope = np.where(near, seen / (self.dark + seen), difference / np.where(near, 1, off))
        return self.emphasis[part] * (slope**2 / np.hypot(1, difference / SHARP) + SHARP * self.everywhere**2)

    def _finished(self, k: int, found: Candidate, losses: np.ndarray, *, energy: bool) -> Choice:
        """With the albedo held below 1, if asked for, and what is to be said of the fit."""
        everyone, (scale, terms, coefficients) = np.arange(self.weight.size), found[1:]
        basis, low, high = leading_basis(scale, self.candidates), self.low[k], self.high[k]
        nodes = jnp.asarray(self.furnace.wi), jnp.asarray(self.furnace.wo)
        logarithm = self._logarithm(k, scale, everyone, terms, coefficients)

        def albedo() -> float:
            exponent = np.asarray(basis.evaluate(jnp.asarray(self._columns(terms, coefficients)), *nodes))
            return float(self.furnace.sums(np.exp(np.clip(exponent, low, high))).max())

        largest, fault = albedo(), ""
        if energy and largest > LIMIT:
            matrix = self._equations(k, scale, everyone, self._weight(k, everyone, logarithm)).matrix(terms)
            functions = np.asarray(basis(*nodes))
            try:
                coefficients, low = conserved(
                    self.furnace, functions, matrix, terms, coefficients, self.mixing, low, high
                )
            except InfeasibleError:
                fault = (
                    f"has an albedo of {largest:.3g}, and no coefficients of its functions bring it below 1: "
                    "energy=False fits it as it is"
                )
            else:
                logarithm, largest = self._logarithm(k, scale, everyone, terms, coefficients, low), albedo()
        errors = [
            np.abs(np.log1p(z * np.exp(logarithm)) - np.log1p(z * self.value[k]))
            for z in (self.wi[:, 2:], self.wo[:, 2:])
        ]
        mean = np.average(np.mean(errors, axis=(0, 2)), weights=self.weight)
        return Choice(scale, terms, coefficients, low, losses, float(mean), largest, fault)


def leading_basis(scale: Scale, sizes: Sequence[int]) -> HalfVectorBasis:
    """The functions that components of these sizes need, the first of which is the largest, at one scale."""
    back = IdentityWarp() if scale.beta is None else LogWarp(jnp.asarray(scale.beta))
    return HalfVectorBasis(total_order(sizes[0]), LogWarp(jnp.asarray(scale.alpha)), back)


def floored(value: np.ndarray, floor: float) -> np.ndarray:
    """Values of one material, none below the floor, or below `DARKEST` of its largest value where that is less."""
    return np.maximum(value, min(floor, DARKEST * value.max()))


def visibility(seen: np.ndarray, dark: float, everywhere: float) -> np.ndarray:
    """Squared weights of differences in ln ρ that make them count as |Δ ln(1 + ρ z / dark)|; `seen` is ρ z."""
    return (seen / (dark + seen)) ** 2 + everywhere**2


def _sizes(coefficients: int, components: int) -> tuple[int, ...]:
    """Coefficients of each component: two thirds for the first, the others alike."""
    if coefficients > MOST:
        raise ValueError(
            f"a compact model has at most {MOST} coefficients, got {coefficients}: where that is not enough, "
            "hshjax.tabulate makes a table"
        )
    if coefficients < components:
        raise ValueError(f"{components} components take as many coefficients at least, got {coefficients}")
    if components == 1:
        return (coefficients,)
    other = max(1, round(coefficients / (3 * (components - 1))))
    return (coefficients - (components - 1) * other, *[other] * (components - 1))


class _Equations:
    """Weighted normal equations of all components at once; each channel has its own weights, or all have the same."""

    def __init__(self, gram: np.ndarray, moment: np.ndarray, mixing: np.ndarray, sizes: tuple[int, ...], ridge: float):
        products = mixing[:, None] * mixing[None]
        if len(gram) == 1:
            products = products.sum(axis=2, keepdims=True)
        self.terms, self.ridge = leading_terms(sizes), ridge
        self.system = np.block([
            [np.tensordot(products[i, j], gram[:, :m, :n], 1) for j, n in enumerate(sizes)]
            for i, m in enumerate(sizes)
        ])  # fmt: skip
        self.moment = np.concatenate([(a @ moment)[:n] for a, n in zip(mixing, sizes, strict=True)])
        self.start = np.cumsum([0, *sizes[:-1]])

    def _place(self, terms: np.ndarray) -> np.ndarray:
        return self.start[terms[:, 1]] + terms[:, 0]

    def matrix(self, terms: np.ndarray) -> np.ndarray:
        """The normal matrix of some terms, with the ridge."""
        place = self._place(terms)
        found = self.system[np.ix_(place, place)]
        diagonal = np.diag(found)
        return found + self.ridge * np.diag(
            np.where(diagonal > 0, diagonal, 1)
        )  # 0 where a function is, at all samples

    def solve(self, terms: np.ndarray) -> np.ndarray:
        """Coefficients of some terms (function, component)."""
        return np.linalg.solve(self.matrix(terms), self.moment[self._place(terms)])

    def choose(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The `count` terms that matter most, and their coefficients; the constant, which is brightness, among them."""
        kept, coefficients = eliminate(self.system, self.moment, count, ridge=self.ridge, needed=1)
        return self.terms[kept], coefficients
