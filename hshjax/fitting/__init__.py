"""Fits: in closed form, and (later) by gradients."""

from hshjax.fitting._norms import NORMS as NORMS, Norm as Norm
from hshjax.fitting._sweep import IsotropicTable as IsotropicTable, order_sweep as order_sweep
