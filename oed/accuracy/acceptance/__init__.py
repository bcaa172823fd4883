"""Acceptance: few poses that confirm a promised accuracy, and their judgement."""

from oed.accuracy.acceptance.judge import judge
from oed.accuracy.acceptance.plan import (
    AcceptancePlan,
    Promise,
    plan_acceptance,
    state_limits,
)
from oed.accuracy.acceptance.positioning import positioning

__all__ = [
    "AcceptancePlan",
    "Promise",
    "judge",
    "plan_acceptance",
    "positioning",
    "state_limits",
]
