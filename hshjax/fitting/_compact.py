"""A measured isotropic material as a compact reciprocal model: the logarithm as a series over a half-vector basis."""

import operator
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import starmap
from os import PathLike
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Float, PairFunction
from hshjax.bases._warp import AbstractScaledWarp
from hshjax.brdfs._log_linear import LogLinearBRDF, leading_terms
from hshjax.fitting._compact_equations import (
    DARK,
    EVERYWHERE,
    FLOOR,
    Choice,
    Problem,
    Scale,
    fault_of,
    leading_basis,
)
from hshjax.fitting._lapack import suited_threads
from hshjax.fitting._outcome import Outcome
from hshjax.geometry import from_half_difference
from hshjax.metrics import with_channels
from hshjax.samples import Samples

ALPHAS = tuple(float(alpha) for alpha in np.logspace(-6, 0, 13))
"""Scales of the warp that are tried: half a decade apart, from lobes of 0.1 degrees to none."""

BETAS = (0.1, 0.01, 0.001, 0.0001)
"""Scales of the warp of θ_d that are tried: lobes back to the light from 25 degrees to one."""

NAMED = 3
"""Materials that an error names."""

HORIZON = float(np.radians(89.5))
"""Where tables and measurements end as a rule, off the normal [radians]."""


class CompactFit(eqx.Module):
    """What `fit_compact` has found.

    - `model`: a `LogLinearBRDF`; its `count` leaves out the scale α of the warp, and two bounds for each channel.
    - `alphas`, `losses` `(alphas,)`: the scales that were tried, and the loss of each with the functions that lead in
      `total_order`; the least and its neighbours are tried again with functions of the material's own. The loss is
      Σ |Δ ln(1 + ρ z)|, weighted, over the samples or some of them. At the end of the range a matte material wants no
      warp (the largest α), or a highlight is sharper than what was tried (the smallest).
    - `log_error`: mean |Δ ln(1 + ρ z)| over samples, channels and the two cosines z, weighted as the samples are. Of
      dark and matte materials that is an absolute error: `hshjax.relative_error` has the relative ones.
    - `albedo`: the largest directional one, of any channel, at 17 angles of the eye up to 80 degrees.
    - `samples`: how many have a weight. - `floored`: share of their values that lie below the floor, and count as it.
    - `result`: an `Outcome`. `uncertified`: no coefficients hold the albedo below 1, and `model` is the fit that does
      not. `unusable`: there is nothing to fit, or not at the directions of others: coefficients and figures are NaN.
    - `fault`: what it is in these two cases; else "".
    """

    model: LogLinearBRDF
    alphas: tuple[float, ...] = eqx.field(static=True)
    losses: Float[np.ndarray, " alphas"]
    log_error: float
    albedo: float
    samples: int = eqx.field(static=True)
    floored: float
    result: Outcome = eqx.field(default_factory=lambda: Outcome.converged)
    fault: str = eqx.field(static=True, default="")

    @property
    def message(self) -> str:
        """How the fit ended, and what to do."""
        return self.fault or str(Outcome[self.result])

    @property
    def alpha(self) -> float:
        """The scale of the model's warp."""
        return float(self.model.basis.warp.alpha)  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def beta(self) -> float | None:
        """The scale of the warp of the difference angle, where the material reflects back to the light; or None."""
        warp = self.model.basis.difference_warp  # pyright: ignore[reportAttributeAccessIssue]
        return float(warp.alpha) if isinstance(warp, AbstractScaledWarp) else None


def half_vector_samples(
    brdf: PairFunction,
    *,
    shape: tuple[int, int, int] = (92, 24, 6),
    largest: float = float(np.radians(80)),
    grazing: float = 0.05,
) -> Samples:
    """An isotropic BRDF on a grid that follows its highlight, reciprocal and bilateral.

    Centres of equal cells in sqrt(θ_h), θ_d and φ_d over [0, π/2] each, `shape` of them. Each value is the mean over
    φ_d, -φ_d, π - φ_d and π + φ_d: what violates reciprocity or mirror symmetry cancels. The weight is 1 where both
    directions lie less than `largest` [radians] from the normal; `grazing` beyond that, up to 89.5 degrees: little,
    for measurements err most there, and yet enough to hold what is fitted. 0 leaves those out.
    """
    h, d, f = ((np.arange(size) + 0.5) / size * np.pi / 2 for size in shape)
    grid = [axis.ravel() for axis in np.meshgrid(h**2 * 2 / np.pi, d, f, indexing="ij")]
    wi, wo = from_half_difference(*map(jnp.asarray, grid))
    lowest = np.asarray(jnp.minimum(wi[:, 2], wo[:, 2]))
    weight = np.where(lowest > np.cos(largest), 1.0, np.where(lowest > np.cos(HORIZON), grazing, 0.0))
    seen = weight > 0
    theta_h, theta_d, phi_d = (jnp.asarray(axis[seen]) for axis in grid)
    folded = [
        with_channels(jnp.asarray(brdf(*from_half_difference(theta_h, theta_d, phi))), 1)
        for phi in (phi_d, -phi_d, np.pi - phi_d, np.pi + phi_d)
    ]
    return Samples.scattered(
        wi[seen], wo[seen], sum(folded[1:], start=folded[0]) / 4, jnp.asarray(weight[seen]), isotropic=True
    )


def fit_compact(data: Samples | PairFunction, coefficients: int = 150, **settings) -> CompactFit:
    """A positive reciprocal model of an isotropic material in so many coefficients, all channels together.

    ln ρ is a series over `HalfVectorBasis`, in closed form for every scale α of its warp; the best one is kept, and of
    twice as many functions those without which least squares would lose most. Least squares are weighted such that
    differences count as (Δ ln(1 + ρ z / dark))², to first order, and weighted anew in some rounds until they count as
    |Δ ln(1 + ρ z / dark)|. Where a warp of the difference angle pays, there is one: retro-reflectors want it. Samples
    on a grid of half and difference angles (`half_vector_samples`, tables of that kind) take less than half the time.

    **Arguments:**

    - `data`: samples [sr^-1, no cosine], any channels; or a BRDF, which is sampled by `half_vector_samples`.
    - `coefficients`: how many in all, 25 to 300 as a rule, 1000 at most; time grows with their square and more. About
      two thirds make the shape, which channels share; the rest is colour.
    - `alphas`: scales to try, `ALPHAS` by default; of scattered samples those that their smallest half angle resolves.
    - `betas`: scales of the warp of the difference angle to try, `BETAS` by default; () for none. One is taken if it
      lowers the loss by a tenth.
    - `dark`: z ρ [sr^-1] below which differences count less: 0.05. - `everywhere`: share of a flat weight: 0.1.
    - `floor`: values below it [sr^-1], negative ones too, count as that: 1e-4, or that share of the largest value where
      it is less.
    - `rounds`: of new weights, 6. With 0 the error grows by a tenth, of measured materials by a third.
    - `ridge`: 3e-6, relative to the diagonal of the normal equations.
    - `energy`: whether to keep the directional albedo at most 1, every five degrees up to 80. True: of all that do, the
      model nearest to the fit, in the metric of its normal equations; what conserves energy is not touched.
    - `mixing` `(components, channels)`: see `LogLinearBRDF`; for spectra a few components do.

    Found on the host in float64, in blocks; not under `jax.jit`. `fit_compact_all` fits many materials.

    **Returns:** a `CompactFit`.

    **Raises:** ValueError, naming the count, for samples that are not finite, not of unit length or below the horizon;
    for no value above 0; for fewer samples than functions.

    Source: the weights and the warp were found on measured materials, see docs/decisions.md.
    """
    return fit_compact_all([data], coefficients, **settings)[0]


def fit_compact_all(
    data: Sequence[Samples | PairFunction],
    coefficients: int = 150,
    *,
    alphas: Sequence[float] = ALPHAS,
    betas: Sequence[float] = BETAS,
    dark: float = DARK,
    everywhere: float = EVERYWHERE,
    floor: float = FLOOR,
    ridge: float = 3e-6,
    rounds: int = 6,
    mixing: Any = None,
    energy: bool = True,
    throw: bool = True,
) -> list[CompactFit]:
    """`fit_compact` of every material, all with samples at the same directions: functions are evaluated once for all.

    - `throw`: whether one material that cannot be fitted is an error. If not, the others are fitted, and `result` and
      `message` of its own `CompactFit` say what is wrong with it.

    **Raises:** what `fit_compact` does, naming the material; ValueError for materials that differ in a direction, a
    weight or their channels from the first one that can be fitted, and where none can be, `throw` or not.
    """
    if isinstance(data, Samples) or callable(data):
        raise ValueError("fit_compact_all takes several materials, a list of Samples or BRDFs; fit_compact takes one")
    if operator.index(coefficients) < 1:
        raise ValueError(f"a model has at least one coefficient, got {coefficients}")
    for name, value in {"dark": dark, "everywhere": everywhere, "floor": floor, "ridge": ridge}.items():
        if not value > 0:
            raise ValueError(f"{name} must be > 0, got {value}")
    if rounds < 0:
        raise ValueError(f"rounds must be >= 0, got {rounds}")
    with jax.enable_x64(True):
        samples = list(starmap(_sampled, enumerate(data)))
        faults = _faults(samples, coefficients)
        if faults and (throw or len(faults) == len(samples)):
            raise ValueError(_said(faults))
        fitted = [k for k in range(len(samples)) if k not in faults]
        problem = Problem([samples[k] for k in fitted], coefficients, mixing, dark, everywhere, floor, ridge)
        tried, back = problem.resolved(alphas, betas)

    def one(place: int) -> Choice:
        with jax.enable_x64(True), _naming(fitted[place]):  # in this thread
            return problem.choice(place, tried, back, rounds, energy=energy)

    # A material is a chain of products too small for several threads; several materials are not.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with suited_threads(0), ThreadPoolExecutor(cores) as pool:
        found = list(pool.map(one, range(len(fitted))))
    broken = {k: choice.fault for k, choice in zip(fitted, found, strict=True) if choice.fault}
    if broken and throw:
        raise ValueError(_said(broken))
    fits = {k: _result(problem, place, k, found[place], tried) for place, k in enumerate(fitted)}
    return [fits[k] if k in fits else _nothing(problem, k, faults[k], tried) for k in range(len(samples))]


def _faults(samples: Sequence[Samples], coefficients: int) -> dict[int, str]:
    """What is wrong with which materials, beside the first with which nothing is."""
    if not samples:
        raise ValueError("there is no material to fit")
    faults, first = {}, None
    for k, one in enumerate(samples):
        of = k if first is None else first
        fault = fault_of(one, samples[of], coefficients, f"material {of}")
        if fault:
            faults[k] = fault
        elif first is None:
            first = k
    return faults


def _said(faults: dict[int, str]) -> str:
    named = [f"material {k} {fault}" for k, fault in faults.items()]
    more = [f"and {len(named) - NAMED} more"] if len(named) > NAMED else []
    return "; ".join([*named[:NAMED], *more])


@contextmanager
def _naming(material: int) -> Iterator[None]:
    """What goes wrong tells with which material."""
    try:
        yield
    except Exception as error:
        error.add_note(f"with material {material}")
        raise


def _sampled(material: int, data: Samples | PairFunction) -> Samples:
    with _naming(material):
        return data if isinstance(data, Samples) else half_vector_samples(_callable(data))


def _callable(data: Any) -> Any:
    if not callable(data):
        hint = "; hshjax.io.read_rgl reads a file" if isinstance(data, str | PathLike) else ""
        raise ValueError(f"a fit needs Samples or a function of pairs of directions, got a {type(data).__name__}{hint}")
    return data


def _result(problem: Problem, place: int, material: int, found: Choice, alphas: tuple[float, ...]) -> CompactFit:
    """The model of one material, in the default float of the caller. `place`: its number in the problem."""
    basis = leading_basis(found.scale, problem.candidates)
    parts = (found.coefficients, problem.mixing, found.low, problem.high[place])
    model = LogLinearBRDF(basis, *map(jnp.asarray, parts), terms=found.terms)
    floored = float(problem.floored[place])
    figures = found.losses, found.log_error, found.albedo, problem.weight.size, floored
    if found.fault:
        return CompactFit(model, alphas, *figures, Outcome.uncertified, f"material {material} {found.fault}")
    return CompactFit(model, alphas, *figures)


def _nothing(problem: Problem, material: int, fault: str, alphas: tuple[float, ...]) -> CompactFit:
    """In place of a material that cannot be fitted: of the shapes of the others, and NaN."""
    nan = np.full(problem.value.shape[2], np.nan)
    terms = leading_terms(problem.leading)
    parts = np.full(len(terms), np.nan), problem.mixing, nan, nan
    model = LogLinearBRDF(leading_basis(Scale(alphas[0]), problem.candidates), *map(jnp.asarray, parts), terms=terms)
    losses = np.full(len(alphas), np.nan)
    return CompactFit(
        model, alphas, losses, np.nan, np.nan, 0, np.nan, Outcome.unusable, f"material {material} {fault}"
    )
