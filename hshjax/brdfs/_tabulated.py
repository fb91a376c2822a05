"""BRDFs that interpolate a measured table."""

import equinox as eqx

from hshjax.brdfs._base import AbstractBRDF
from hshjax.quadrature import PairRule
from hshjax.samples import Samples


class TabulatedBRDF(AbstractBRDF):
    """A measured material: what a reader of a BRDF database returns.

    - `description`: the file's own words about the material.
    - `channel_names`: one name per channel, in the order of the channels.

    The values are the measured ones: not exactly reciprocal, and negative where the measurement is.
    """

    description: eqx.AbstractVar[str]
    channel_names: eqx.AbstractVar[tuple[str, ...]]

    def samples(self, rule: PairRule) -> Samples:
        """The BRDF at the nodes of a pair rule, weighted by solid angle."""
        return Samples.from_function(self, rule)
