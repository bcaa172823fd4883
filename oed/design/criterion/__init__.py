"""Criteria as information functions: what a plan is judged by, with the slopes and
supporting lines that bound it.

    determinant  D, Ds, O1          variance  A, c, I          worst     G
    power        phi_p, O5          spectrum  E, kappa, O2..O4  compound  products of powers

`named` finds them by the names of the catalogue (`oed.criteria.CATALOGUE`).
"""

from oed.design.criterion.catalogue import named
from oed.design.criterion.compound import Compound
from oed.design.criterion.determinant import Determinant
from oed.design.criterion.power import Power
from oed.design.criterion.protocol import Criterion, Support
from oed.design.criterion.spectrum import Spectrum
from oed.design.criterion.variance import Variance
from oed.design.criterion.worst import Worst

__all__ = [
    "Compound",
    "Criterion",
    "Determinant",
    "Power",
    "Spectrum",
    "Support",
    "Variance",
    "Worst",
    "named",
]
