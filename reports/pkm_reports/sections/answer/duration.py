"""How long the measurement takes, and what it costs."""

from __future__ import annotations

from oed.result import DesignSection, PlanSection, StudyResult
from pkm_reports import text
from pkm_reports.blocks import Block, Paragraph
from pkm_reports.sections.stages import wording
from pkm_reports.sections.stages.chapter import has_schedule


def title(result: StudyResult) -> str:
    """The question that the part answers."""
    return "How long it takes"


def blocks(result: StudyResult) -> list[Block]:
    """The time of the plan in a sentence; nothing for readings that exist already."""
    plan, design = result.plan, result.design
    if plan is not None and has_schedule(plan):
        return [Paragraph(_scheduled(plan))]
    if design is None:
        return []
    sentence = _designed(design)
    return [Paragraph(sentence)] if sentence else []


def _scheduled(plan: PlanSection) -> str:
    phrase = f"{wording.minutes(plan.cost)}{wording.budget_share(plan)}"
    phrase += f" for {text.count(len(plan.stages), 'stage')}"
    if plan.price:
        phrase += f", at a price of {text.trimmed(plan.price)}"
    return f"{phrase}."


def _designed(design: DesignSection) -> str:
    if design.order is not None:
        minutes = text.quantity(design.order.minutes, "min", 2)
        return f"{minutes}: mounting, travel between the readings, and the readings."
    if design.cost_min is None:
        return ""
    minutes = text.quantity(design.cost_min, "min", 2)
    return f"{minutes}: mounting and the readings, without travel between them."
