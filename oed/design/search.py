"""Iterated local search over plans: exchanges until none helps, then a part of the plan
thrown out and filled anew.

It runs over a pool of candidates that an optimal plan can want (the relaxation's slopes
tell which), and ends with one more improvement over all of them. It is never below the
greedy plans it starts from.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.design.judge import Judge
from oed.design.rules import Rules

#: candidates in the pool: at the least, and a chosen one
POOL, POOL_PER_READING = 200, 8
#: gain in log phi below which an exchange counts as none
GAIN = 1e-10
#: sweeps at the most: rounding near a singular plan could let two exchanges undo each
#: other for ever
SWEEPS = 50


def search(
    judge: Judge,
    rules: Rules,
    weights: Array,
    slopes: Array,
    starts: Sequence[Index],
    rng: np.random.Generator,
    rounds: int,
) -> Index:
    """The best plan found. weights, slopes (C,) are those of a relaxation; `starts` are
    plans to begin with.
    """
    pool = np.union1d(
        _pool(weights, slopes, rules, judge.count), np.concatenate(starts)
    )
    inner = _Search(judge.take(pool), rules.take(pool), rng)
    found = inner.local(
        weights[pool], rounds, [np.searchsorted(pool, s) for s in starts]
    )
    best = _Search(judge, rules, rng).climb(pool[found], judge.rungs - 1)
    return max([best, *starts], key=judge.value)


def greedy(judge: Judge, rules: Rules, ridge: float, rung: int = -1) -> Index:
    """Candidates taken one by one, each the one that raises the criterion most (a ridge
    stands in for the unseen).
    """
    chosen = np.zeros(0, dtype=np.intp)
    rung %= judge.rungs
    while (free := rules.allowed(chosen, judge.count)).any():
        value = np.where(free, judge.added(chosen, rung, ridge), -np.inf)
        best = (
            int(np.argmax(value))
            if np.isfinite(value).any()
            else int(np.flatnonzero(free)[0])
        )
        chosen = np.append(chosen, best)
    return chosen


def climb(
    judge: Judge, rules: Rules, chosen: Index, rung: int, sweeps: int = SWEEPS
) -> Index:
    """A plan after exchanges by one rung, at most `sweeps` rounds of them. Nothing
    random.
    """
    return _Search(judge, rules, np.random.default_rng(0)).climb(chosen, rung, sweeps)


def _pool(weights: Array, slopes: Array, rules: Rules, count: int) -> Index:
    per = slopes if rules.cost is None else slopes / np.maximum(rules.cost, 1e-300)
    size = rules.size or int((weights > 1e-6).sum())
    best = np.argsort(-per, kind="stable")[
        : min(count, max(POOL, POOL_PER_READING * size))
    ]
    heavy = np.argsort(-weights, kind="stable")[: max(POOL, POOL_PER_READING * size)]
    return np.union1d(best, heavy[weights[heavy] > 1e-9]).astype(np.intp)


@dataclasses.dataclass(frozen=True, eq=False)
class _Search:
    judge: Judge
    rules: Rules
    rng: np.random.Generator

    def local(self, weights: Array, rounds: int, starts: Sequence[Index]) -> Index:
        """The best of `rounds` improved plans: given and fresh ones first, then the
        best one shaken.
        """
        weights = weights + 1e-4 * weights.sum() / len(weights)
        best, value = np.zeros(0, dtype=np.intp), -np.inf
        fresh = max(1, min(5, rounds // 4))
        for k in range(-len(starts), rounds):
            start = (
                starts[k]
                if k < 0
                else self._rounded(weights)
                if k < fresh
                else self._shaken(best)
            )
            chosen = self.improve(start)
            reached = self.judge.value(chosen)
            if reached > value or not best.size:
                best, value = chosen, reached
        return best

    def _rounded(self, weights: Array) -> Index:
        """Different candidates drawn with chances that follow the relaxed weights
        (Gumbel's trick).
        """
        keys = np.log(weights) + self.rng.gumbel(size=len(weights))
        return self._filled(
            np.zeros(0, dtype=np.intp), np.argsort(-keys, kind="stable")
        )

    def _shaken(self, chosen: Index) -> Index:
        """The plan with two to six of its candidates, or all those of one set-up,
        replaced at random.
        """
        most = min(6, len(chosen))
        out = self.rng.choice(
            len(chosen),
            size=int(self.rng.integers(min(2, most), most + 1)),
            replace=False,
        )
        setup = self.rules.setup
        if setup is not None and not self.rules.simple and self.rng.random() < 0.3:
            out = np.flatnonzero(setup[chosen] == self.rng.choice(setup[chosen]))
        rest = np.delete(chosen, out)
        others = self.rng.permutation(np.setdiff1d(np.arange(self.judge.count), chosen))
        return self._filled(rest, np.append(others, self.rng.permutation(chosen[out])))

    def _filled(self, chosen: Index, order: Index) -> Index:
        """A plan filled with candidates in the given order while the rules allow."""
        if self.rules.simple:
            assert self.rules.size is not None
            return np.append(chosen, order[: self.rules.size - len(chosen)]).astype(
                np.intp
            )
        rank = np.full(self.judge.count, np.inf)
        rank[order] = np.arange(len(order))
        while (free := self.rules.allowed(chosen, self.judge.count)).any():
            nearest = int(np.argmin(np.where(free, rank, np.inf)))
            if not np.isfinite(rank[nearest]):
                break
            chosen = np.append(chosen, nearest)
        return chosen.astype(np.intp)

    def improve(self, chosen: Index) -> Index:
        """Exchanges until none helps, rung by rung."""
        for rung in range(self.judge.rungs):
            chosen = self.climb(chosen, rung)
        return chosen

    def climb(self, chosen: Index, rung: int, sweeps: int = SWEEPS) -> Index:
        """Exchanges until none helps, by one rung."""
        found = self.judge.quick(chosen, rung) if self.rules.simple else None
        if found is not None:
            return found
        for _ in range(sweeps):
            chosen, changed = self._sweep(chosen, rung)
            if not changed:
                break
        return chosen

    def _sweep(self, chosen: Index, rung: int) -> tuple[Index, bool]:
        """Each candidate in turn is taken out and the best one put in, then what still
        fits; tells any change.
        """
        changed = False
        chosen = chosen.copy()
        now = self.judge.held(chosen, rung)
        for place in range(len(chosen)):
            rest = np.delete(chosen, place)
            free = self.rules.allowed(rest, self.judge.count)
            value = np.where(free, self.judge.added(rest, rung), -np.inf)
            best = int(np.argmax(value))
            if value[best] > now + GAIN and best != chosen[place]:
                chosen[place], now, changed = best, float(value[best]), True
        if self.rules.simple:
            return chosen, changed
        filled = self._fill(chosen, rung)
        return filled, changed or len(filled) > len(chosen)

    def _fill(self, chosen: Index, rung: int) -> Index:
        while (free := self.rules.allowed(chosen, self.judge.count)).any():
            value = np.where(free, self.judge.added(chosen, rung), -np.inf)
            best = int(np.argmax(value))
            if not np.isfinite(value[best]):
                break
            chosen = np.append(chosen, best)
        return chosen
