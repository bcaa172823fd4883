"""What virtual machines achieved on the way through all stages of a plan."""

from __future__ import annotations

from collections.abc import Sequence

from oed.result import PlanSection
from pkm_reports.page import missing, text
from pkm_reports.page.blocks import Block, Paragraph


def blocks(plan: PlanSection) -> list[Block]:
    """Their errors, intervals and lost candidates against the predicted ones."""
    stages = plan.stages
    ratios = missing.finite(r for stage in stages for r in stage.realised.values())
    if not ratios:
        return []
    count = plan.virtual_machines
    machines = text.count(count, "virtual machine") if count else "Virtual machines"
    low, high = text.number(min(ratios)), text.number(max(ratios))
    sentences = [
        f"{machines} went through all stages: their errors are {low} to {high} of the"
        " predicted ones.",
    ]
    coverage = missing.finite(stage.coverage for stage in stages)
    if coverage:
        interval = f"95{text.NO_BREAK}%"
        sentences.append(
            f"Their {interval} intervals contain {_range(coverage)} of the true"
            " parameters."
        )
    lost = missing.finite(stage.realised_lost for stage in stages)
    if lost:
        expected = sum(missing.finite(stage.lost for stage in stages))
        sentences.append(
            f"They lost {text.trimmed(sum(lost), 3)} candidates on average;"
            f" {text.trimmed(expected, 3)} were expected."
        )
    return [Paragraph(" ".join(sentences))]


def _range(shares: Sequence[float]) -> str:
    low, high = text.percent(min(shares)), text.percent(max(shares))
    return low if low == high else f"{low} to {high}"
