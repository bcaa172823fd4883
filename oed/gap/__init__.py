"""Diagnosis of the gap between model and machine: effects, places, closure, advice.

DOWN            the direction of gravity
AnswerContent   effects with their constants: an answer of a diagnosis
Diagnosis       the diagnosis of a set of readings
GapProblem      readings, slopes and states of a diagnosis
Metric          inner products of readings, parameters marginal
assemble        the problem of readings, or of a plan, at given parameters
diagnose        diagnoses a problem
exact_readings  noise-free readings of a machine with effects
prepare         the problem of readings, at parameters that are fitted to them
signature       what an effect does to readings
states          a state a series, over all its poses
untestable      why readings cannot test an effect
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.gap.data.diagnosis import AnswerContent, Diagnosis
    from oed.gap.data.metric import Metric
    from oed.gap.data.problem import GapProblem, assemble, prepare
    from oed.gap.data.signature import exact_readings, signature, untestable
    from oed.gap.data.state import DOWN, states
    from oed.gap.procedure import diagnose
else:
    # imported when first used: plans need the problem of a diagnosis, and no search for causes
    __getattr__ = door(__name__)
