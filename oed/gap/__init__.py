"""Diagnosis of the gap between model and machine: effects, places, closure, advice."""

from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem, prepare
from oed.gap.procedure import diagnose

__all__ = ["Diagnosis", "GapProblem", "diagnose", "prepare"]
