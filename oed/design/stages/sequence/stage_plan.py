"""Plans as sequences of stages: their value, their comparison, their Pareto front."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from oed.base import Array
from oed.design.stages.stage.knowledge import Prior
from oed.design.stages.stage.prediction import PlanStage

#: relative gain below which a change counts as none
GAIN = 1e-3
#: relative difference of values that drawn machines do not resolve
RESOLUTION = 3e-3
#: ratio of linearisation residuals below which a plan counts as more linear
MORE_LINEAR = 0.9


@dataclasses.dataclass(frozen=True, eq=False)
class StagePlan:
    """Stages in order.

    seconds   time of all stages
    value     value of the goal after the last stage; smaller is better
    accuracy  (K,) of each pose component, before any stage and after each
    """

    stages: tuple[PlanStage, ...]
    seconds: float
    value: float
    accuracy: tuple[Array, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the options, in order."""
        return tuple(stage.option.name for stage in self.stages)

    @property
    def price(self) -> float:
        """Cost in money, in addition to the time."""
        return float(sum(stage.option.price for stage in self.stages))

    @property
    def nonlinearity(self) -> float:
        """Largest linearisation residual of any reading, in units of its noise."""
        shares = [
            stage.linearisation_rms / stage.option.measurement.sigma(stage.series)
            for stage in self.stages
            if stage.linearisation_rms.size
        ]
        return max((float(share.max()) for share in shares), default=0.0)

    def posterior(self, start: Array) -> Prior:
        """Knowledge after the last stage; `start` (n, n) where there is none."""
        return self.stages[-1].posterior if self.stages else start


def is_better(plan: StagePlan, other: StagePlan) -> bool:
    """Whether a plan is more accurate, or as accurate with more linear readings.

    The second condition puts rough measurements before fine ones.
    """
    as_accurate = abs(plan.value - other.value) < RESOLUTION * other.value
    bends = plan.nonlinearity, other.nonlinearity
    if as_accurate and min(bends) < MORE_LINEAR * max(bends):
        return plan.nonlinearity < other.nonlinearity
    return plan.value < other.value * (1 - GAIN)


def best_plan(plans: Sequence[StagePlan]) -> StagePlan:
    """The most accurate plan; among those as accurate, the most linear one."""
    least = min(plan.value for plan in plans)
    as_accurate = [p for p in plans if p.value <= least * (1 + RESOLUTION)]
    return min(as_accurate, key=lambda plan: plan.nonlinearity)


def pareto_front(plans: Sequence[StagePlan]) -> list[StagePlan]:
    """Plans to which no other is both shorter and more accurate, shortest first."""
    front: list[StagePlan] = []
    for plan in sorted(plans, key=lambda p: (p.seconds, p.value)):
        if not front or plan.value < front[-1].value * (1 - 1e-9):
            front.append(plan)
    return front
