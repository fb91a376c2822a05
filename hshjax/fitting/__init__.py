"""Fits in closed form: projections in named norms, and the errors of all orders at once. Fits by gradients: `fit`."""

from hshjax.fitting._batch import project_all as project_all
from hshjax.fitting._certificate import Certificate as Certificate
from hshjax.fitting._compact import (
    CompactFit as CompactFit,
    fit_compact as fit_compact,
    fit_compact_all as fit_compact_all,
    half_vector_samples as half_vector_samples,
)
from hshjax.fitting._compact_posterior import (
    CompactPosterior as CompactPosterior,
    Suggestion as Suggestion,
    Trial as Trial,
)
from hshjax.fitting._compare import Comparison as Comparison, compare as compare
from hshjax.fitting._coordinator import coordinator as coordinator
from hshjax.fitting._fit import fit as fit
from hshjax.fitting._folder import FolderFit as FolderFit, FolderItem as FolderItem, fit_folder as fit_folder
from hshjax.fitting._guess import initial_guesses as initial_guesses
from hshjax.fitting._infer_compact import infer_compact as infer_compact
from hshjax.fitting._jaxopt import Jaxopt as Jaxopt
from hshjax.fitting._levenberg_marquardt import LevenbergMarquardt as LevenbergMarquardt
from hshjax.fitting._map_over_mesh import map_over_mesh as map_over_mesh
from hshjax.fitting._mappings import (
    AbstractMapping as AbstractMapping,
    CosineWeighted as CosineWeighted,
    CubeRoot as CubeRoot,
    Identity as Identity,
    LogCosineWeighted as LogCosineWeighted,
    LogRelative as LogRelative,
)
from hshjax.fitting._material import (
    MaterialFit as MaterialFit,
    MaterialModel as MaterialModel,
    fit_material as fit_material,
)
from hshjax.fitting._mesh import device_mesh as device_mesh
from hshjax.fitting._misfit import misfit as misfit, relative_error as relative_error
from hshjax.fitting._multi_start import multi_start as multi_start
from hshjax.fitting._norms import NORMS as NORMS, Norm as Norm
from hshjax.fitting._outcome import Outcome as Outcome
from hshjax.fitting._positive_start import positive_start as positive_start
from hshjax.fitting._processes import ProcessError as ProcessError
from hshjax.fitting._project import project as project
from hshjax.fitting._project_blocks import project_blocks as project_blocks
from hshjax.fitting._project_by_moments import project_by_moments as project_by_moments
from hshjax.fitting._project_pixels import PixelFit as PixelFit, project_pixels as project_pixels
from hshjax.fitting._result import Fit as Fit, IterativeFit as IterativeFit, MultiStart as MultiStart
from hshjax.fitting._robust import (
    AbstractRobustLoss as AbstractRobustLoss,
    Cauchy as Cauchy,
    GemanMcClure as GemanMcClure,
    Huber as Huber,
)
from hshjax.fitting._sample_blocks import BlockError as BlockError, SampleBlocks as SampleBlocks
from hshjax.fitting._sparsity_path import (
    largest_sparsity_weight as largest_sparsity_weight,
    sparsity_path as sparsity_path,
)
from hshjax.fitting._sweep import IsotropicTable as IsotropicTable, order_sweep as order_sweep
from hshjax.fitting._tabulate import TableError as TableError, Tabulated as Tabulated, tabulate as tabulate
from hshjax.fitting._terms import (
    AbstractTerm as AbstractTerm,
    EnergyConservation as EnergyConservation,
    NonNegativity as NonNegativity,
    Of as Of,
    Prior as Prior,
    Reciprocity as Reciprocity,
    SampleMisfit as SampleMisfit,
    Smoothness as Smoothness,
    Sparsity as Sparsity,
)
from hshjax.fitting._tiles import TileError as TileError
from hshjax.fitting._to_series import to_series as to_series
