"""How long the measurement takes, and what it costs."""

from __future__ import annotations

from oed.result import DesignSection, PlanSection, StudyResult
from pkm_reports import text
from pkm_reports.sections.stages import chapter
from pkm_reports.sections.stages.chapter import has_schedule


def minutes(result: StudyResult) -> str:
    """The time of the plan and what it holds; empty for readings that exist already."""
    plan, design = result.plan, result.design
    if plan is not None and has_schedule(plan):
        return _scheduled(plan)
    return "" if design is None else _designed(design)


def _scheduled(plan: PlanSection) -> str:
    phrase = f"{chapter.minutes(plan.cost)}{chapter.budget_share(plan)}"
    if not plan.price:
        return phrase
    return f"{phrase}, at a price of {text.trimmed(plan.price)}"


def _designed(design: DesignSection) -> str:
    if design.order is not None:
        time = text.quantity(design.order.minutes, "min", 2)
        return f"{time} with mounting and travel"
    if design.cost_min is None:
        return ""
    time = text.quantity(design.cost_min, "min", 2)
    return f"{time} with mounting, without travel"
