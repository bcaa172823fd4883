"""Diagnosis of the gap between model and machine: effects, places, closure, advice."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oed.base.lazy import attributes

if TYPE_CHECKING:
    from oed.gap.data.diagnosis import Diagnosis
    from oed.gap.data.problem import GapProblem, prepare
    from oed.gap.procedure import diagnose

__all__ = ["Diagnosis", "GapProblem", "diagnose", "prepare"]

# imported when first used: plans need the problem of a diagnosis, and no search for causes
__getattr__ = attributes(
    __name__,
    {
        "data.diagnosis": ("Diagnosis",),
        "data.problem": ("GapProblem", "prepare"),
        "procedure": ("diagnose",),
    },
)
