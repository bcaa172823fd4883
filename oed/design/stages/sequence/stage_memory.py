"""Stages that a search has predicted: equal ones are computed once.

Refined and verified plans draw the same machines for a stage at each use. A stage after
the same stages, with the same readings, is therefore the same. Plans on trial differ in
one or two stages, and searches with fewer measurements meet earlier plans again.
"""

from __future__ import annotations

import numpy as np

from oed.base import Index
from oed.design.stages.option import Option
from oed.design.stages.sequence.stage_plan import StagePlan
from oed.design.stages.stage.prediction import PlanStage

#: identities of the stage before and of the option, machines drawn, readings
Key = tuple[int, int, int, bytes]


class StageMemory:
    """Stages by the stage before, the option, its readings and the machines drawn.

    It holds for one machine before the plan and one set of streams.
    """

    def __init__(self) -> None:
        self._stages: dict[Key, tuple[PlanStage | None, PlanStage]] = {}

    def recall(
        self, plan: StagePlan, option: Option, chosen: Index, draws: int
    ) -> PlanStage | None:
        """The stage after `plan` with the chosen candidates; None where it is new.

        plan   stages that this memory holds
        draws  number of machines drawn
        """
        entry = self._stages.get(_key(plan, option, chosen, draws))
        return None if entry is None else entry[1]

    def store(self, plan: StagePlan, stage: PlanStage, draws: int) -> None:
        """Remember the stage after `plan`."""
        before = plan.stages[-1] if plan.stages else None
        # with the stage before, so that its identity stays its own
        key = _key(plan, stage.option, stage.chosen, draws)
        self._stages[key] = before, stage


def _key(plan: StagePlan, option: Option, chosen: Index, draws: int) -> Key:
    before = plan.stages[-1] if plan.stages else None
    return id(before), id(option), draws, np.sort(chosen).tobytes()
