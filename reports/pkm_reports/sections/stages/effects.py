"""The plan that allows for effects, beside the plan for a machine without."""

from __future__ import annotations

from oed.result import PlanSection
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Paragraph, Table, number_columns, wide_column
from pkm_reports.sections import recording


def blocks(plan: PlanSection) -> list[Block]:
    """A sentence, and the accuracy that each plan promises and reaches."""
    allowed = plan.effects
    if allowed is None:
        return []
    columns = [
        wide_column("Error after compensation, rms"),
        *number_columns(
            "promised without effects", "that plan with effects", "this plan"
        ),
    ]
    rows = []
    for key, promised in allowed.promised.items():
        stem, unit = text.split_unit(key)
        values = (promised, allowed.without.accuracy[key], plan.accuracy[key])
        rows.append([stem, *(text.quantity(v, unit) for v in values)])
    caption = (
        "Predicted errors over the workspace: what the plan for a machine without effects"
        " promises, what its readings leave on a machine with them, and what this plan"
        " leaves there."
    )
    sentence = (
        f"The plan allows for {text.count(allowed.groups, 'group')} of effects beside the"
        " geometry, at the sizes expected of them. The plan for a machine without effects"
        f" would be {', then '.join(allowed.without.names)}."
    )
    table = Table(columns, rows, caption)
    return [Paragraph(sentence), table, *recording.blocks(allowed.recording)]
