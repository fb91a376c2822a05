"""Functions of a direction, and of a pair of directions."""

from hshjax.bases._anisotropic import (
    AnisotropicHalfVectorBasis as AnisotropicHalfVectorBasis,
    anisotropic_order as anisotropic_order,
)
from hshjax.bases._base import AbstractBasis as AbstractBasis
from hshjax.bases._convert import (
    LowRank as LowRank,
    convert as convert,
    factorize as factorize,
    from_ordered as from_ordered,
    to_ordered as to_ordered,
)
from hshjax.bases._half_vector import HalfVectorBasis as HalfVectorBasis, total_order as total_order
from hshjax.bases._hsh import HSH as HSH
from hshjax.bases._isotropic import IsotropicBasis as IsotropicBasis
from hshjax.bases._pairs import (
    AbstractPairBasis as AbstractPairBasis,
    AbstractProductBasis as AbstractProductBasis,
    HelmholtzBasis as HelmholtzBasis,
    TensorBasis as TensorBasis,
    from_matrix as from_matrix,
    to_matrix as to_matrix,
)
from hshjax.bases._shr import SHR as SHR
from hshjax.bases._spherical import SphericalHarmonics as SphericalHarmonics
from hshjax.bases._warp import (
    AbstractWarp as AbstractWarp,
    IdentityWarp as IdentityWarp,
    LogWarp as LogWarp,
    RationalWarp as RationalWarp,
    RootWarp as RootWarp,
)
from hshjax.bases._zernike import Zernike as Zernike
