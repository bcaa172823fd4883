"""Diagnosis of the gap between model and machine: effects, places, closure, advice.

ActingEffectForm      a form of an effect that acts
AnswerContent         effects with their constants: an answer of a diagnosis
DOWN                  the direction of gravity
Diagnosis             the diagnosis of a set of readings
GapProblem            readings, Jacobian and states of a diagnosis
Metric                inner products of readings, parameters marginal
Run                   a run that could be taken: poses in order, under one condition
RunsWanted            what runs are to be chosen for
SecondVisit           runs of a second visit, and what they are expected to decide
Signature             an effect's columns in the readings
UNSEEN_SHARE          prior probability that something acts that is too small to be seen
assemble              the problem of readings, or of a plan, at given parameters
choose_runs           the runs that separate effects best
detect                what planned readings could find
diagnose              diagnoses a problem
exact_readings        noise-free readings of a machine with effects
explain_residuals     diagnoses a problem, without places and closure
phase_along_runs      phase of each pose along its run
prepare               the problem of readings, at parameters that are fitted to them
propose_second_visit  the second visit that a diagnosis calls for
settle                readings linearised where effects act
states                a state a series, over all its poses
untestable            why readings cannot test an effect
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.gap.before.choose import Run, RunsWanted, choose_runs
    from oed.gap.before.detect import detect
    from oed.gap.before.second_visit import SecondVisit, propose_second_visit
    from oed.gap.cause.search import UNSEEN_SHARE
    from oed.gap.data.diagnosis import AnswerContent, Diagnosis
    from oed.gap.data.linearisation import ActingEffectForm, settle
    from oed.gap.data.problem import (
        GapProblem,
        Metric,
        Signature,
        assemble,
        exact_readings,
        prepare,
        untestable,
    )
    from oed.gap.data.state import DOWN, phase_along_runs, states
    from oed.gap.procedure import diagnose, explain_residuals
else:
    # imported when first used: plans need the problem of a diagnosis, and no search for causes
    __getattr__ = door(__name__)
