"""Whether a BRDF is isotropic, as far as a few pairs of directions tell."""

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import PairFunction
from hshjax.brdfs._half_vector_table import HalfVectorTable
from hshjax.brdfs._rgl_table import RGLTable
from hshjax.geometry import from_half_difference

TURN = 1.0
"""Of both directions about the normal [radians]: no symmetry of a weave or a brush."""

UNCHANGED = 1e-4
"""Relative difference that counts as none: functions may work in float32."""


def is_isotropic(brdf: PairFunction) -> bool:
    """Whether ρ stays what it is where both directions turn about the normal: by its type, or at some pairs in and off
    highlights, in float64 whatever jax's configuration (in float32 a half vector 1e-4 from the normal is not known to
    the digits that a narrow lobe needs).
    """
    if isinstance(brdf, HalfVectorTable) or (isinstance(brdf, RGLTable) and brdf.phi_i is None):
        return True
    half, difference, azimuth = np.meshgrid([1e-4, 0.01, 0.1, 0.4, 0.8], [0.2, 0.7], [0.3, 1.3, 2.5], indexing="ij")
    cos, sin = np.cos(TURN), np.sin(TURN)
    with jax.enable_x64(True):
        wi, wo = from_half_difference(*(jnp.asarray(axis.ravel()) for axis in (half, difference, azimuth)))
        turn = jnp.asarray([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        here, there = (np.asarray(brdf(a, b)) for a, b in ((wi, wo), (wi @ turn, wo @ turn)))
    with np.errstate(invalid="ignore"):  # what is not finite tells nothing, and is for others to refuse
        changed = np.abs(here - there) > UNCHANGED * (np.abs(here) + np.abs(there))
    return not bool(np.any(changed))
