"""Many materials on the same directions: one factorisation for all of them."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hshjax.bases import AbstractPairBasis
from hshjax.brdfs._linear import LinearBRDF
from hshjax.fitting._outcome import Outcome
from hshjax.fitting._project import project
from hshjax.fitting._result import Fit
from hshjax.samples import Samples


def project_all(basis: AbstractPairBasis, samples: Sequence[Samples], **settings) -> list[Fit[LinearBRDF]]:
    """`project` of every material, at little more than the cost of one: the design matrix is factorised once.

    - `samples`: one for each material, of any channels, all at the same directions with the same weights.
    - `settings`: see `project`. Of these `reciprocity` concerns all materials together and stays off.

    **Raises:** what `project` does; ValueError for materials that differ in a direction or a weight, no material, or a
    request for `reciprocity`; TypeError for what is no sequence of samples.
    """
    if not isinstance(samples, Sequence) or not all(isinstance(one, Samples) for one in samples):
        what = type(samples).__name__
        raise TypeError(f"project_all needs a list of Samples, one for each material, got {what}")
    if settings.pop("reciprocity", None):
        raise ValueError("project_all does not measure reciprocity: hshjax.reciprocity_error does, for one material")
    if not samples:
        raise ValueError("project_all needs the samples of at least one material, got none")
    first = samples[0]
    for k, other in enumerate(samples):
        for part in ("wi", "wo", "weight"):
            if getattr(other, part) is not getattr(first, part) and not np.array_equal(
                getattr(other, part), getattr(first, part)
            ):
                raise ValueError(f"material {k} differs from material 0 in {part}: fit it by itself, with `project`")
        if (other.degree, other.isotropic) != (first.degree, first.isotropic):
            raise ValueError(f"material {k} differs from material 0 in its rule: fit it by itself, with `project`")
    value = jnp.concatenate([one.value for one in samples], axis=1)
    together = project(basis, eqx.tree_at(lambda s: s.value, first, value), reciprocity=False, **settings)
    ends = np.cumsum([0, *(one.channels for one in samples)])
    return [_part(together, slice(*ends[k : k + 2])) for k in range(len(samples))]


def _part(fit: Fit[LinearBRDF], channels: slice) -> Fit[LinearBRDF]:
    """The fit of some of the channels."""
    if fit.certificate is not None:
        certificate = fit.certificate.part(channels)
        result = Outcome.converged if certificate.holds else Outcome.uncertified
        fit = eqx.tree_at(lambda f: (f.certificate, f.result), fit, (certificate, result))
    return eqx.tree_at(
        lambda f: (f.model.coefficients, f.residual, f.relative, f.noise),
        fit,
        (
            fit.model.coefficients[:, channels],
            fit.residual[channels],
            fit.relative[channels],
            None if fit.noise is None else fit.noise[channels],
        ),
        is_leaf=lambda x: x is None,
    )
