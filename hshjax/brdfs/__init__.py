"""BRDFs: linear in a basis, analytic, sums of those."""

from hshjax._fields import bounded as bounded
from hshjax.brdfs._angle_table import AngleTable as AngleTable
from hshjax.brdfs._base import AbstractBRDF as AbstractBRDF, ScaledBRDF as ScaledBRDF, SumBRDF as SumBRDF
from hshjax.brdfs._diffuse import Lambert as Lambert, OrenNayar as OrenNayar
from hshjax.brdfs._fresnel import (
    AbstractFresnel as AbstractFresnel,
    ConductorFresnel as ConductorFresnel,
    ConstantFresnel as ConstantFresnel,
    DielectricFresnel as DielectricFresnel,
    SchlickFresnel as SchlickFresnel,
)
from hshjax.brdfs._half_vector_table import HalfVectorTable as HalfVectorTable
from hshjax.brdfs._linear import LinearBRDF as LinearBRDF
from hshjax.brdfs._lobes import BlinnPhong as BlinnPhong, Ward as Ward
from hshjax.brdfs._log_linear import LogLinearBRDF as LogLinearBRDF, contrasts as contrasts
from hshjax.brdfs._microfacet import ABC as ABC, GGX as GGX, CookTorrance as CookTorrance
from hshjax.brdfs._positive import (
    AbstractPositiveBRDF as AbstractPositiveBRDF,
    ExpBRDF as ExpBRDF,
    SoftplusBRDF as SoftplusBRDF,
    SquaredBRDF as SquaredBRDF,
)
from hshjax.brdfs._rgl_table import RGLTable as RGLTable
from hshjax.brdfs._tabulated import TabulatedBRDF as TabulatedBRDF
