"""Which set-ups to mount: combinations ranked by their relaxed value.

A set-up brings unknowns of its own, so its first readings determine nothing: exchanges
of single readings never open a new set-up. Here a combination of set-ups is valued by
the relaxation over all its readings, which no plan with these set-ups exceeds. Set-ups
are added while that helps, then exchanged one for another. Columns that no candidate of
a combination touches are left out, so that each relaxation stays small.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np

from oed.base import Array, Index
from oed.design import relaxation
from oed.design.forms import Criterion
from oed.design.plan_limits import SetupLimit
from oed.design.rules import MAX_COMBINATIONS, RelaxedRules, Rules

#: duality gap in log phi at which combinations are compared
TOLERANCE = 1e-2
#: candidates of a set-up that are looked at, about
PER_SETUP = 60
#: combinations that are returned, at the most
BEST = 3

Combination = tuple[int, ...]


def rank_combinations(
    blocks: Array, criterion: Criterion, base: Array, rules: Rules, setups: SetupLimit
) -> list[Combination]:
    """Promising combinations of at most `setups.most` set-ups, the best first.

    `setups` stands for the set-ups of the rules. All combinations are ranked where they
    are few (`MAX_COMBINATIONS`). Mounted set-ups belong to each.
    """
    names = [int(name) for name in setups.mountable]
    most = setups.most_of(len(names))
    values = _CombinationValues(blocks, criterion, base, rules, setups)
    if math.comb(len(names), most) <= MAX_COMBINATIONS:
        combinations = itertools.combinations(names, most)
        return sorted(combinations, key=values.of, reverse=True)[:BEST]
    best: Combination = ()
    for _ in range(most):
        grown = [tuple(sorted((*best, s))) for s in names if s not in best]
        determined = [g for g in grown if np.isfinite(values.of(g))]
        best = max(determined or grown, key=values.of)
    best = _exchange_setups(best, names, values)
    if not values.known:
        return [best]
    return sorted(values.known, key=values.of, reverse=True)[:BEST]


def _exchange_setups(
    best: Combination, names: list[int], values: _CombinationValues
) -> Combination:
    """The combination after exchanges of one set-up, until none helps."""
    improved = True
    while improved:
        improved = False
        for removed in best:
            remaining = [s for s in best if s != removed]
            exchanged = [
                tuple(sorted((*remaining, new))) for new in names if new not in best
            ]
            candidate = max(exchanged, key=values.of, default=best)
            if values.of(candidate) > values.of(best) + TOLERANCE:
                best, improved = candidate, True
                break
    return best


@dataclasses.dataclass(frozen=True, eq=False)
class _CombinationValues:
    """Relaxed values of combinations of set-ups; each is computed once."""

    blocks: Array
    criterion: Criterion
    base: Array
    rules: Rules
    setups: SetupLimit
    known: dict[Combination, float] = dataclasses.field(default_factory=dict)

    def of(self, combination: Combination) -> float:
        """log phi of the relaxation; -inf where a direction is undetermined."""
        if combination not in self.known:
            self.known[combination] = self._relaxed_value(combination)
        return self.known[combination]

    def _relaxed_value(self, combination: Combination) -> float:
        chosen = thin(self.setups, combination)
        blocks, base, criterion = drop_untouched_columns(
            self.blocks[chosen], self.base, self.criterion
        )
        mounted = [*combination, *self.setups.mounted]
        available = int(np.isin(self.setups.setup, mounted).sum())
        thinning = len(chosen) / available
        rules = self.rules.with_any_number_of(self.setups).subset(chosen)
        values = []
        for problem in rules.relaxations(len(chosen)):
            try:
                value = _relax(blocks, base, criterion, problem, thinning)
            except (ValueError, np.linalg.LinAlgError):
                return -np.inf
            values.append(value)
        return min(values, default=-np.inf)


def _relax(
    blocks: Array,
    base: Array,
    criterion: Criterion,
    problem: RelaxedRules,
    thinning: float,
) -> float:
    """Value of one relaxation.

    A candidate of a thinned set stands for its neighbours as well: its weight may be as
    large as there are of them.
    """
    pool, total, cost = problem
    if cost is None:
        scaled = blocks[pool]
        cap: Array | float = 1.0 / thinning
    else:
        scaled = blocks[pool] / np.sqrt(cost)[:, None, None]
        cap = cost / thinning
    optimum = relaxation.relax(scaled, total, base, cap, TOLERANCE, criterion)
    return optimum.value


def thin(setups: SetupLimit, combination: Combination) -> Index:
    """Candidates of a combination and of the mounted set-ups, each thinned evenly."""
    thinned = []
    for setup in (*combination, *setups.mounted):
        members = np.flatnonzero(setups.setup == setup)
        thinned.append(members[:: max(1, len(members) // PER_SETUP)])
    return np.sort(np.concatenate(thinned)).astype(np.intp)


def drop_untouched_columns(
    blocks: Array, base: Array, criterion: Criterion
) -> tuple[Array, Array, Criterion]:
    """The same problem without columns that no block touches.

    A column that the prior information couples to another one stays.
    """
    uncoupled = np.count_nonzero(base, axis=0) <= 1
    untouched = ~blocks.any(axis=(0, 1)) & uncoupled
    if not untouched.any():
        return blocks, base, criterion
    basis = np.eye(base.shape[0])[:, ~untouched]
    return (
        np.ascontiguousarray(blocks[:, :, ~untouched]),
        base[np.ix_(~untouched, ~untouched)],
        criterion.restrict(basis),
    )
