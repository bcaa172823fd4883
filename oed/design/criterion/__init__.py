"""Criteria as information functions, with the slopes and lines that bound plans.

    determinant  D, Ds, O1
    variance     A, c, I
    largest      G
    power        phi_p, O5
    spectrum     E, kappa, O2, O3, O4
    compound     weighted geometric means of the others

`named` finds a criterion by its name in the catalogue (`oed.design.criteria.CATALOGUE`).
"""

from oed.design.criterion.catalogue import named
from oed.design.criterion.compound import Compound
from oed.design.criterion.determinant import Determinant
from oed.design.criterion.largest import LargestVariance
from oed.design.criterion.power import PowerMean
from oed.design.criterion.protocol import Criterion, Support
from oed.design.criterion.spectrum import ExtremeEigenvalues
from oed.design.criterion.variance import Variance

__all__ = [
    "Compound",
    "Criterion",
    "Determinant",
    "ExtremeEigenvalues",
    "LargestVariance",
    "PowerMean",
    "Support",
    "Variance",
    "named",
]
