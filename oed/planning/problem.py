"""The planning problem: options, goal, budget, and how a plan grows by a stage.

A stage's readings are selected by greedy choice and exchange. Each candidate's
information is weighted with the probability that it is captured.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Index
from oed.design import Criterion, Rules
from oed.linear_algebra import symmetric_inverse
from oed.planning import travel
from oed.planning.goal import Goal
from oed.planning.knowledge import Prior, make_knowledge
from oed.planning.option import Option
from oed.planning.prediction import MACHINE_DRAWS, PlanStage, predict_stage
from oed.planning.stage_plan import PlanStreams, StageMemory, StagePlan

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
    rules, starts = Rules.build(size=count), []
    if np.ptp(time) > 0.0:  # of equal readings the number limits the time
        rules = Rules.build(size=count, seconds=time, budget=seconds)
        starts.append(_shortest(time, count, seconds))
    best = rules.quick_plan(blocks, criterion, base, starts, sweeps)
    if not len(best):
        order = np.argsort(option.candidate_seconds, kind="stable")
        return np.sort(order[:count])
    return np.sort(pool[best])


def _shortest(time: Array, count: int, seconds: float) -> Index:
    """The shortest candidates, at most `count`, within `seconds`."""
    order = np.argsort(time, kind="stable")[:count]
    in_time = np.cumsum(time[order]) <= seconds
    return np.asarray(order[in_time], dtype=np.intp)


#: machines drawn to judge a finished plan
VERIFICATION_DRAWS = 1000


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
        return travel.capture_probability(option, prior, self.streams.capture())

    def first_look(
        self,
        plan: StagePlan,
        option: Option,
        count: int,
        probability: Array,
        seconds: float = np.inf,
    ) -> StagePlan:
        """A plan with `count` readings of one more option, predicted with few machines.

        probability  (C,) that each candidate is captured after the plan
        seconds      time for the readings at most
        """
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
        """The stage after `plan`, by the exact model; once for equal readings.

        probability  (C,) that each candidate of the option is captured after the plan
        verifies     whether this judges a finished plan, by more machines and others
        """
        draws, stream = MACHINE_DRAWS, self.streams.refinement
        if verifies:
            draws, stream = VERIFICATION_DRAWS, self.streams.verification
        stage = self.memory.recall(plan, option, chosen, draws)
        if stage is None:
            rng, prior = stream(len(plan.stages)), plan.posterior(self.start)
            stage = predict_stage(option, chosen, prior, probability, rng, draws=draws)
            self.memory.store(plan, stage, draws)
        return stage

    def setup_columns(self, option: Option) -> int:
        """Number of an option's unknowns in addition to the machine's."""
        return option.unknowns - self.goal.parameters
