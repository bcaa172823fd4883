"""Search for the best sequence of stages within a time budget.

1. A beam search grows plans stage by stage, with a first look at each. A rough
   stage comes first where it lets the next instrument follow, and not elsewhere.
2. The best sequences are refined with the exact model (`refine`), and verified.
3. A bound over all plans (`bound`) certifies the best one, and names combinations of
   measurements which could still be better: these are refined as well.

All plans on the way form the Pareto front of accuracy against time.

After each partial plan in the beam, every option is tried as the next stage, with
several numbers of readings. The most accurate plans go on, and the most accurate for
their time.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from oed import units
from oed.accuracy import ErrorMaps, Reference
from oed.base import Array, Index
from oed.linear_algebra import symmetric_inverse
from oed.measurement import Measurement
from oed.planning.bound import GoalBound, bound_goal
from oed.planning.goal import Goal, ToolEffects, workspace_goal
from oed.planning.knowledge import Prior, make_knowledge
from oed.planning.option import Option
from oed.planning.prediction import PlanStage, predict_stage, profile
from oed.planning.problem import (
    PlanProblem,
    PlanStreams,
    StageMemory,
    StagePlan,
    best_plan,
    is_better,
    pareto_front,
    select_readings,
)
from oed.planning.virtual_machines import PlanRealisation, propagate

# Refinement of promising plans with the exact model: time moved between stages.
#
# A refined plan selects the readings of each stage anew, given what the later stages add.
# Every trial of a stage draws the same machines, so plans differ by their readings alone.

MAX_ROUNDS = 8  #: times that time is moved, at most
EXCHANGE_SWEEPS = 3  #: exchange sweeps when the readings of a stage are selected
TIME_TOLERANCE = 1e-9  #: rounding of sums of times
Step = tuple[Option, int]  #: an option, and how many of its candidates are read
#: share of a stage's readings that is given up when time is moved to another stage
REPLACED_SHARE = 0.25


def move_time(problem: PlanProblem, plan: StagePlan) -> StagePlan:
    """Spend the time that remains and move time between stages, while that helps."""
    best = evaluate_steps(problem, steps_of(plan))
    for _ in range(MAX_ROUNDS):
        better = _first_improvement(problem, best)
        if better is None:
            break
        best = better
    return best


def _first_improvement(problem: PlanProblem, plan: StagePlan) -> StagePlan | None:
    """The first better plan: the same steps selected anew, then each move."""
    steps = steps_of(plan)
    for trial in [steps, *propose_moves(steps, problem.budget)]:
        candidate = evaluate_steps(problem, trial, plan)
        if is_better(candidate, plan):
            return candidate
    return None


def evaluate_steps(
    problem: PlanProblem, steps: Sequence[Step], reference: StagePlan | None = None
) -> StagePlan:
    """Plan with these numbers of readings, predicted with the exact model.

    reference  a plan of the same options: its later stages say what information is
               added after each stage
    """
    plan = problem.empty_plan()
    for k, (option, count) in enumerate(steps):
        prior = plan.posterior(problem.start)
        later = _stages_of(reference, steps[k + 1 :])
        information = symmetric_inverse(make_knowledge(prior).mean_square_error)
        information = information + sum(
            (stage.information for stage in later), np.zeros_like(information)
        )
        probability = problem.capture_probability(option, prior)
        chosen = select_readings(
            option,
            count,
            information,
            problem.goal.criterion(problem.setup_columns(option)),
            probability,
            EXCHANGE_SWEEPS,
            _reading_time(problem.budget - plan.seconds, steps[k:], later),
        )
        stage = problem.predict(plan, option, chosen, probability)
        plan = problem.extend(plan, stage)
    return plan


def _stages_of(reference: StagePlan | None, steps: Sequence[Step]) -> list[PlanStage]:
    """The stages of a plan with the steps' options, in their order; else none."""
    stages = {} if reference is None else {s.option.name: s for s in reference.stages}
    names = [option.name for option, _ in steps]
    if not all(name in stages for name in names):
        return []
    return [stages[name] for name in names]


def _reading_time(
    seconds: float, steps: Sequence[Step], later: Sequence[PlanStage]
) -> float:
    """Time (s) for the first step's readings, beside those of the others."""
    (option, count), others = steps[0], steps[1:]
    available = seconds - option.mounting_seconds
    usual = []
    for (other, other_count), stage in zip(others, later, strict=False):
        reading_time = stage.seconds - other.mounting_seconds
        share = reading_time * other_count / len(stage.chosen)
        usual.append(other.mounting_seconds + share)
    wanted_seconds = max(available - sum(usual), option.shortest_seconds(count))
    return min(available - least_seconds(others), wanted_seconds)


def verify_plan(problem: PlanProblem, plan: StagePlan) -> StagePlan:
    """The same readings, judged by many other machines than when they were chosen."""
    verified = problem.empty_plan()
    for stage in plan.stages:
        prior = verified.posterior(problem.start)
        probability = problem.capture_probability(stage.option, prior)
        judged = problem.predict(
            verified, stage.option, stage.chosen, probability, verifies=True
        )
        verified = problem.extend(verified, judged)
    return verified


def trim_plan(problem: PlanProblem, plan: StagePlan) -> StagePlan:
    """A plan without readings that its targets do not need, the longest ones first."""
    steps = steps_of(plan)
    first = evaluate_steps(problem, steps)
    best = min(first, evaluate_steps(problem, steps, first), key=lambda p: p.value)
    slowest_first = sorted(
        range(len(steps)), key=lambda k: -float(steps[k][0].candidate_seconds.mean())
    )
    for k in slowest_first:
        option, most = steps[k]
        least = option.counts[0]
        while best.value <= 1.0 and least < most:
            middle = (least + most) // 2
            trial = evaluate_steps(problem, replaced_step(steps, k, middle), best)
            if trial.value <= 1.0:
                best, most = trial, middle
            else:
                least = middle + 1
        steps[k] = (option, most)
    return best


def plan_from_counts(
    problem: PlanProblem, counts: dict[int, float]
) -> StagePlan | None:
    """Refined plan from relaxed numbers by option; None where time is too short."""
    steps = []
    for position, count in counts.items():
        option = problem.options[position]
        rounded = int(np.clip(count, option.counts[0], option.counts[-1]))
        steps.append((option, rounded))
    shortened = _shortened(steps, problem.budget)
    if shortened is None:
        return None
    return move_time(problem, evaluate_steps(problem, _ordered(problem, shortened)))


def _shortened(steps: list[Step], budget: float) -> list[Step] | None:
    """The steps with readings left out until the budget (s) pays for the others."""
    while least_seconds(steps) > budget * (1 + TIME_TOLERANCE):
        spare = [count - option.counts[0] for option, count in steps]
        if max(spare) <= 0:
            return None
        k = int(np.argmax(spare))
        steps = replaced_step(steps, k, steps[k][1] - 1)
    return steps


def _ordered(problem: PlanProblem, steps: Sequence[Step]) -> list[Step]:
    """The steps in the order in which each loses the fewest readings."""
    remaining = list(steps)
    ordered: list[Step] = []
    prior: Prior = problem.start
    while remaining:
        probability = [
            problem.capture_probability(option, prior).mean() for option, _ in remaining
        ]
        best = int(np.argmax(np.round(probability, 3)))
        ordered.append(remaining.pop(best))
        prior = evaluate_steps(problem, ordered).posterior(problem.start)
    return ordered


# -- moves -----------------------------------------------------------------------------
def steps_of(plan: StagePlan) -> list[Step]:
    """The steps of a plan."""
    return [(stage.option, len(stage.chosen)) for stage in plan.stages]


def least_seconds(steps: Sequence[Step]) -> float:
    """Shortest time (s) of stages with these numbers of readings."""
    return sum(o.mounting_seconds + o.shortest_seconds(n) for o, n in steps)


def propose_moves(steps: list[Step], budget: float) -> list[list[Step]]:
    """Changes to try, each within the budget (s).

    First all stages filled up with the time that remains; then fewer readings in one
    stage, and more in others for the time that this frees; last, neighbours swapped.
    """
    count = range(len(steps))
    trials = [fill_time(steps, budget, last) for last in count]
    for giver in count:
        option, readings = steps[giver]
        fewer = max(option.counts[0], int(readings * (1 - REPLACED_SHARE)))
        if fewer < readings:
            lowered = replaced_step(steps, giver, fewer)
            receivers = [k for k in count if k != giver]
            trials += [fill_time(lowered, budget, giver, first) for first in receivers]
    trials += [_swapped(steps, k) for k in count[:-1]]
    return [
        trial
        for k, trial in enumerate(trials)
        if trial != steps and trial not in trials[:k]
    ]


def fill_time(
    steps: list[Step], budget: float, last: int, first: int = 0
) -> list[Step]:
    """As many readings as the budget pays for: in step `first`, then others, `last`."""
    order = sorted(range(len(steps)), key=lambda k: (k == last, k != first))
    filled = list(steps)
    for k in order:
        option, count = filled[k]
        others = least_seconds(filled[:k] + filled[k + 1 :])
        affordable = option.affordable_counts(budget - others)
        if affordable and affordable[-1] > count:
            filled[k] = (option, affordable[-1])
    return filled


def replaced_step(steps: Sequence[Step], k: int, count: int) -> list[Step]:
    """The steps with another number of readings in step k."""
    changed = list(steps)
    changed[k] = (steps[k][0], count)
    return changed


def _swapped(steps: list[Step], k: int) -> list[Step]:
    """The steps with k and its successor in the other order."""
    return [*steps[:k], steps[k + 1], steps[k], *steps[k + 2 :]]


BEAM_SIZE = 6  #: number of partial plans in the beam, where none is asked for

Evaluated = dict[tuple[tuple[str, int], ...], StagePlan]


def beam_search(
    problem: PlanProblem, beam: int, progress: Callable[[float], None] | None
) -> list[StagePlan]:
    """All partial plans in the order of evaluation; `progress` hears the share done."""
    evaluated: Evaluated = {}
    parents = [problem.empty_plan()]
    for depth in range(problem.stages):
        grown: dict[tuple[str, ...], StagePlan] = {}
        for k, parent in enumerate(parents):
            for child in _children(problem, parent):
                steps = tuple((s.option.name, len(s.chosen)) for s in child.stages)
                evaluated[steps] = child
                key = (*sorted(child.names), str(len(child.stages)))
                if key not in grown or _rank(child) < _rank(grown[key]):
                    grown[key] = child
            if progress is not None:
                level = depth + (k + 1) / len(parents)
                progress(level / problem.stages)
        if not grown:
            break
        parents = _next_beam(list(grown.values()), beam)
    return list(evaluated.values())


def _next_beam(plans: list[StagePlan], beam: int) -> list[StagePlan]:
    """The most accurate plans, then the most accurate for their time."""
    by_value = sorted(plans, key=lambda plan: plan.value)[: beam // 2 + 1]
    by_rank = sorted(plans, key=_rank)[:beam]
    distinct = list(dict.fromkeys([*by_value, *by_rank]))
    return distinct[: beam + 2]


def _rank(plan: StagePlan) -> float:
    """Log of the value, corrected for time; value ~ 1 / sqrt(time) is usual."""
    return float(np.log(plan.value) + 0.5 * np.log(max(plan.seconds, 1.0)))


def _children(problem: PlanProblem, parent: StagePlan) -> list[StagePlan]:
    """A plan with one more stage: each further option, with each number to try."""
    seconds = problem.budget - parent.seconds
    prior = parent.posterior(problem.start)
    children = []
    for option in problem.options:
        if option.name in parent.names:
            continue
        probability = problem.capture_probability(option, prior)
        reading_time = seconds - option.mounting_seconds
        for count in option.affordable_counts(seconds):
            child = problem.first_look(parent, option, count, probability, reading_time)
            children.append(child)
    return children


REFINED_SEQUENCES = 6  #: sequences which are refined
#: value at a first look up to which a refined plan can reach its targets
NEAR_TARGET_VALUE = 1.1
BEAM_SHARE = 0.8  #: share of the progress that the beam search takes

Progress = Callable[[float], None]


@dataclasses.dataclass(frozen=True, eq=False)
class PlanSearchResult:
    """Result of a search."""

    #: the plan: the most accurate one within the budget, or, with targets, the shortest
    #: one that reaches them
    best: StagePlan
    reached: bool  #: whether the targets are reached; True without targets
    #: Pareto front of accuracy against time, shortest first
    front: tuple[StagePlan, ...]
    alternatives: tuple[StagePlan, ...]  #: other refined sequences, best first
    bound: GoalBound  #: lower bound of the goal over all plans within the budget
    most_accurate: StagePlan  #: the plan of the smallest value
    #: option of the best further stage, and its relative gain, if there were time for
    #: it; None: all options are in the plan
    next_gain: tuple[str, float] | None

    @property
    def loss(self) -> float:
        """Share by which `most_accurate` can be worse than the best possible plan."""
        return max(self.most_accurate.value / self.bound.value - 1.0, 0.0)


def search_plan(
    problem: PlanProblem,
    *,
    beam: int | None = None,
    loss: float = 0.05,
    progress: Progress | None = None,
) -> PlanSearchResult:
    """Search for the best sequence of stages within the problem's time.

    loss  share of the value within which the best plan is to be certified

    Raises ValueError where the budget pays for no option.
    """
    goal = problem.goal
    partial = beam_search(
        problem, beam or BEAM_SIZE, _scaled(progress, 0.0, BEAM_SHARE)
    )
    if not partial:
        raise ValueError(_too_short(problem))
    refined = _refine(problem, partial, _scaled(progress, BEAM_SHARE, 1.0))
    value = min(plan.value for plan in refined)
    bound = bound_goal(problem, value, loss)
    for counts in bound.promising:
        plan = plan_from_counts(problem, counts)
        if plan is not None:
            refined.append(verify_plan(problem, plan))
    most_accurate = best_plan(refined)
    best = most_accurate
    enough = list[StagePlan]()
    if goal.has_targets:
        enough = _plans_on_target(problem, partial, refined)
        best = min(enough, key=lambda plan: plan.seconds, default=most_accurate)
    front = pareto_front([problem.empty_plan(), *partial, *refined])
    if goal.has_targets:
        front = pareto_front([*front, *enough])
    others = [plan for plan in refined if plan is not best]
    return PlanSearchResult(
        best=best,
        reached=bool(enough) or not goal.has_targets,
        front=tuple(front),
        alternatives=tuple(sorted(others, key=lambda plan: plan.value)),
        bound=bound,
        most_accurate=most_accurate,
        next_gain=_next_gain(problem, best),
    )


def _scaled(progress: Progress | None, first: float, last: float) -> Progress | None:
    """Progress of a part of the search that runs from share `first` to `last`."""
    if progress is None:
        return None
    return lambda share: progress(first + (last - first) * share)


def _too_short(problem: PlanProblem) -> str:
    if not problem.options:
        return "no measurement is left to plan"
    least = min(option.least_seconds for option in problem.options)
    budget = units.number(problem.budget, "min")
    return (
        f"the budget of {budget:.1f} min pays for no measurement: the shortest takes"
        f" {units.number(least, 'min'):.1f} min"
    )


def _first_plans(plans: Sequence[StagePlan]) -> list[StagePlan]:
    """The first plan of each combination of options."""
    combinations: dict[tuple[str, ...], StagePlan] = {}
    for plan in plans:
        combinations.setdefault(tuple(sorted(plan.names)), plan)
    return list(combinations.values())


def _refine(
    problem: PlanProblem, partial: Sequence[StagePlan], progress: Progress | None
) -> list[StagePlan]:
    """The best combinations of options, refined and verified."""
    by_value = sorted(partial, key=lambda plan: plan.value)
    refined = []
    for k, plan in enumerate(_first_plans(by_value)[:REFINED_SEQUENCES]):
        refined.append(move_time(problem, plan))
        if progress is not None:
            progress((k + 1) / REFINED_SEQUENCES)
    return [verify_plan(problem, plan) for plan in refined]


def _plans_on_target(
    problem: PlanProblem, partial: Sequence[StagePlan], refined: Sequence[StagePlan]
) -> list[StagePlan]:
    """Plans that reach the targets: refined ones, trimmed, and each shortest one."""
    by_time = sorted(partial, key=lambda plan: plan.seconds)
    near = [plan for plan in by_time if plan.value <= NEAR_TARGET_VALUE]
    shortest = _first_plans(near)
    on_target = [plan for plan in refined if plan.value <= 1.0]
    trimmed = [
        trim_plan(problem, plan) for plan in [*shortest[:REFINED_SEQUENCES], *on_target]
    ]
    verified = [verify_plan(problem, plan) for plan in trimmed]
    return [plan for plan in [*refined, *verified] if plan.value <= 1.0]


def _next_gain(problem: PlanProblem, best: StagePlan) -> tuple[str, float] | None:
    """The option whose further stage would gain most, and its relative gain."""
    prior = best.posterior(problem.start)
    gains = []
    for option in problem.options:
        if option.name in best.names:
            continue
        probability = problem.capture_probability(option, prior)
        grown = problem.first_look(best, option, option.counts[-1], probability)
        gains.append((option.name, 1.0 - grown.value / best.value))
    return max(gains, key=lambda gain: gain[1], default=None)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class PlanningTask:
    """What to plan for one machine; its searches share the stages that they predict."""

    measurement: Measurement  #: the machine, without set-ups
    command: Array  #: (m, n_dof) workspace commands at which its accuracy counts, SI
    reference: Reference  #: against which errors are stated
    options: Sequence[Option]  #: the measurements that a plan may take
    #: {pose component: accuracy}, SI; empty: all components count
    targets: Mapping[str, float]
    budget: float  #: time of a plan at most, s
    stages: int  #: their number at most
    seed: Sequence[int]  #: of all random numbers
    #: beside the geometry, on the machine whose accuracy counts
    effects: ToolEffects | None = None
    #: (k, k) covariance of its free parameters from earlier readings, in units of their
    #: tolerances; None where the tolerances are all that is known
    known: Array | None = None
    memory: StageMemory = dataclasses.field(default_factory=StageMemory)

    @cached_property
    def all_components(self) -> Goal:
        """The accuracy of all pose components."""
        return self._goal({})

    @cached_property
    def goal(self) -> Goal:
        """What plans are judged by."""
        return self._goal(self.targets) if self.targets else self.all_components

    @cached_property
    def _maps(self) -> ErrorMaps:
        return ErrorMaps.of(self.measurement.kinematics, self.command, self.reference)

    def _goal(self, targets: Mapping[str, float]) -> Goal:
        return workspace_goal(self.measurement, self._maps, targets, self.effects)

    @cached_property
    def start(self) -> Array:
        """Covariance (n, n) before, in tolerances, effects as unknown."""
        covariance = np.eye(self.all_components.parameters)
        if self.known is not None:
            count = len(self.known)
            covariance[:count, :count] = self.known
        return covariance

    def search(
        self,
        budget: float | None = None,
        *,
        stages: int | None = None,
        beam: int | None = None,
        loss: float = 0.05,
        options: Sequence[Option] | None = None,
        progress: Progress | None = None,
    ) -> PlanSearchResult:
        """Search for the best plan; by default with the task's time, stages and options.

        Raises ValueError where the time pays for no measurement.
        """
        problem = self._problem(budget, stages, options)
        return search_plan(problem, beam=beam, loss=loss, progress=progress)

    def _problem(
        self,
        budget: float | None = None,
        stages: int | None = None,
        options: Sequence[Option] | None = None,
    ) -> PlanProblem:
        """The problem of a new search; by default all of the task."""
        return PlanProblem(
            tuple(self.options if options is None else options),
            self.goal,
            self.budget if budget is None else budget,
            self.stages if stages is None else stages,
            self.start,
            PlanStreams.seeded(self.seed),
            self.memory,
        )

    def stage_generator(self, stage: int) -> np.random.Generator:
        """Random numbers about one stage of a plan, counted from 0.

        Stage 0 has not those of the search, whose key is this one without an end.
        """
        return np.random.default_rng([*self.seed, 1 + stage])

    def predict(self, readings: Sequence[tuple[Option, Index]]) -> StagePlan:
        """A plan of some candidates of each option, one option after the other."""
        problem = self._problem()
        plan = problem.empty_plan()
        for k, (option, chosen) in enumerate(readings):
            prior, rng = plan.posterior(self.start), self.stage_generator(k)
            probability = problem.capture_probability(option, prior)
            stage = predict_stage(option, chosen, prior, probability, rng)
            plan = problem.extend(plan, stage)
        return plan

    def realise(
        self,
        plan: StagePlan,
        machines: int,
        rng: np.random.Generator,
        progress: Progress | None = None,
    ) -> PlanRealisation:
        """Carry virtual machines exactly through a plan, as `propagate` does."""
        return propagate(
            plan.stages,
            self.command,
            machines,
            rng,
            reference=self.reference,
            start=self.known,
            progress=progress,
        )

    def covariance_after(self, plan: StagePlan) -> Array:
        """Covariance (n, n) of the machine after a plan."""
        return plan.stages[-1].covariance if plan.stages else self.start

    def covariance_of_all(self) -> Array:
        """Covariance (n, n) after all candidates of all options, none of them lost."""
        information, n = symmetric_inverse(self.start), len(self.start)
        for option in self.options:
            blocks = option.candidates.blocks
            rows = blocks.reshape(-1, blocks.shape[2])
            information = information + profile((rows.T @ rows)[None], n, n).machine[0]
        return symmetric_inverse(information)
