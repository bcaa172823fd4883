"""Exchange and tabu search of pairs for plans, by any criterion.

An exchange takes a candidate out of the plan and another one in. Formulas of low rank rank all
pairs at once (`oed.design.pairs`); the information of each plan is summed anew, and plans are
compared by it: an exchange counts where the criterion itself rises.

In the tabu search each plan takes its best exchange even where it lowers the criterion. The
candidate that leaves, and the place that is filled, rest for a few steps, so that the search
climbs out of a local optimum and does not return to it (Glover 1989, ORSA J. Comput. 1,
190-206). Stage by stage, the half of the plans that has come less far is given up
(successive halving; Jamieson and Talwalkar 2016, AISTATS).

Which candidates may come is asked of the plan itself, every few steps: near saturation the
optimal weights do not tell which rows complete one another.
"""

import dataclasses
import itertools
from functools import cached_property

import numpy as np

from oed.base import Array, Index
from oed.design.blocks import find_copies, information
from oed.design.forms import Criterion
from oed.design.forms.variance import variance_reduction
from oed.design.pairs import Pairs
from oed.linear_algebra import symmetric_inverse

MAX_PLANS = 16  #: plans that are searched at first
NEAR_ROWS = 200  #: rows of the candidates that a plan exchanges with, at the least
NEAR_PER_PLACE = 4  #: candidates that a plan exchanges with, for each of its places
#: steps after which these are sought anew: a few rows change which others complete a plan
STEPS_NEAR = 5
#: most steps for which a candidate, or a place, rests, in turn for the plans: short rests
#: climb fast, long ones leave the wide basins of candidates with symmetries
MAX_RESTS = (2, 3, 4, 6, 10, 15)
MIN_GAIN = 1e-10  #: gain in log phi below which a plan counts as no better
#: numbers in the products of all pairs that are in memory at once
NUMBERS_AT_ONCE = 2_000_000


def exchange_pairs(
    blocks: Array, chosen: Index, base: Array, criterion: Criterion, exchanges: int
) -> Index:
    """The best pair of blocks (C, k, n) exchanged until none raises the criterion, for
    a base (n, n) that is positive definite.
    """
    chosen = chosen.copy()
    m = base + information(blocks[chosen])
    value = criterion.value(m)
    for _ in range(exchanges):
        position, block = _best_pair(blocks, chosen, m, criterion)
        changed = chosen.copy()
        changed[position] = block
        m = base + information(blocks[changed])
        after = criterion.value(m)
        if not after > value + MIN_GAIN:
            break
        chosen, value = changed, after
    return chosen


def _best_pair(
    blocks: Array, chosen: Index, m: Array, criterion: Criterion
) -> tuple[int, int]:
    """Place and block whose exchange raises the criterion most, part by part."""
    best = 0, int(chosen[0]), -np.inf
    step = max(1, NUMBERS_AT_ONCE // (len(chosen) * blocks.shape[1] ** 2))
    for begin in range(0, len(blocks), step):
        part = np.arange(begin, min(begin + step, len(blocks)))
        part = part[~np.isin(part, chosen)]
        if not part.size:
            continue
        values = criterion.exchange_values(Pairs(m, blocks[chosen], blocks[part]))
        position, number = divmod(int(values.argmax()), len(part))
        if values[position, number] > best[2]:
            best = position, int(part[number]), float(values[position, number])
    return best[0], best[1]


def search_plans(
    blocks: Array,
    starts: Index,
    base: Array,
    criterion: Criterion,
    steps: int,
    rng: np.random.Generator,
) -> Index:
    """The best plan (size,) that starts (plans, size) pass in `steps` of all."""
    copies = find_copies(blocks)
    problem = _TabuProblem(blocks[copies.first], base, criterion, copies.number)
    rests = itertools.cycle(MAX_RESTS)
    trails = [_Trail.at(copies.label[s], problem, next(rests)) for s in starts]
    guides = criterion.guides
    stages = int(np.log2(len(trails))) + 1
    for stage in range(stages):
        guide = guides[stage * len(guides) // stages]
        for trail in trails:
            for _ in range(steps // (stages * len(trails))):
                trail.step(problem, guide, rng)
            trail.note(problem)
        trails = _better_half(trails)
    return copies.different(trails[0].best)


def _better_half(trails: "list[_Trail]") -> "list[_Trail]":
    """The half with the better plans; of those that passed the same plan, one."""
    best_first = sorted(trails, key=lambda trail: -trail.best_value)
    different = {tuple(np.sort(t.best).tolist()): t for t in reversed(best_first)}
    ordered = sorted(different.values(), key=lambda trail: -trail.best_value)
    return ordered[: max(1, len(trails) // 2)]


@dataclasses.dataclass(frozen=True, eq=False)
class _TabuProblem:
    """Different candidates (C, k, n), copies (C,) of each, and what plans are judged by."""

    blocks: Array
    base: Array
    criterion: Criterion
    copies: Index

    @cached_property
    def has_copies(self) -> bool:
        """Whether a candidate may come beside an equal one."""
        return bool((self.copies > 1).any())

    def information(self, plan: Index) -> Array:
        """M (n, n)."""
        return self.base + information(self.blocks[plan])

    def near(self, m: Array, guide: Criterion, free: Index, size: int) -> Index:
        """The free candidates that raise the guide's supporting line most beside a plan."""
        k = self.blocks.shape[1]
        most = max(NEAR_ROWS // k, NEAR_PER_PLACE * size)
        candidates = np.flatnonzero(free > 0)
        if len(candidates) <= most:
            return candidates
        gains = variance_reduction(
            self.blocks, symmetric_inverse(m), guide.gradient_matrix(m)
        )
        order = np.argpartition(-gains[candidates], most)
        return candidates[order[:most]]


@dataclasses.dataclass(eq=False)
class _Trail:
    """A plan on its way.

    plan               (size,)
    best, best_value   the best plan so far, and its log phi
    free               (C,) copies of each candidate that are not in the plan
    rests_until        (C,) steps
    place_rests_until  (size,)
    near               candidates that it exchanges with
    max_rest           steps for which what changed rests, at the most
    taken              steps taken
    """

    plan: Index
    best: Index
    free: Index
    rests_until: Index
    place_rests_until: Index
    near: Index
    max_rest: int
    best_value: float = -np.inf
    taken: int = 0

    @classmethod
    def at(cls, start: Index, problem: _TabuProblem, max_rest: int) -> "_Trail":
        """A plan at its start."""
        free = problem.copies.copy()
        np.subtract.at(free, start, 1)
        rests = np.zeros(len(free), dtype=np.intp), np.zeros(len(start), dtype=np.intp)
        # half of the places, and of the candidates, may always change
        most = min(len(start), int(free.sum())) // 2
        max_rest = max(1, min(max_rest, most))
        return cls(start.copy(), start.copy(), free, *rests, start[:0], max_rest)

    def note(self, problem: _TabuProblem) -> Array:
        """The plan's information; the plan is kept where it is the best so far."""
        m = problem.information(self.plan)
        value = problem.criterion.value(m)
        if value > self.best_value + MIN_GAIN:
            self.best = self.plan.copy()
            self.best_value = value
        return m

    def step(
        self, problem: _TabuProblem, guide: Criterion, rng: np.random.Generator
    ) -> None:
        """Takes the plan's best exchange."""
        m = self.note(problem)
        if self.taken % STEPS_NEAR == 0:
            self.near = problem.near(m, guide, self.free, len(self.plan))
        places = np.flatnonzero(self.place_rests_until <= self.taken)
        may_come = (self.rests_until[self.near] <= self.taken) & (
            self.free[self.near] > 0
        )
        others = self.near[may_come]
        self.taken += 1
        if not places.size or not others.size:
            return
        leaving = self.plan[places]
        blocks = problem.blocks
        values = guide.exchange_values(Pairs(m, blocks[leaving], blocks[others]))
        if problem.has_copies:
            # one in place of its row changes nothing, and would use up the step
            values[leaving[:, None] == others] = -np.inf
        first, second = divmod(int(values.argmax()), len(others))
        self._exchange(int(places[first]), int(others[second]), rng)

    def _exchange(self, position: int, block: int, rng: np.random.Generator) -> None:
        """Replaces one candidate; what changed rests."""
        removed = self.plan[position]
        until = self.taken + 1 + (self.max_rest * rng.random(2)).astype(np.intp)
        self.rests_until[removed], self.place_rests_until[position] = until
        self.plan[position] = block
        self.free[removed] += 1
        self.free[block] -= 1
