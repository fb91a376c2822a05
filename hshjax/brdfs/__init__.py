"""BRDFs: linear in a basis, analytic, sums of those."""

from hshjax.brdfs._base import AbstractBRDF as AbstractBRDF, ScaledBRDF as ScaledBRDF, SumBRDF as SumBRDF, bounded as bounded
