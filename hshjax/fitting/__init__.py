"""Fits in closed form: projections in named norms, and the errors of all orders at once."""

from hshjax.fitting._certificate import Certificate as Certificate
from hshjax.fitting._misfit import misfit as misfit, relative_error as relative_error
from hshjax.fitting._norms import NORMS as NORMS, Norm as Norm
from hshjax.fitting._outcome import Outcome as Outcome
from hshjax.fitting._project import project as project
from hshjax.fitting._result import Fit as Fit
from hshjax.fitting._sweep import IsotropicTable as IsotropicTable, order_sweep as order_sweep
