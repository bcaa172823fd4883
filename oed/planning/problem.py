"""The planning problem: options, goal, budget, and how a plan grows by a stage."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Index
from oed.linear_algebra import symmetric_inverse
from oed.planning import travel
from oed.planning.goal import Goal
from oed.planning.knowledge import Prior, as_knowledge
from oed.planning.option import Option
from oed.planning.prediction import DRAWS, PlanStage, predict_stage
from oed.planning.selection import select_readings
from oed.planning.stage_plan import StageMemory, StagePlan
from oed.planning.streams import PlanStreams

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
            symmetric_inverse(as_knowledge(prior).mean_square_error),
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
        draws, stream = DRAWS, self.streams.refinement
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
