"""Tabu search for D-optimal plans of blocks, from starts of several kinds.

Each plan takes the exchange of blocks with the largest determinant (`oed.design.block_exchange`), even
where it lowers it. The block that leaves, and the place that is filled, rest for a few
steps (Glover 1989, ORSA J. Comput. 1, 190-206). Stage by stage, the half of the plans that has come
less far is given up.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Index
from oed.design.block_exchange import log_gains
from oed.design.blocks import information

#: plans that are searched at first
TABU_PLANS = 16
#: steps for each that is asked for: blocks have more local optima than single rows
STEP_FACTOR = 2
#: most steps for which a block, or a place, rests
MAX_REST = 3
#: places times candidates times numbers of a block's products, at the most
MAX_PRODUCTS = 500_000
#: taken off the gain in log det where a block or a place rests: more than any gain
RESTING_PENALTY = 1e6
#: gain of blocks that are in the plan: below that of resting ones
IN_PLAN_GAIN = -1e7
#: gain in log det below which a plan counts as no better
MIN_GAIN = 1e-9


def search_plans(
    blocks: Array, starts: Index, base: Array, steps: int, rng: np.random.Generator
) -> Index:
    """The best plan (size,) that the plans `starts` (plans, size) pass in their steps.

    blocks  (C, k, n)
    base    (n, n) positive definite prior information, a small ridge at the least
    steps   of all plans together, about
    """
    plans = starts[:TABU_PLANS].copy()
    # the relaxation draws some starts too near to one another: others are drawn evenly
    for k in range(TABU_PLANS // 2, len(plans)):
        plans[k] = rng.permutation(len(blocks))[: plans.shape[1]]
    trails = [_Trail.at(plan, len(blocks)) for plan in plans]
    each = max(1, STEP_FACTOR * steps // (2 * len(trails)))
    while True:
        for trail in trails:
            for _ in range(each):
                trail.step(blocks, base, rng)
        if len(trails) == 1:
            return trails[0].best
        trails = _better_half(trails)


def _better_half(trails: list[_Trail]) -> list[_Trail]:
    """The half with the better plans; of those that passed the same plan, one."""
    best_first = sorted(trails, key=lambda trail: -trail.best_value)
    different = {tuple(np.sort(t.best).tolist()): t for t in reversed(best_first)}
    ordered = sorted(different.values(), key=lambda trail: -trail.best_value)
    return ordered[: max(1, len(trails) // 2)]


@dataclasses.dataclass(eq=False)
class _Trail:
    """A plan on its way.

    plan               (size,)
    best, best_value   the best plan so far, and its log det
    block_rests_until  (C,) steps
    place_rests_until  (size,)
    taken              steps taken
    """

    plan: Index
    best: Index
    block_rests_until: Index
    place_rests_until: Index
    best_value: float = -np.inf
    taken: int = 0

    @classmethod
    def at(cls, start: Index, count: int) -> _Trail:
        """A plan at its start."""
        rests = np.zeros(count, dtype=np.intp), np.zeros(len(start), dtype=np.intp)
        return cls(start.copy(), start.copy(), *rests)

    def step(self, blocks: Array, base: Array, rng: np.random.Generator) -> None:
        """Notes the plan where it is the best so far, and takes its best exchange."""
        m = base + information(blocks[self.plan])
        value = float(np.linalg.slogdet(m)[1])
        if value > self.best_value + MIN_GAIN:
            self.best, self.best_value = self.plan.copy(), value
        gains = log_gains(blocks, self.plan, m)
        gains -= np.where(self.block_rests_until > self.taken, RESTING_PENALTY, 0.0)
        resting = np.where(self.place_rests_until > self.taken, RESTING_PENALTY, 0.0)
        gains -= resting[:, None]
        gains[:, self.plan] = IN_PLAN_GAIN
        position, block = divmod(int(gains.argmax()), len(blocks))
        until = self.taken + 2 + (MAX_REST * rng.random(2)).astype(np.intp)
        self.block_rests_until[self.plan[position]] = until[0]
        self.place_rests_until[position] = until[1]
        self.plan[position] = block
        self.taken += 1
