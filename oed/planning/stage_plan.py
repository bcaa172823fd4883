"""Plans as sequences of stages: their value, their comparison, their Pareto front.

Stages that a search has predicted are computed once. Refined and verified plans draw
the same machines for a stage at each use. A stage after the same stages, with the same
readings, is therefore the same. Plans on trial differ in one or two stages, and
searches with fewer measurements meet earlier plans again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from oed.base import Array, Index
from oed.linear_algebra import symmetric_inverse
from oed.planning import travel
from oed.planning.goal import Goal
from oed.planning.knowledge import Prior
from oed.planning.option import Option
from oed.planning.prediction import PlanStage, predict_stage, profiled_information

# Random streams of a plan search: one for each question that drawn machines answer.
#
# Most streams start anew at each use (common random numbers). Two plans then differ by
# their readings, and not by the machines that are drawn for them.

# Seeds of the streams that all searches share. They mean nothing; other ones would change
# the last digits of published plans.
CAPTURE_SEED = 0
REFINEMENT_SEED = 17
VERIFICATION_SEED = 18
BOUND_SEED = 19


@dataclasses.dataclass(frozen=True, eq=False)
class PlanStreams:
    """Generators which the caller of a plan search provides.

    first_look    machines of partial plans; drawn on and on during the search
    bound         machines for the bound over all plans; drawn once
    capture       () starts the stream that estimates how often runs are captured
    refinement    (k) starts the stream of stage k while plans are refined
    verification  (k) starts the stream of stage k by which refined plans are judged
    """

    first_look: np.random.Generator
    bound: np.random.Generator
    capture: Callable[[], np.random.Generator]
    refinement: Callable[[int], np.random.Generator]
    verification: Callable[[int], np.random.Generator]

    @classmethod
    def seeded(cls, seed: int | Sequence[int]) -> PlanStreams:
        """The streams of one search; the seed is for the first look at partial plans.

        The others do not follow it. All searches of a study (other budgets, other stages,
        without a measurement) then judge their plans by the same drawn machines, and so
        do studies with other seeds: their values can be compared.
        """
        return cls(
            first_look=np.random.default_rng(seed),
            bound=np.random.default_rng(BOUND_SEED),
            capture=lambda: np.random.default_rng(CAPTURE_SEED),
            refinement=lambda stage: np.random.default_rng([REFINEMENT_SEED, stage]),
            verification=lambda k: np.random.default_rng([VERIFICATION_SEED, k]),
        )


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


#: relative gain below which a change counts as none
MIN_RELATIVE_GAIN = 1e-3
#: relative difference of values that drawn machines do not resolve
VALUE_RESOLUTION = 3e-3
#: ratio of linearisation residuals below which a plan counts as more linear
MORE_LINEAR_SHARE = 0.9


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
    as_accurate = abs(plan.value - other.value) < VALUE_RESOLUTION * other.value
    bends = plan.nonlinearity, other.nonlinearity
    if as_accurate and min(bends) < MORE_LINEAR_SHARE * max(bends):
        return plan.nonlinearity < other.nonlinearity
    return plan.value < other.value * (1 - MIN_RELATIVE_GAIN)


def best_plan(plans: Sequence[StagePlan]) -> StagePlan:
    """The most accurate plan; among those as accurate, the most linear one."""
    least = min(plan.value for plan in plans)
    as_accurate = [p for p in plans if p.value <= least * (1 + VALUE_RESOLUTION)]
    return min(as_accurate, key=lambda plan: plan.nonlinearity)


def pareto_front(plans: Sequence[StagePlan]) -> list[StagePlan]:
    """Plans to which no other is both shorter and more accurate, shortest first."""
    front: list[StagePlan] = []
    for plan in sorted(plans, key=lambda p: (p.seconds, p.value)):
        if not front or plan.value < front[-1].value * (1 - 1e-9):
            front.append(plan)
    return front


def predict_plan(
    readings: Sequence[tuple[Option, Index]],
    goal: Goal,
    start: Array,
    streams: PlanStreams,
    stage_generator: Callable[[int], np.random.Generator],
) -> StagePlan:
    """A plan of some candidates of each option, one option after the other.

    start            (n, n) covariance of the machine before
    stage_generator  random numbers about one stage, counted from 0
    """
    prior: Prior = start
    stages: list[PlanStage] = []
    for k, (option, chosen) in enumerate(readings):
        probability = travel.capture_probability(option, prior, streams.capture())
        rng = stage_generator(k)
        stages.append(predict_stage(option, chosen, prior, probability, rng))
        prior = stages[-1].posterior
    covariances = [start, *(stage.covariance for stage in stages)]
    return StagePlan(
        stages=tuple(stages),
        seconds=sum(stage.seconds for stage in stages),
        value=goal.value(covariances[-1]),
        accuracy=tuple(goal.accuracy(c) for c in covariances),
    )


def covariance_of_all(options: Sequence[Option], start: Array) -> Array:
    """Covariance (n, n) after all candidates of all options, none of them lost."""
    information = symmetric_inverse(start)
    for option in options:
        blocks, every = option.candidates.blocks, np.ones(len(option.candidates))
        information = information + profiled_information(
            blocks, every, len(information)
        )
    return symmetric_inverse(information)
