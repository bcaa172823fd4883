"""Corrected model: parameters and effects estimated together, and what they predict."""

from oed.compensate.effects.effect_measurement import MeasurementWithEffects
from oed.compensate.effects.fit import (
    CorrectedEstimate,
    EffectReadings,
    estimate_with_effects,
)
from oed.compensate.effects.senses import TurnedRuns, find_turned_runs
from oed.compensate.effects.tables import StateTable, TabledEffects, tabled_effects
from oed.compensate.effects.unmodelled import ExpectedEffect, expected_effects
from oed.compensate.effects.workspace import CorrectedAccuracy, predict_corrected

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
