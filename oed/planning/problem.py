"""The planning problem: options, goal, budget, and how a plan grows by a stage.

A stage's readings are selected by greedy choice and exchange. Each candidate's
information is weighted with the probability that it is captured.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from oed.base import Array, Index
from oed.design import Criterion, Rules
from oed.linear_algebra import symmetric_inverse
from oed.planning import travel
from oed.planning.goal import Goal
from oed.planning.knowledge import Prior, make_knowledge
from oed.planning.option import Option
from oed.planning.prediction import MACHINE_DRAWS, PlanStage, predict_stage

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


def capture_stream() -> np.random.Generator:
    """Of the machines that estimate how often runs are captured."""
    return np.random.default_rng(CAPTURE_SEED)


@dataclasses.dataclass(frozen=True, eq=False)
class PlanStreams:
    """Generators of one search.

    All searches of a study judge refined plans by the same drawn machines: the streams of
    those start anew at each use, and follow no seed.
    """

    #: machines of partial plans; drawn on and on during the search
    first_look: np.random.Generator
    bound: np.random.Generator  #: machines for the bound over all plans; drawn once

    @classmethod
    def seeded(cls, seed: int | Sequence[int]) -> "PlanStreams":
        """The streams of one search; only the first look at partial plans follows the seed."""
        return cls(np.random.default_rng(seed), np.random.default_rng(BOUND_SEED))


#: identities of the stage before and of the option, machines drawn, readings
Key = tuple[int, int, int, bytes]


# Plans as sequences of stages: their value, their comparison, their Pareto front.
#
# Stages that a search has predicted are computed once. Refined and verified plans draw
# the same machines for a stage at each use. A stage after the same stages, with the same
# readings, is therefore the same. Plans on trial differ in one or two stages, and
# searches with fewer measurements meet earlier plans again.
class StageMemory:
    """Stages by the stage before, the option, its readings and the machines drawn.

    It holds for one machine before the plan and one set of streams.
    """

    def __init__(self) -> None:
        self._stages: dict[Key, tuple[PlanStage | None, PlanStage]] = {}

    def stage(
        self,
        plan: "StagePlan",
        option: Option,
        chosen: Index,
        draws: int,
        predict: Callable[[], PlanStage],
    ) -> PlanStage:
        """The stage after `plan` with the chosen candidates; predicted where it is new.

        plan   stages that this memory holds
        draws  number of machines drawn
        """
        before = plan.stages[-1] if plan.stages else None
        key = id(before), id(option), draws, np.sort(chosen).tobytes()
        if key not in self._stages:
            # with the stage before, so that its identity stays its own
            self._stages[key] = before, predict()
        return self._stages[key][1]


MIN_RELATIVE_GAIN = 1e-3  #: relative gain below which a change counts as none
#: relative difference of values that drawn machines do not resolve
VALUE_RESOLUTION = 3e-3
#: ratio of linearisation residuals below which a plan counts as more linear
MORE_LINEAR_SHARE = 0.9


@dataclasses.dataclass(frozen=True, eq=False)
class StagePlan:
    """Stages in order."""

    stages: tuple[PlanStage, ...]
    seconds: float  #: time of all stages
    value: float  #: value of the goal after the last stage; smaller is better
    #: (K,) of each pose component, before any stage and after each
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
    """Whether a plan is more accurate, or as accurate with rough readings first."""
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


#: capture probability below which a candidate is not worth a look
MIN_PROBABILITY = 1e-3


def select_readings(
    option: Option,
    count: int,
    prior_information: Array,
    criterion: Criterion,
    probability: Array,
    sweeps: int = 1,
    seconds: float = np.inf,
) -> Index:
    """Select `count` candidates; fewer where `seconds` do not pay for them.

    prior_information  (n, n) about the machine's parameters
    probability        (C,) that each candidate is captured
    sweeps             exchange sweeps; 0: greedy choice alone
    """
    base = np.eye(option.unknowns)
    n = len(prior_information)
    base[:n, :n] = prior_information
    pool = np.flatnonzero(probability > MIN_PROBABILITY)
    if len(pool) < count:
        pool = np.argsort(-probability, kind="stable")[:count]
    weights = np.sqrt(probability[pool])[:, None, None]
    blocks = option.candidates.blocks[pool] * weights
    time = option.candidate_seconds[pool]
    rules = Rules.build(size=count)
    starts = []
    if np.ptp(time) > 0.0:  # of equal readings the number limits the time
        rules = Rules.build(size=count, seconds=time, budget=seconds)
        shortest = np.argsort(time, kind="stable")[:count]
        starts.append(shortest[np.cumsum(time[shortest]) <= seconds])
    best = rules.quick_plan(blocks, criterion, base, starts, sweeps)
    if not len(best):
        order = np.argsort(option.candidate_seconds, kind="stable")
        return np.sort(order[:count])
    return np.sort(pool[best])


VERIFICATION_DRAWS = 1000  #: machines drawn to judge a finished plan


@dataclasses.dataclass(frozen=True, eq=False)
class PlanProblem:
    """What to plan.

    budget   time of all stages at most, s;  stages: their number at most
    start    (n, n) covariance of the machine before, in units of the tolerances
    streams  random streams of the search
    memory   stages predicted before, by this search or others with the same start
    """

    options: tuple[Option, ...]
    goal: Goal
    budget: float
    stages: int
    start: Array
    streams: PlanStreams
    memory: StageMemory = dataclasses.field(default_factory=StageMemory)

    @cached_property
    def information(self) -> Array:
        """Information (n, n) about the machine before."""
        return symmetric_inverse(self.start)

    def empty_plan(self) -> StagePlan:
        """The plan that measures nothing."""
        accuracy = self.goal.accuracy(self.start)
        return StagePlan((), 0.0, self.goal.value(self.start), (accuracy,))

    def extend(self, plan: StagePlan, stage: PlanStage) -> StagePlan:
        """A plan with one more stage."""
        accuracy = self.goal.accuracy(stage.covariance)
        return StagePlan(
            stages=(*plan.stages, stage),
            seconds=plan.seconds + stage.seconds,
            value=float(self.goal.combine(accuracy)),
            accuracy=(*plan.accuracy, accuracy),
        )

    def capture_probability(self, option: Option, prior: Prior) -> Array:
        """Probability (C,) that each candidate is captured, on the same machines."""
        return travel.capture_probability(option, prior, capture_stream())

    def first_look(
        self,
        plan: StagePlan,
        option: Option,
        count: int,
        probability: Array,
        seconds: float = np.inf,
    ) -> StagePlan:
        """A plan with `count` readings of one more option, by few machines."""
        prior = plan.posterior(self.start)
        chosen = select_readings(
            option,
            count,
            symmetric_inverse(make_knowledge(prior).mean_square_error),
            self.goal.criterion(self.setup_columns(option)),
            probability,
            sweeps=0,
            seconds=seconds,
        )
        rng = self.streams.first_look
        stage = predict_stage(option, chosen, prior, probability, rng, exact=False)
        return self.extend(plan, stage)

    def predict(
        self,
        plan: StagePlan,
        option: Option,
        chosen: Index,
        probability: Array,
        *,
        verifies: bool = False,
    ) -> PlanStage:
        """The stage after `plan`, once for equal readings; more if it `verifies`."""
        draws, seed = MACHINE_DRAWS, REFINEMENT_SEED
        if verifies:
            draws, seed = VERIFICATION_DRAWS, VERIFICATION_SEED
        rng = np.random.default_rng([seed, len(plan.stages)])
        prior = plan.posterior(self.start)
        return self.memory.stage(
            plan,
            option,
            chosen,
            draws,
            lambda: predict_stage(option, chosen, prior, probability, rng, draws=draws),
        )

    def setup_columns(self, option: Option) -> int:
        """Number of an option's unknowns in addition to the machine's."""
        return option.unknowns - self.goal.parameters
