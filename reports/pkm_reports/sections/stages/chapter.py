"""Chapter: which measurement at which stage, and why this plan.

Only plans with a schedule have it: their stages have times (`begin_min`).
"""

from __future__ import annotations

from typing import Final

from oed.result import PlanSection, StudyResult
from pkm_reports.figures import pareto, stage_accuracy, timeline
from pkm_reports.page.blocks import Block, Chapter, Picture
from pkm_reports.sections.stages import (
    alternatives,
    captions,
    effects,
    sequences,
    tables,
    verdict,
    virtual_machines,
)


def has_schedule(plan: PlanSection | None) -> bool:
    """Whether a plan has times of its stages."""
    return plan is not None and any(s.begin_min is not None for s in plan.stages)


def blocks(result: StudyResult) -> list[Block]:
    """Verdict, stages, accuracy and time, alternatives, sequences of the study."""
    plan = result.plan
    if plan is None or not has_schedule(plan):
        return []
    return [
        *verdict.blocks(plan),
        tables.schedule(plan),
        tables.improvements(plan, result.machine),
        tables.accuracies(plan),
        *effects.blocks(plan),
        *virtual_machines.blocks(plan),
        *_pictures(plan),
        *alternatives.blocks(plan),
        *sequences.blocks(plan),
    ]


def _pictures(plan: PlanSection) -> list[Block]:
    return [
        Picture(
            "plan_stages", lambda: stage_accuracy.draw(plan), captions.accuracy(plan)
        ),
        Picture("plan_timeline", lambda: timeline.draw(plan), captions.schedule(plan)),
        Picture("plan_front", lambda: pareto.draw(plan), captions.front(plan)),
    ]


CHAPTER: Final = Chapter("stages", "Which measurement at which stage", blocks)
