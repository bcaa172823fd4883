"""Parameters and effects estimated together, their mixture, tables and accuracy.

EffectReadings          readings with the covariates that effects are functions of
CorrectedEstimate       what that gives: its accuracy, and tables for a controller
CorrectedAccuracy       accuracy with parameters and effects compensated
MeasurementWithEffects  a measurement whose parameters include effects' coefficients
AnswerFits              how the answers of a diagnosis are fitted
AnswerMixture           what is known of the machine over all hypotheses
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.corrected.answer_fits import AnswerFits, AnswerMixture
    from oed.corrected.estimate import CorrectedAccuracy, CorrectedEstimate
    from oed.corrected.fit import EffectReadings, MeasurementWithEffects
else:
    __getattr__ = door(__name__)
