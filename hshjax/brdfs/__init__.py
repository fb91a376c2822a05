"""BRDFs: linear in a basis, analytic, sums of those."""

from hshjax.brdfs._base import AbstractBRDF as AbstractBRDF, ScaledBRDF as ScaledBRDF, SumBRDF as SumBRDF, bounded as bounded
from hshjax.brdfs._rgl_table import RGLTable as RGLTable
from hshjax.brdfs._tabulated import TabulatedBRDF as TabulatedBRDF
