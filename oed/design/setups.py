"""Which set-ups to mount: the relaxed value of each combination, greedily and by swaps.

A set-up brings unknowns of its own, so that its first readings tell nothing: an
exchange reading by reading never opens a new one. Here a combination of set-ups is
judged by the relaxation over all its readings (their best weights), which no plan with
these set-ups exceeds; set-ups are added while that helps, then swapped one for another.
Columns that none of the combination's candidates touch are left out, so that a
relaxation stays small however many set-ups there are.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np

from oed.arrays import Array, Index
from oed.design import relaxation
from oed.design.criterion import Criterion
from oed.design.rules import SUBSETS, Rules

#: gap in log phi at which combinations are compared; candidates of a set-up that are
#: looked at
TOLERANCE, THIN = 1e-2, 60
#: combinations kept for the exchange
KEPT = 3


def combinations(
    blocks: Array, criterion: Criterion, base: Array, rules: Rules
) -> list[tuple[int, ...]]:
    """Promising combinations of at most `rules.most_setups` set-ups, the best first.

    All of them where they are few (`oed.design.rules.SUBSETS`). Set-ups mounted already
    belong to each.
    """
    assert rules.setup is not None
    names = np.setdiff1d(rules.setup, np.array(rules.taken, dtype=np.intp))
    most = min(rules.most_setups or len(names), len(names))
    judge = _SetupJudge(blocks, criterion, base, rules)
    if math.comb(len(names), most) <= SUBSETS:
        every = sorted(
            itertools.combinations(map(int, names), most), key=judge, reverse=True
        )
        return every[:KEPT]
    best: tuple[int, ...] = ()
    for _ in range(most):
        grown = [tuple(sorted((*best, int(s)))) for s in names if s not in best]
        grown = [g for g in grown if np.isfinite(judge(g))] or grown
        best = max(grown, key=judge)
    best = _swapped(best, [int(s) for s in names], judge)
    return (
        sorted(judge.known, key=judge, reverse=True)[:KEPT] if judge.known else [best]
    )


def _swapped(
    best: tuple[int, ...], names: list[int], judge: Callable[[tuple[int, ...]], float]
) -> tuple[int, ...]:
    """The combination after swaps of one set-up, until none helps."""
    improved = True
    while improved:
        improved = False
        for out in best:
            ways = [
                tuple(sorted((*(s for s in best if s != out), new)))
                for new in names
                if new not in best
            ]
            found = max(ways, key=judge, default=best)
            if judge(found) > judge(best) + TOLERANCE:
                best, improved = found, True
                break
    return best


@dataclasses.dataclass(frozen=True, eq=False)
class _SetupJudge:
    """Relaxed value of a combination of set-ups, remembered."""

    blocks: Array
    criterion: Criterion
    base: Array
    rules: Rules
    known: dict[tuple[int, ...], float] = dataclasses.field(default_factory=dict)

    def __call__(self, some: tuple[int, ...]) -> float:
        if some not in self.known:
            self.known[some] = self._value(some)
        return self.known[some]

    def _value(self, some: tuple[int, ...]) -> float:
        assert self.rules.setup is not None
        chosen = thinned(self.rules, some)
        blocks, base, criterion = touched(
            self.blocks[chosen], self.base, self.criterion
        )
        scale = len(chosen) / int(
            np.isin(self.rules.setup, [*some, *self.rules.taken]).sum()
        )
        values = []
        for pool, total, cost in dataclasses.replace(
            self.rules.take(chosen), most_setups=None
        ).limits(len(chosen)):
            scaled = (
                blocks[pool]
                if cost is None
                else blocks[pool] / np.sqrt(cost)[:, None, None]
            )
            # a thinned candidate stands for its neighbours: it may be taken as often as
            # there are of them
            cap = (1.0 if cost is None else cost) / scale
            try:
                found = relaxation.relax(scaled, total, base, cap, TOLERANCE, criterion)
            except (ValueError, np.linalg.LinAlgError):
                return -np.inf
            values.append(found.value)
        return min(values, default=-np.inf)


def thinned(rules: Rules, some: tuple[int, ...]) -> Index:
    """Candidates of a combination of set-ups and those mounted, each thinned evenly to
    about `THIN`.
    """
    assert rules.setup is not None
    kept = []
    for s in (*some, *rules.taken):
        mine = np.flatnonzero(rules.setup == s)
        kept.append(mine[:: max(1, len(mine) // THIN)])
    return np.sort(np.concatenate(kept)).astype(np.intp)


def touched(
    blocks: Array, base: Array, criterion: Criterion
) -> tuple[Array, Array, Criterion]:
    """The same problem without the columns that no block touches and the information
    held does not couple.
    """
    alone = ~blocks.any(axis=(0, 1)) & (np.count_nonzero(base, axis=0) <= 1)
    if not alone.any():
        return blocks, base, criterion
    basis = np.eye(base.shape[0])[:, ~alone]
    return (
        np.ascontiguousarray(blocks[:, :, ~alone]),
        base[np.ix_(~alone, ~alone)],
        criterion.within(basis),
    )
