"""Plans that were considered and not taken, and why."""

from __future__ import annotations

from oed.result import PlanSection
from pkm_reports.figures import pareto
from pkm_reports.page import text
from pkm_reports.page.blocks import (
    Block,
    Table,
    headed_list,
    number_columns,
    wide_column,
)
from pkm_reports.sections.stages import wording


def blocks(plan: PlanSection) -> list[Block]:
    """A table of plans, and the alternatives that are stored as sentences."""
    described = [entry for entry in plan.alternatives if isinstance(entry, str)]
    sentences = headed_list("Alternatives considered:", text.sentences(described))
    others = pareto.alternatives(plan)
    if not others:
        return sentences
    columns = [
        wide_column("Plan (readings or runs)"),
        *number_columns("Minutes", "Value"),
        wide_column("Why not"),
    ]
    rows = [
        [
            wording.measurements(other),
            text.number(other.minutes),
            text.number(other.value),
            text.sentence(other.why) or text.MISSING,
        ]
        for other in others
    ]
    value = (
        "error of the worst component over its wanted accuracy"
        if plan.goal
        else "remaining share of the error"
    )
    cost, of_plan = wording.minutes(plan.cost), text.number(plan.value)
    caption = (
        f"Plans that were considered and not taken. Value: {value}, smaller is better."
        f" The plan itself: {cost}, value {of_plan}."
    )
    return [Table(columns, rows, caption), *sentences]
