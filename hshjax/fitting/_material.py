"""One material, one call: the fits that the `hshjax` command offers, of tables and of scattered samples alike."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax._typing import PairFunction
from hshjax.bases import HSH, AbstractPairBasis, HelmholtzBasis, IsotropicBasis, TensorBasis
from hshjax.brdfs import GGX, AbstractBRDF, CookTorrance, ExpBRDF, HalfVectorTable, Lambert
from hshjax.brdfs._isotropy import is_isotropic
from hshjax.brdfs._known import known, table_samples
from hshjax.fitting._checks import check_values
from hshjax.fitting._compact import CompactFit, fit_compact, half_vector_samples
from hshjax.fitting._compact_posterior import CompactPosterior
from hshjax.fitting._constraints import check_constraints
from hshjax.fitting._fit import fit
from hshjax.fitting._guess import initial_guesses
from hshjax.fitting._infer_compact import infer_compact
from hshjax.fitting._mappings import CosineWeighted
from hshjax.fitting._multi_start import multi_start
from hshjax.fitting._norms import named_norm
from hshjax.fitting._positive_start import positive_start
from hshjax.fitting._prior import penalty
from hshjax.fitting._project import SEARCHED, WHOLE, project
from hshjax.fitting._project_by_moments import project_by_moments
from hshjax.fitting._result import Fit, IterativeFit
from hshjax.fitting._terms import SampleMisfit, Smoothness
from hshjax.io._directions import one_azimuth
from hshjax.quadrature import ANISOTROPIC_DEGREE, isotropic_pair_rule, pair_rule
from hshjax.samples import Samples

MaterialModel = Literal["linear", "compact", "inferred", "exp", "cook-torrance", "ggx"]

OnStep = Callable[[str], Callable[[Any, Any], None] | None]
"""Called with the name of an iterative fit that begins; gives its `on_step` (see `fit`), or None."""


class MaterialFit(NamedTuple):
    """What `fit_material` has found.

    - `model`: the fitted BRDF. - `samples`: what errors are measured on: the samples given, or a table's nodes.
    - `details`: of the fit itself: a `Fit` (linear), `CompactFit`, `CompactPosterior` (inferred), or the `IterativeFit`
      of every channel (exp) or of all (lobes).
    - `notes`: what was decided on the way, a sentence each.
    """

    model: AbstractBRDF
    samples: Samples
    details: Fit | CompactFit | CompactPosterior | tuple[IterativeFit, ...]
    notes: tuple[str, ...] = ()


def fit_material(
    data: Samples | PairFunction,
    model: MaterialModel = "linear",
    *,
    basis: AbstractPairBasis | None = None,
    coefficients: int = 150,
    norm: str = "D",
    ridge: float = 1e-5,
    constraints: tuple[str, ...] = (),
    degree: int = 64,
    max_steps: int = 100,
    on_step: OnStep | None = None,
) -> MaterialFit:
    """Fit a measured material: a BRDF that can be evaluated anywhere, or samples wherever they lie.

    - `data`: a BRDF, sampled on an `isotropic_pair_rule` of `degree`, a table of half and difference angles at its own
      nodes for a linear model; not where it has no value. Or samples, scattered or on a rule. Weights of
      scattered samples are scaled such that they add up to (2π)², as those of a rule: `ridge` means the same for both.
    - `model`: "linear": a series in `basis` (None: isotropic, HSH of order 8) by `project` in `norm`, with a spectral
      prior of weight `ridge`. "compact": `fit_compact` in so many `coefficients`, of a BRDF on samples of its own.
      "inferred": `infer_compact` in as many functions. "exp": the exponential of a series in `basis`, `ridge` relative
      to the energy, channel by channel. "cook-torrance", "ggx": that lobe and a diffuse part, from many starts.
    - `constraints`: of a linear model, see `project`.

    An anisotropic BRDF takes a linear model, over the `HelmholtzBasis` of the same functions, on a `pair_rule`. So do
    samples that are not `isotropic` where they outnumber its functions; where they do not, and by other models, they
    are fitted as those of an isotropic material. `notes` says which.

    **Raises:** ValueError as these functions do; for another model, and another one than linear where the BRDF is
    anisotropic.
    """
    check_settings(model, basis, norm, ridge, constraints)
    pairs, notes = IsotropicBasis(HSH(8)) if basis is None else basis, ()
    if not isinstance(data, Samples) and not is_isotropic(data):
        if model != "linear":
            raise ValueError(f"this material is anisotropic: model must be linear, in a basis for that, got {model!r}")
        pairs = _anisotropic(pairs)
        samples = table_samples(data, pair_rule(max(ANISOTROPIC_DEGREE, 2 * pairs.basis.order)))
    elif isinstance(data, Samples):
        samples = levelled(data)
        pairs, notes = _suited(pairs, samples, model)
    elif isinstance(data, HalfVectorTable) and model == "linear":
        samples = data.node_samples()
    else:
        samples = table_samples(data, isotropic_pair_rule(degree))
    begin = on_step if on_step is not None else lambda _: None
    if model == "linear":
        prior = "spectral" if ridge else None
        if samples.size <= SEARCHED or constraints:  # `project` also says how reciprocal they are
            found = project(pairs, samples, norm=norm, ridge=ridge, prior=prior, constraints=constraints)
        else:
            found = project_by_moments(pairs, samples, norm=norm, ridge=ridge, prior=prior)
        return MaterialFit(found.model, samples, found, notes)
    if model == "compact":
        compact = fit_compact(samples if isinstance(data, Samples) else _along_highlight(data), coefficients)
        return MaterialFit(compact.model, samples, compact, notes)
    if model == "inferred":
        posterior = infer_compact(samples, coefficients)
        return MaterialFit(posterior.model, samples, posterior, notes)
    check_values(samples, named_norm("D"))  # a norm has no say in what is finite
    samples = samples.cleared()
    if model == "exp":
        return _exponential(pairs, samples, ridge, max_steps, begin)._replace(notes=notes)
    return _lobe(model, samples, max_steps, begin)._replace(notes=notes)


def check_settings(
    model: str, basis: AbstractPairBasis | None, norm: str, ridge: float, constraints: tuple[str, ...]
) -> None:
    """What `fit_material` refuses whatever the material is: ValueError, TypeError for what is no basis."""
    if model not in get_args(MaterialModel):
        raise ValueError(f"model must be one of {', '.join(get_args(MaterialModel))}, got {model!r}")
    basis = IsotropicBasis(HSH(8)) if basis is None else basis
    penalty(basis, ridge, None)
    if model == "linear":
        named_norm(norm)
        check_constraints(constraints, rounds=1)  # which nobody sets here


def _anisotropic(pairs: AbstractPairBasis) -> HelmholtzBasis | TensorBasis:
    """The basis itself, or the reciprocal one for anisotropic materials over the same functions of one direction."""
    if isinstance(pairs, IsotropicBasis):
        return HelmholtzBasis(pairs.basis)
    if isinstance(pairs, HelmholtzBasis | TensorBasis):
        return pairs
    raise ValueError(f"this material is anisotropic, which {pairs} cannot follow")


def _suited(
    pairs: AbstractPairBasis, samples: Samples, model: MaterialModel
) -> tuple[AbstractPairBasis, tuple[str, ...]]:
    """The basis that samples are fitted by, and why, where they may be those of an anisotropic material."""
    follows = model in ("linear", "exp") and not pairs.isotropic
    if samples.isotropic or follows:
        return pairs, ()
    if one_azimuth(np.asarray(samples.wi)):
        return pairs, ("light comes from one azimuth: fitted as an isotropic material",)
    told = "light comes from several azimuths, and nothing says that the material is isotropic"
    if model != "linear":
        return pairs, (f"{told}: fitted as an isotropic one all the same; a linear model could follow another",)
    if not isinstance(pairs, IsotropicBasis):
        return pairs, (f"{told}: fitted as an isotropic material all the same, by {pairs}",)
    full, used = HelmholtzBasis(pairs.basis), int(jnp.sum(samples.weight > 0))
    if used > full.count:
        return full, (f"{told}: fitted as an anisotropic one, by {full.count} functions",)
    few = f"{used} samples do not determine {full.count} functions"
    return pairs, (f"{told}, but {few}: fitted as an isotropic one; a lower order has fewer",)


def _along_highlight(brdf: PairFunction) -> Samples:
    """`half_vector_samples`, with weight 0 where a table has no value."""
    samples = half_vector_samples(brdf)
    return samples.reweighted(jnp.where(known(brdf, samples.wi, samples.wo), samples.weight, 0))


def levelled(samples: Samples) -> Samples:
    """Scattered samples with weights that add up to (2π)² sr², those of a rule as they are; all 0 stay so."""
    total = jnp.sum(samples.weight)
    if samples.degree is not None or not float(total) > 0:
        return samples
    return samples.reweighted(samples.weight * (WHOLE / total))


def _exponential(
    pairs: AbstractPairBasis, samples: Samples, ridge: float, max_steps: int, begin: OnStep
) -> MaterialFit:
    found = []
    for k in range(samples.channels):  # channels do not touch: each is a fit of its own
        one = eqx.tree_at(lambda s: s.value, samples, samples.value[:, k : k + 1])
        start = positive_start(ExpBRDF, pairs, one)
        energy = jnp.sum(one.weight * (one.wi[:, 2] * one.wo[:, 2] * one.value[:, 0]) ** 2)
        objective = {"data": SampleMisfit(one, CosineWeighted()), "smooth": ridge * energy * Smoothness()}
        on_step = begin(f"channel {k + 1} of {samples.channels}")
        found.append(fit(start, objective, max_steps=max_steps, throw=False, on_step=on_step))
    model = ExpBRDF(pairs, jnp.concatenate([one.model.coefficients for one in found], axis=1))
    return MaterialFit(model, samples, tuple(found))


def _lobe(name: str, samples: Samples, max_steps: int, begin: OnStep) -> MaterialFit:
    colour = jnp.zeros(samples.channels)
    template = (
        CookTorrance(colour, colour, jnp.asarray(0.3))
        if name == "cook-torrance"
        else Lambert(colour) + GGX(colour, jnp.asarray(0.3))
    )
    objective = {"data": SampleMisfit(samples, CosineWeighted())}
    ahead = multi_start(initial_guesses(template, samples), objective, max_steps=1, throw=False).best.model
    found = fit(ahead, objective, max_steps=max_steps, throw=False, on_step=begin(name))
    return MaterialFit(found.model, samples, (found,))
