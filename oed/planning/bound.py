"""No plan within the budget is better than this: a bound over all combinations of
measurements.

Whatever the order of its stages, a plan that mounts the options T and reads candidates
i of them, at most N_s of each (the highest of its numbers of readings), leaves at most
the information L = L0 + sum_(s in T) S_s about the machine, with the set-ups' own
unknowns profiled out,

    S_s = min over G of  sum_(i in s) w_i (x_i - z_i G)^T (x_i - z_i G) + G^T G,

x_i, z_i the rows' parts on machine and set-up (prior variances of 1). So any G bounds
S_s by something linear in w, and with a supporting line of the criterion at any L, log
phi(L') <= v + log <R R^T, L'>,

    phi(T) <= exp(v) ( <R R^T, L0> + min over prices l >= 0 of  l (B - sum_T mounting_s)
                       + sum_(s in T) [ |G_s R|^2 + sum_(N_s largest i in s) max(0, |(x_i - z_i G_s) R|^2 - l c_i) ] ).

A machine that is out of the travel of every reading of every option in T stays as it
is, whatever is mounted first: it gives no reading, so that nothing is told, so that the
next option can not follow it either. Their share bounds phi(T) from below, by drawn
machines (`_never_read`).

One line bounds all combinations at once. The one with the highest bound is solved
exactly as a relaxation (all its readings' best weights within the time left), which
draws a new line, tight there; until no combination can be better than wanted. Other
losses of readings, and what linearisation cuts off, only make plans worse and are left
out.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.design import relaxation
from oed.design.certificate import ROUNDING
from oed.design.criterion import Criterion
from oed.planning.goal import Goal
from oed.planning.option import Option
from oed.planning.travel import available_at_most, own_columns, within

#: combinations that are bounded one by one; beyond, only the best ones of each line are
COMBINATIONS = 200_000
#: prices at which time is tried, as shares of the highest worth a candidate has for its
#: time
PRICES = np.append(0.0, np.geomspace(1e-5, 1.0, 40))
#: combinations that are told as hopeful
HOPEFUL = 4
#: machines drawn to tell which no reading can follow
MACHINES = 4000
#: gap in log phi of a combination's relaxation
TOLERANCE = 3e-3
#: relaxations in which the prices of a reading are settled that keep each option's
#: number, and what they may miss it by
SETTLE, MISS = 6, 0.02


@dataclasses.dataclass(frozen=True)
class Bounded:
    """No plan has a smaller goal value than `value`. `lines` were drawn; `closed` where
    it is good enough.

    hopeful: combinations that may hold a better plan, the likeliest first, as {option:
    relaxed number of readings}
    """

    value: float
    lines: int
    closed: bool
    hopeful: tuple[dict[int, float], ...] = ()


def bound(
    options: Sequence[Option], goal: Goal, held: Array, budget: float, most: int, known: float, loss: float = 0.05,
    lines: int = 150,
) -> Bounded:  # fmt: skip
    """A lower bound of the goal's value over all plans of at most `most` options within
    `budget` seconds, good enough to tell that the plan with value `known` is within a
    share `loss` of the best, if `lines` lines suffice.

    held (n, n): information about the machine before.
    """
    parts = tuple(_BoundPart.of(o, len(held)) for o in options)
    mounting = np.array([o.mounting for o in options])
    combinations = _combinations(mounting, budget, most)
    if not len(combinations):
        return Bounded(np.inf, 0, True)
    target = -2.0 * math.log(known) + 2.0 * math.log1p(loss)
    problem = _BoundProblem(parts, mounting, goal, held, budget)
    above = -2.0 * np.log(_never_read(options, goal, held, combinations))
    relaxed: dict[int, dict[int, float]] = {}
    drawn = 0
    while drawn < lines:
        best = int(np.argmax(above))
        if above[best] <= target:
            break
        weights = problem.solved([s for s in combinations[best] if s >= 0])
        relaxed[best] = {int(s): float(w.sum()) for s, w in weights.items()}
        line = problem.bounds(combinations, weights)
        stuck = line[best] >= above[best] - 1e-9
        above = np.minimum(above, line)
        drawn += 1
        if stuck:  # the relaxation's own tolerance is reached: this is its best bound
            break
    highest = float(above.max())
    better = [k for k in relaxed if above[k] > -2.0 * math.log(known)]
    hopeful = tuple(
        relaxed[k] for k in sorted(better, key=lambda k: -above[k])[:HOPEFUL]
    )
    return Bounded(math.exp(-0.5 * highest), drawn, highest <= target, hopeful)


def _never_read(
    options: Sequence[Option], goal: Goal, held: Array, combinations: Index
) -> Array:
    """Goal value (T,) at the least, by the machines that no reading of a combination
    can follow; 0 where all can.

    Estimated from drawn machines and lowered by four of its standard errors.
    """
    rng, n = np.random.default_rng(19), len(held)
    errors = (
        rng.standard_normal((MACHINES, n)) @ np.linalg.cholesky(np.linalg.inv(held)).T
    )
    out = np.zeros((len(options) + 1, MACHINES), dtype=bool)
    out[-1] = True  # stands for no option
    for k, o in enumerate(options):
        if o.travel is not None:
            own = rng.standard_normal((MACHINES, own_columns(o)))
            out[k] = ~within(o, np.arange(len(o.candidates)), errors, own).any(axis=1)
    squares = np.stack(
        [np.sum((errors @ f.T) ** 2, axis=1) for f in goal.factors], axis=1
    )
    least = np.zeros(len(combinations))
    for part in np.array_split(
        np.arange(len(combinations)), max(len(combinations) // 1000, 1)
    ):
        left = out[combinations[part]].all(axis=1).astype(float)
        mean = left @ squares / MACHINES
        error = np.sqrt(
            np.maximum(left @ squares**2 / MACHINES - mean**2, 0.0) / MACHINES
        )
        told = np.sqrt(np.maximum(mean - 4.0 * error, 0.0))
        least[part] = (
            told.max(axis=1) if goal.wanted else np.sqrt(np.mean(told**2, axis=1))
        )
    return np.maximum(least, 1e-300)


def _combinations(mounting: Array, budget: float, most: int) -> Index:
    """Combinations (T, most) of options that the budget mounts, filled up with -1.

    Raises ValueError where there are too many.
    """
    count = len(mounting)
    most = min(most, count)
    total = sum(math.comb(count, k) for k in range(1, most + 1))
    if total > COMBINATIONS:
        raise ValueError(
            f"{total} combinations of {most} of {count} measurements are too many to"
            " bound"
        )
    rows = []
    for size in range(1, most + 1):
        table = np.array(
            list(itertools.combinations(range(count), size)), dtype=np.intp
        )
        table = table[mounting[table].sum(axis=1) < budget]
        rows.append(np.pad(table, ((0, 0), (0, most - size)), constant_values=-1))
    return np.concatenate(rows)


@dataclasses.dataclass(frozen=True, eq=False)
class _BoundPart:
    """An option's rows on the machine (C, k, n) and on its own unknowns (C, k, r),
    times (C,), and the most readings that it takes.
    """

    machine: Array
    own: Array
    cost: Array
    most: int

    @property
    def longest(self) -> float:
        """Time that its readings can take at the most."""
        return float(np.sort(self.cost)[-self.most :].sum())

    def worth(self, gain: Array, prices: Array) -> Array:
        """Best sum (P,) of gains (C,) less what the time costs, at each price, of no
        more than `most` candidates.
        """
        left = np.maximum(gain - prices[:, None] * self.cost, 0.0)
        if self.most < left.shape[1]:
            left = np.partition(left, -self.most, axis=1)[:, -self.most :]
        return np.asarray(left.sum(axis=1))

    @classmethod
    def of(cls, option: Option, n: int) -> _BoundPart:
        """Readings are lost, at the least, to what the set-up's own unknowns do within
        the travel.
        """
        chances = available_at_most(option, np.zeros((n, n)))
        blocks = option.candidates.blocks * np.sqrt(chances)[:, None, None]
        return cls(
            blocks[:, :, :n], blocks[:, :, n:], option.seconds, option.counts[-1]
        )

    def profile(self, weights: Array) -> Array:
        """G (r, n) that attains the minimum at weights (C,)."""
        own = np.einsum("c,ckr,cks->rs", weights, self.own, self.own, optimize=True)
        side = np.einsum(
            "c,ckr,ckn->rn", weights, self.own, self.machine, optimize=True
        )
        return np.asarray(np.linalg.solve(own + np.eye(len(own)), side))

    def information(self, weights: Array, profile: Array) -> Array:
        """S (n, n) at weights and a profile."""
        rest = (self.machine - self.own @ profile) * np.sqrt(weights)[:, None, None]
        flat = rest.reshape(-1, rest.shape[2])
        return np.asarray(flat.T @ flat + profile.T @ profile)


@dataclasses.dataclass(frozen=True, eq=False)
class _BoundProblem:
    parts: tuple[_BoundPart, ...]
    mounting: Array
    goal: Goal
    held: Array
    budget: float

    def solved(self, some: Sequence[int]) -> dict[int, Array]:
        """The best weights of a combination's readings within the time that its
        mounting leaves.
        """
        n = len(self.held)
        extra = [self.parts[s].own.shape[2] for s in some]
        wide, k = n + sum(extra), max(self.parts[s].machine.shape[1] for s in some)
        rows, start = [], n
        for s, more in zip(some, extra, strict=True):
            part = self.parts[s]
            block = np.zeros((len(part.cost), k, wide))
            block[:, : part.machine.shape[1], :n] = part.machine
            block[:, : part.machine.shape[1], start : start + more] = part.own
            rows.append(block)
            start += more
        base = np.eye(wide)
        base[:n, :n] = self.held
        time = self.budget - float(self.mounting[list(some)].sum())
        found = self._settled(some, np.concatenate(rows), base, time)
        ends = np.cumsum([len(self.parts[s].cost) for s in some])[:-1]
        return dict(zip(some, np.split(found, ends), strict=True))

    def _settled(
        self, some: Sequence[int], rows: Array, base: Array, time: float
    ) -> Array:
        """Best weights of all candidates of a combination within the time and each
        option's number of readings.

        One price for everything: time, and beside it `extra` seconds for each reading
        of an option whose number would be exceeded, until none is.
        """
        parts = [self.parts[s] for s in some]
        owner = np.repeat(np.arange(len(parts)), [len(p.cost) for p in parts])
        own_cost = np.concatenate([p.cost for p in parts])
        most, mean = (
            np.array([p.most for p in parts]),
            np.array([p.cost.mean() for p in parts]),
        )
        time = min(time, sum(p.longest for p in parts))
        criterion = _last_smooth(self.goal.criterion(rows.shape[2] - len(self.held)))
        price = mean
        for _ in range(SETTLE):
            cost = own_cost + (price - mean)[owner]
            total = min(time + float((price - mean) @ most), float(cost.sum()))
            scaled = rows / np.sqrt(cost)[:, None, None]
            found = np.asarray(
                relaxation.relax(
                    scaled, total, base, cost, TOLERANCE, criterion
                ).weights
                / cost
            )
            used = np.bincount(owner, found)
            if (used <= most * (1.0 + MISS)).all():
                break
            price = np.maximum(mean, price * used / most)
        return found

    def bounds(self, combinations: Index, weights: dict[int, Array]) -> Array:
        """Bound (T,) of log phi of every combination, by the line at the weights of
        one.
        """
        profiles = [
            p.profile(weights.get(s, np.full(len(p.cost), 0.5)))
            for s, p in enumerate(self.parts)
        ]
        m = self.held + sum(
            self.parts[s].information(w, profiles[s]) for s, w in weights.items()
        )
        value, root = self._line(np.asarray(m))
        gains = [
            np.sum(((p.machine - p.own @ g) @ root) ** 2, axis=(1, 2))
            for p, g in zip(self.parts, profiles, strict=True)
        ]
        prices = PRICES * max(
            float((g / p.cost).max()) for g, p in zip(gains, self.parts, strict=True)
        )
        worth = np.array([
            p.worth(g, prices) + float(np.sum((profile @ root) ** 2)) - prices * mount
            for g, p, profile, mount in zip(gains, self.parts, profiles, self.mounting, strict=True)
        ])  # fmt: skip
        worth = np.vstack(
            [worth, np.zeros(len(prices))]
        )  # the last row stands for no option
        carried = (worth[combinations].sum(axis=1) + prices * self.budget).min(axis=1)
        held = float(np.sum((self.held @ root) * root))
        return np.asarray(value + np.log(held + carried) + ROUNDING)

    def _line(self, m: Array) -> tuple[float, Array]:
        told = _last_smooth(self.goal.criterion(0)).support(m)
        return told.value, told.root


def _last_smooth(criterion: Criterion) -> Criterion:
    return [c for c in criterion.continuation() if c.smooth][-1]
