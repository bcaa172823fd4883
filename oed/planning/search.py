"""Sequences of stages within a budget: which measurement first, how many readings, when
to stop.

Best partial plans are carried along (a beam): every option, with several numbers of
readings, is tried as the next stage after each of them; a stage's readings are chosen
for the goal with what is known by then, weighed with their chance of being within the
instrument's travel. So a rough stage comes first where it makes the next one possible,
and not where it does not. The best sequences are then worked out exactly (readings lost
together, cut-off from the exact model), and time is moved between their stages while
that helps. All plans on the way make the Pareto front of accuracy against time. A bound
(`oed.planning.bound`) tells how far the best one can be from any plan, and names the
combinations of measurements that could still be better: these are worked out as well.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.design.criterion.protocol import inverse
from oed.planning import bound as bounding
from oed.planning import stage as staging
from oed.planning import travel
from oed.planning.goal import Goal
from oed.planning.known import Known, known
from oed.planning.option import Option
from oed.planning.stage import Stage

#: partial plans carried along; finished plans worked out exactly
BEAM, EXACT = 6, 6
#: share of a number of readings by which it is raised or lowered while time is moved
STEP = 0.25
#: value up to which a plan at a first look may reach the wanted accuracy when worked
#: out
NEAR = 1.1
#: times that time is moved at the most
ROUNDS = 8
#: relative gain below which a change counts as none
GAIN = 1e-3
#: values that differ by less are alike, as drawn machines tell them; then the plan that
#: is so many times as bent counts
ALIKE, STRAIGHTER = 3e-3, 0.9


@dataclasses.dataclass(frozen=True, eq=False)
class StagePlan:
    """Stages in order, the time they take (s), the goal's value after them, and the
    accuracy (K,) after each.
    """

    stages: tuple[Stage, ...]
    seconds: float
    value: float
    accuracy: tuple[Array, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Options in order."""
        return tuple(s.option.name for s in self.stages)

    @property
    def price(self) -> float:
        """Money, besides time."""
        return float(sum(s.option.price for s in self.stages))

    @property
    def bent(self) -> float:
        """Most that linearisation cuts off of any reading after its stage, in units of
        its noise.
        """
        shares = [
            s.cut_off / s.option.measurement.sigma(s.series)
            for s in self.stages
            if s.cut_off.size
        ]
        return max((float(share.max()) for share in shares), default=0.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Planned:
    """The answer.

    best          the plan: most accurate within the budget, or, where an accuracy is
                  wanted, the cheapest that has it
    reached       whether the wanted accuracy is reached (True where none is wanted)
    front         plans of which none is both shorter and more accurate, shortest first
    alternatives  other sequences worked out exactly, best first
    bound         no plan within the budget has a smaller value;  loss: share by which
                  `most_accurate` may miss it
    most_accurate the plan of least value
    next_gain     relative gain of the best further stage, were there time for it (None:
                  no option helps)
    """

    best: StagePlan
    reached: bool
    front: tuple[StagePlan, ...]
    alternatives: tuple[StagePlan, ...]
    bound: bounding.Bounded
    most_accurate: StagePlan
    next_gain: tuple[str, float] | None

    @property
    def loss(self) -> float:
        """Share by which the most accurate plan found may be worse than the best
        possible one, at the most.
        """
        return max(self.most_accurate.value / self.bound.value - 1.0, 0.0)


def plan(
    options: Sequence[Option],
    goal: Goal,
    budget: float,
    rng: np.random.Generator,
    *,
    covariance: Array | None = None,
    stages: int = 4,
    beam: int = BEAM,
    loss: float = 0.05,
    progress: Callable[[float], None] | None = None,
) -> Planned:
    """The best sequence of at most `stages` stages within `budget` seconds.

    covariance (n, n) is of the machine's parameters before, in units of their
    tolerances; the tolerances themselves where it is not told. Raises ValueError where
    the budget does not pay for any option.
    """
    n = goal.factors.shape[2]
    start = np.eye(n) if covariance is None else covariance
    search = _PlanSearch(tuple(options), goal, budget, rng, stages, beam, progress)
    found = search.run(start)
    if not found:
        cheapest = min(
            o.mounting + float(np.sort(o.seconds)[: o.counts[0]].sum()) for o in options
        )
        raise ValueError(
            f"the budget of {budget / 60:.1f} min pays for no measurement: the least is"
            f" {cheapest / 60:.1f} min"
        )
    exact = [search.checked(p, start) for p in search.exactly(found, start)]
    known = min(p.value for p in exact)
    told = bounding.bound(options, goal, inverse(start), budget, stages, known, loss)
    exact += [search.checked(p, start) for p in search.tried(told.hopeful, start)]
    most_accurate = _best(exact)
    told = dataclasses.replace(
        told, closed=most_accurate.value <= told.value * (1.0 + loss) * (1.0 + 1e-9)
    )
    front = _front([search.empty(start), *search.seen.values(), *exact])
    best, reached = most_accurate, True
    if goal.wanted:
        cheaper = [search.checked(p, start) for p in search.cheaper(exact, start)]
        enough = [p for p in exact + cheaper if p.value <= 1.0]
        best, reached = (
            (min(enough, key=lambda p: p.seconds), True)
            if enough
            else (most_accurate, False)
        )
        front = _front([*front, *enough])
    ranked = sorted((p for p in exact if p is not best), key=lambda p: p.value)
    return Planned(
        best,
        reached,
        tuple(front),
        tuple(ranked),
        told,
        most_accurate,
        search.next_gain(best, start),
    )


@dataclasses.dataclass(eq=False)
class _PlanSearch:
    options: tuple[Option, ...]
    goal: Goal
    budget: float
    rng: np.random.Generator
    stages: int
    beam: int
    progress: Callable[[float], None] | None
    seen: dict[tuple[tuple[str, int], ...], StagePlan] = dataclasses.field(
        default_factory=dict
    )

    def empty(self, start: Array) -> StagePlan:
        """Nothing measured."""
        return StagePlan((), 0.0, self.goal.value(start), (self.goal.accuracy(start),))

    def run(self, start: Array) -> list[StagePlan]:
        """Promising plans, best first."""
        carried = [self.empty(start)]
        for depth in range(self.stages):
            grown: dict[tuple[str, ...], StagePlan] = {}
            for k, parent in enumerate(carried):
                for child in self._children(parent, start):
                    self.seen[
                        tuple((s.option.name, len(s.chosen)) for s in child.stages)
                    ] = child
                    key = (*sorted(child.names), str(len(child.stages)))
                    if key not in grown or self._rank(child) < self._rank(grown[key]):
                        grown[key] = child
                self._told((depth + (k + 1) / len(carried)) / self.stages)
            if not grown:
                break
            # kinds of plans compete: the most accurate, and the most accurate for their
            # time
            by_value = sorted(grown.values(), key=lambda p: p.value)
            by_rate = sorted(grown.values(), key=self._rank)
            carried = list(
                dict.fromkeys([*by_value[: self.beam // 2 + 1], *by_rate[: self.beam]])
            )[: self.beam + 2]
        return sorted(self.seen.values(), key=lambda p: p.value)

    def _rank(self, plan: StagePlan) -> float:
        """Log of the value, and what the time spent could have bought at the usual rate
        (value ~ 1 / sqrt(time)).
        """
        return float(np.log(plan.value) + 0.5 * np.log(max(plan.seconds, 1.0)))

    def _told(self, share: float) -> None:
        if self.progress is not None:
            self.progress(0.8 * share)

    def _children(self, parent: StagePlan, start: Array) -> list[StagePlan]:
        left = self.budget - parent.seconds
        done = set(parent.names)
        before = parent.stages[-1].known if parent.stages else start
        children = []
        for option in self.options:
            if option.name in done:
                continue
            chances = travel.available(option, before)
            for count in self._counts(option, left):
                children.append(
                    self._with(
                        parent, option, count, before, chances, left - option.mounting
                    )
                )
        return children

    def _counts(self, option: Option, left: float) -> list[int]:
        """Numbers of readings that the time left pays for: those asked for, and all it
        can pay.
        """
        time = np.cumsum(np.sort(option.seconds))
        most = int(np.searchsorted(time, left - option.mounting, side="right"))
        wanted = [c for c in option.counts if c <= most]
        full = min(most, option.counts[-1])
        return sorted({*wanted, full}) if full >= option.counts[0] else []

    def _with(
        self,
        parent: StagePlan,
        option: Option,
        count: int,
        before: Array | Known,
        chances: Array,
        left: float = np.inf,
    ) -> StagePlan:
        """A further stage of at most `left` seconds for its readings, at a first look."""
        criterion = self.goal.criterion(self._more(option))
        held = inverse(known(before).square)
        chosen = staging.choose(option, count, held, criterion, chances, 0, left)
        stage = staging.told(option, chosen, before, self.rng, exact=False)
        return self._grown(parent, stage)

    def _more(self, option: Option) -> int:
        """Unknowns of an option beside the machine's."""
        return int(option.candidates.blocks.shape[2] - self.goal.factors.shape[2])

    def _grown(self, parent: StagePlan, stage: Stage) -> StagePlan:
        return StagePlan(
            (*parent.stages, stage),
            parent.seconds + stage.seconds,
            self.goal.value(stage.covariance),
            (*parent.accuracy, self.goal.accuracy(stage.covariance)),
        )

    # -- working out -------------------------------------------------------------------

    def exactly(self, found: Sequence[StagePlan], start: Array) -> list[StagePlan]:
        """The best sequences worked out, with time moved between their stages; each
        sequence once.
        """
        sequences: dict[tuple[str, ...], StagePlan] = {}
        for p in found:
            sequences.setdefault(tuple(sorted(p.names)), p)
        told = []
        for k, p in enumerate(list(sequences.values())[:EXACT]):
            told.append(self._moved(p, start))
            self._told(1.0 + 0.25 * (k + 1) / EXACT)
        return told

    def checked(self, plan: StagePlan, start: Array) -> StagePlan:
        """A plan told by many other machines than it was chosen for."""
        made, before = self.empty(start), known(start)
        for k, s in enumerate(plan.stages):
            rng = np.random.default_rng([18, k])
            made = self._grown(
                made, staging.told(s.option, s.chosen, before, rng, draws=travel.MANY)
            )
            before = made.stages[-1].known
        return made

    def tried(
        self, hopeful: Sequence[dict[int, float]], start: Array
    ) -> list[StagePlan]:
        """Plans of combinations with relaxed numbers of readings, rounded so that the
        time pays for them.
        """
        told = []
        for relaxed in hopeful:
            steps = [
                (
                    self.options[s],
                    int(
                        np.clip(
                            n, self.options[s].counts[0], self.options[s].counts[-1]
                        )
                    ),
                )
                for s, n in relaxed.items()
            ]
            while _spent(steps) > self.budget * (1 + 1e-9):
                spare = [n - o.counts[0] for o, n in steps]
                if max(spare) <= 0:
                    break
                k = int(np.argmax(spare))
                steps[k] = (steps[k][0], steps[k][1] - 1)
            else:
                told.append(
                    self._moved(self._worked(self._ordered(steps, start), start), start)
                )
        return told

    def _ordered(
        self, steps: Sequence[tuple[Option, int]], start: Array
    ) -> list[tuple[Option, int]]:
        """Next always the measurement that is the least likely to lose its readings."""
        rest, ordered = list(steps), list[tuple[Option, int]]()
        before: Array | Known = start
        while rest:
            chances = [float(travel.available(o, before).mean()) for o, _ in rest]
            ordered.append(rest.pop(int(np.argmax(np.round(chances, 3)))))
            before = self._worked(ordered, start).stages[-1].known
        return ordered

    def cheaper(self, exact: Sequence[StagePlan], start: Array) -> list[StagePlan]:
        """Plans that reach the goal, or seem to, with as few readings as still reach
        it: of every combination of measurements the shortest, and those worked out.
        """
        shortest: dict[tuple[str, ...], StagePlan] = {}
        for p in sorted(self.seen.values(), key=lambda p: p.seconds):
            if p.value <= NEAR:
                shortest.setdefault(tuple(sorted(p.names)), p)
        near = sorted(shortest.values(), key=lambda p: p.seconds)[:EXACT]
        return [
            self._trimmed(p, start)
            for p in [*near, *(p for p in exact if p.value <= 1.0)]
        ]

    def _trimmed(self, plan: StagePlan, start: Array) -> StagePlan:
        """A plan without readings that the goal can do without, in the stage where they
        take the longest first.
        """
        steps = [(s.option, len(s.chosen)) for s in plan.stages]
        best = self._worked(steps, start)
        best = min(best, self._worked(steps, start, best), key=lambda p: p.value)
        for k in sorted(
            range(len(steps)), key=lambda k: -float(steps[k][0].seconds.mean())
        ):
            option, most = steps[k]
            least = option.counts[0]
            while best.value <= 1.0 and least < most:
                middle = (least + most) // 2
                made = self._worked(
                    [*steps[:k], (option, middle), *steps[k + 1 :]], start, best
                )
                if made.value <= 1.0:
                    best, most = made, middle
                else:
                    least = middle + 1
            steps[k] = (option, most)
        return best

    def _worked(
        self,
        steps: Sequence[tuple[Option, int]],
        start: Array,
        like: StagePlan | None = None,
    ) -> StagePlan:
        """A sequence with stated numbers of readings, exactly.

        Each stage's readings are chosen with what is known before it, and with what the
        later stages will add in a plan `like` this one, where there is one.
        """
        made, before = self.empty(start), known(start)
        for k, (option, count) in enumerate(steps):
            criterion = self.goal.criterion(self._more(option))
            held = inverse(known(before).square)
            later = _of(like, steps[k + 1 :])
            held = held + sum((s.information for s in later), np.zeros_like(held))
            chances = travel.available(option, before)
            left = self._left(made.seconds, steps[k:], later)
            chosen = staging.choose(option, count, held, criterion, chances, 3, left)
            # the same machines are drawn whatever was tried before, so that two plans
            # differ by their readings alone
            stage = staging.told(option, chosen, before, np.random.default_rng([17, k]))
            before = stage.known
            made = self._grown(made, stage)
        return made

    def _left(
        self, spent: float, steps: Sequence[tuple[Option, int]], later: Sequence[Stage]
    ) -> float:
        """Time for the readings of the first of the steps: the others keep what they
        took in a like plan, and at the least what they need.
        """
        (option, count), rest = steps[0], steps[1:]
        most = self.budget - spent - option.mounting - _spent(rest)
        kept = [
            o.mounting + (s.seconds - o.mounting) * c / len(s.chosen)
            for (o, c), s in zip(rest, later, strict=False)
        ]
        return min(
            most,
            max(
                self.budget - spent - option.mounting - sum(kept), _time(option, count)
            ),
        )

    def _moved(self, plan: StagePlan, start: Array) -> StagePlan:
        """Readings chosen anew beside those of the later stages, the time that is left
        spent, and time moved from one stage to another, while that helps.
        """
        best = self._worked([(s.option, len(s.chosen)) for s in plan.stages], start)
        for _ in range(ROUNDS):
            steps = [(s.option, len(s.chosen)) for s in best.stages]
            made = (
                self._worked(trial, start, best)
                for trial in [steps, *self._moves(steps)]
            )
            better = next((m for m in made if _better(m, best)), None)
            if better is None:
                break
            best = better
        return best

    def _moves(self, steps: list[tuple[Option, int]]) -> list[list[tuple[Option, int]]]:
        """All stages filled up with the time left, then fewer readings in one and as
        many more in others as that pays for, then neighbours in the other order.
        """
        count = range(len(steps))
        filled = [self._filled(steps, last) for last in count]
        trials = []
        for give in count:
            option, number = steps[give]
            less = max(option.counts[0], int(number * (1 - STEP)))
            if less < number:
                lowered = [*steps[:give], (option, less), *steps[give + 1 :]]
                trials += [
                    self._filled(lowered, give, first)
                    for first in count
                    if first != give
                ]
        trials += [
            [*steps[:k], steps[k + 1], steps[k], *steps[k + 2 :]] for k in count[:-1]
        ]
        return [
            t
            for k, t in enumerate(filled + trials)
            if t != steps and t not in (filled + trials)[:k]
        ]

    def _filled(
        self, steps: list[tuple[Option, int]], last: int, first: int = 0
    ) -> list[tuple[Option, int]]:
        """As many readings as the time pays for, in stage `first`, then in the others,
        in `last` at the end.
        """
        order = sorted(range(len(steps)), key=lambda k: (k == last, k != first))
        filled = list(steps)
        for k in order:
            full = self._counts(
                filled[k][0], self.budget - _spent(filled[:k] + filled[k + 1 :])
            )
            if full and full[-1] > filled[k][1]:
                filled[k] = (filled[k][0], full[-1])
        return filled

    def next_gain(self, best: StagePlan, start: Array) -> tuple[str, float] | None:
        """The option whose further stage would gain most, and its relative gain."""
        before = best.stages[-1].known if best.stages else start
        gains = []
        for option in self.options:
            if option.name in best.names:
                continue
            grown = self._with(
                best,
                option,
                option.counts[-1],
                before,
                travel.available(option, before),
            )
            gains.append((option.name, 1.0 - grown.value / best.value))
        return max(gains, key=lambda g: g[1], default=None)


def _better(one: StagePlan, other: StagePlan) -> bool:
    """Whether one plan is more accurate, or as accurate with the straighter readings:
    rough before fine.
    """
    alike = abs(one.value - other.value) < ALIKE * other.value
    if alike and min(one.bent, other.bent) < STRAIGHTER * max(one.bent, other.bent):
        return one.bent < other.bent
    return one.value < other.value * (1 - GAIN)


def _best(plans: Sequence[StagePlan]) -> StagePlan:
    """The most accurate plan; of those that are alike, the one of the straightest
    readings.
    """
    least = min(p.value for p in plans)
    return min(
        (p for p in plans if p.value <= least * (1 + ALIKE)), key=lambda p: p.bent
    )


def _of(like: StagePlan | None, steps: Sequence[tuple[Option, int]]) -> list[Stage]:
    """The stages of a like plan that measure what these steps do, in their order; none
    where it has not all of them.
    """
    there = {} if like is None else {s.option.name: s for s in like.stages}
    return (
        [there[o.name] for o, _ in steps]
        if all(o.name in there for o, _ in steps)
        else []
    )


def _time(option: Option, count: int) -> float:
    return float(np.sort(option.seconds)[:count].sum())


def _spent(steps: Sequence[tuple[Option, int]]) -> float:
    """Least time of stages with these numbers of readings."""
    return sum(o.mounting + _time(o, c) for o, c in steps)


def _front(plans: Sequence[StagePlan]) -> list[StagePlan]:
    """Plans of which none is both shorter and more accurate, shortest first."""
    kept: list[StagePlan] = []
    for p in sorted(plans, key=lambda p: (p.seconds, p.value)):
        if not kept or p.value < kept[-1].value * (1 - 1e-9):
            kept.append(p)
    return kept


def chosen_of(plan: StagePlan) -> list[Index]:
    """Chosen candidates of each stage."""
    return [s.chosen for s in plan.stages]
