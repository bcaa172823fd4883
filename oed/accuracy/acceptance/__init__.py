"""Acceptance: few poses that confirm a promised accuracy, and their judgement."""

from oed.accuracy.acceptance.judge import ComponentVerdict, judge
from oed.accuracy.acceptance.plan import (
    AcceptancePlan,
    Promise,
    plan_acceptance,
    state_limits,
)
from oed.accuracy.acceptance.positioning import Positioning, positioning

__all__ = [
    "AcceptancePlan",
    "ComponentVerdict",
    "Positioning",
    "Promise",
    "judge",
    "plan_acceptance",
    "positioning",
    "state_limits",
]
