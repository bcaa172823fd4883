"""Parameters and effects estimated together, their mixture, tables and accuracy.

EffectReadings          readings with the covariates that effects are functions of
CorrectedEstimate       what that gives
MeasurementWithEffects  a measurement whose parameters include effects' coefficients
ChosenForm              the form of an effect that suits the readings best
AnswerFits              how the answers of a diagnosis are fitted
AnswerMixture           what is known of the machine over all hypotheses
TurnedRuns              runs that were driven the other way than their rows say
find_turned_runs        these, where readings can tell
CorrectedAccuracy       accuracy with parameters and effects compensated
predict_corrected       predicts it over the workspace
StateTable              joint corrections of an effect over a state
TabledEffects           tables of an estimate, and effects without one
tabled_effects          the tables at commands
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.corrected.answer_fits import AnswerFits, AnswerMixture
    from oed.corrected.fit import (
        CorrectedEstimate,
        EffectReadings,
        MeasurementWithEffects,
    )
    from oed.corrected.forms import ChosenForm
    from oed.corrected.senses import TurnedRuns, find_turned_runs
    from oed.corrected.tables import StateTable, TabledEffects, tabled_effects
    from oed.corrected.workspace import CorrectedAccuracy, predict_corrected
else:
    __getattr__ = door(__name__)
