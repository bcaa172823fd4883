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
    with_effects = _difference(allowed.efficiency)
    alone = _difference(allowed.efficiency_without)
    sentence = (
        f"The plan allows for {text.count(allowed.groups, 'group')} of effects beside the"
        f" geometry, {_sizes(allowed.size)}. On a machine that has them at the sizes expected"
        f" of them, the plan for a machine without effects {with_effects} by"
        f" {design.criterion}; on a machine without effects, this plan {alone}."
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


def _difference(efficiency: float) -> str:
    """What a plan loses, or gains, against another one."""
    verb = "loses" if efficiency <= 1.0 else "gains"
    return f"{verb} {text.percent(abs(1.0 - efficiency))}"


def _sizes(factor: float) -> str:
    """The sizes that the plan is chosen for, as a factor on the expected ones."""
    if factor == 1.0:
        return "at the sizes expected of them"
    return (
        f"at {factor:.2g} times the sizes expected of them, the typical size on a healthy"
        " machine"
    )
