"""The plan that allows for effects, beside the plan for a machine without."""

from __future__ import annotations

from oed.result import DesignSection
from pkm_reports.page import text
from pkm_reports.page.blocks import Block, Paragraph, Table, number_columns, wide_column
from pkm_reports.sections import recording


def blocks(design: DesignSection) -> list[Block]:
    """A sentence, and the accuracy of both plans."""
    allowed = design.effects
    if allowed is None:
        return []
    lost = text.percent(1.0 - allowed.efficiency)
    alone = text.percent(1.0 - allowed.efficiency_without)
    sentence = (
        f"The plan allows for {text.count(allowed.groups, 'group')} of effects beside the"
        " geometry, at the sizes expected of them. On a machine that has them, the plan"
        f" for a machine without effects loses {lost} by {design.criterion}; on a machine"
        f" without effects, this plan loses {alone}."
    )
    columns = [
        wide_column("Error after compensation, rms"),
        *number_columns("before any reading", "this plan", "plan without effects"),
    ]
    rows = []
    for key, value in allowed.accuracy.items():
        stem, unit = text.split_unit(key)
        values = (allowed.before[key], value, allowed.accuracy_without[key])
        rows.append([stem, *(text.quantity(v, unit) for v in values)])
    caption = (
        "Predicted errors over the workspace of a machine with these effects, once all that"
        " is known is corrected."
    )
    table = Table(columns, rows, caption)
    return [Paragraph(sentence), table, *recording.blocks(allowed.recording)]
