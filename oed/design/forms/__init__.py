"""Forms of criteria: information functions with the gradients and lines that bound plans.

determinant  D, Ds, O1
variance     A, c, I, G
eigenvalues  phi_p, O5; E, kappa, O2, O3, O4
compound     weighted geometric means of the others
"""

from oed.design.forms.compound import Compound, compound
from oed.design.forms.determinant import Determinant
from oed.design.forms.eigenvalues import ExtremeEigenvalues, PowerMean
from oed.design.forms.protocol import Criterion, Support
from oed.design.forms.variance import LargestVariance, Variance

__all__ = [
    "Compound",
    "Criterion",
    "Determinant",
    "ExtremeEigenvalues",
    "LargestVariance",
    "PowerMean",
    "Support",
    "Variance",
    "compound",
]
