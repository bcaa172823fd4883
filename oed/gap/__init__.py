"""Diagnosis of the gap between model and machine: effects, places, closure, advice."""

from typing import TYPE_CHECKING

from oed.base.lazy import door

if TYPE_CHECKING:
    from oed.gap.data.diagnosis import Diagnosis
    from oed.gap.data.problem import GapProblem, prepare
    from oed.gap.procedure import diagnose
else:
    # imported when first used: plans need the problem of a diagnosis, and no search for causes
    __getattr__ = door(__name__)
