"""Times, budgets and goals of a plan in words."""

from __future__ import annotations

from oed.result import PlanSection
from pkm_reports import text


def has_schedule(plan: PlanSection | None) -> bool:
    """Whether a plan has times of its stages."""
    return plan is not None and any(s.begin_min is not None for s in plan.stages)


def is_missed(plan: PlanSection) -> bool:
    """Whether there is a goal that the plan does not reach."""
    return bool(plan.goal) and not plan.reached


def minutes(value: float | None) -> str:
    """33 min."""
    return text.quantity(value, "min")


def budget_phrase(plan: PlanSection) -> str:
    """` within 120 min`, or nothing where there is no budget."""
    return "" if plan.budget_min is None else f" within {_budget(plan.budget_min)}"


def budget_share(plan: PlanSection) -> str:
    """` of a budget of 120 min`, or nothing where there is none."""
    if plan.budget_min is None:
        return ""
    return f" of a budget of {_budget(plan.budget_min)}"


def _budget(minutes: float) -> str:
    return text.append_unit(text.trimmed(minutes), "min")
