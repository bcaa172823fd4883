"""Corrected model: parameters and effects estimated together, and what they predict."""

from oed.correction.effect_measurement import MeasurementWithEffects
from oed.correction.fit import CorrectedEstimate, EffectReadings, estimate_with_effects
from oed.correction.senses import TurnedRuns, find_turned_runs
from oed.correction.tables import StateTable, TabledEffects, tabled_effects
from oed.correction.unmodelled import ExpectedEffect, expected_effects
from oed.correction.workspace import CorrectedAccuracy, predict_corrected

__all__ = [
    "CorrectedAccuracy",
    "CorrectedEstimate",
    "EffectReadings",
    "ExpectedEffect",
    "MeasurementWithEffects",
    "StateTable",
    "TabledEffects",
    "TurnedRuns",
    "estimate_with_effects",
    "expected_effects",
    "find_turned_runs",
    "predict_corrected",
    "tabled_effects",
]
