"""Functions of a direction, and of a pair of directions."""

from hshjax.bases._base import AbstractBasis as AbstractBasis
from hshjax.bases._hsh import HSH as HSH
from hshjax.bases._shr import SHR as SHR
from hshjax.bases._zernike import Zernike as Zernike
