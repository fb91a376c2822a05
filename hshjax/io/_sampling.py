"""The rule of quadrature that samples a BRDF, where nobody says another."""

from hshjax._typing import PairFunction
from hshjax.brdfs._isotropy import is_isotropic
from hshjax.quadrature import ANISOTROPIC_DEGREE, PairRule, isotropic_pair_rule, pair_rule

DEGREE = 64
"""Of an isotropic BRDF."""


def sampling_rule(brdf: PairFunction, degree: int | None = None) -> PairRule:
    """An `isotropic_pair_rule` of an isotropic BRDF, a `pair_rule` of another; None: of degree 64, and 16."""
    if is_isotropic(brdf):
        return isotropic_pair_rule(DEGREE if degree is None else degree)
    return pair_rule(ANISOTROPIC_DEGREE if degree is None else degree)
