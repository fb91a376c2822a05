"""Functions of a direction, and of a pair of directions."""

from hshjax.bases._base import AbstractBasis as AbstractBasis
from hshjax.bases._convert import (
    LowRank as LowRank,
    convert as convert,
    factorize as factorize,
    from_ordered as from_ordered,
    to_ordered as to_ordered,
)
from hshjax.bases._hsh import HSH as HSH
from hshjax.bases._isotropic import IsotropicBasis as IsotropicBasis
from hshjax.bases._pairs import (
    AbstractPairBasis as AbstractPairBasis,
    HelmholtzBasis as HelmholtzBasis,
    TensorBasis as TensorBasis,
    from_matrix as from_matrix,
    to_matrix as to_matrix,
)
from hshjax.bases._shr import SHR as SHR
from hshjax.bases._spherical import SphericalHarmonics as SphericalHarmonics
from hshjax.bases._zernike import Zernike as Zernike
