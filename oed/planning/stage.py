"""What a stage tells: readings chosen, taken as far as the instrument follows,
identified, compensated.

Before a stage the machine's parameters have covariance S (in tolerance units). Readings
that can be taken (`travel`) add information; the set-up's own unknowns are profiled
out,

    L' = L + M_mm - M_ms (1 + M_ss)^-1 M_sm.

A machine that is far off loses nearly all readings, and will lose those of the next
stage as well. So where readings may be lost machines are drawn, and each is carried on
with its own covariance and its own error (`known`). With d and s the errors of machine
and set-up before, S_j the joint covariance after, the readings' noise e leaves the
error

    d' = S_j ( diag(S^-1, 1) (d, s) - H^T e ).

What linearisation cuts off is estimated from the exact model, and profiled out as well
(`cut_off`).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Index, Mask
from oed.design.criterion import Criterion
from oed.design.criterion.protocol import inverse
from oed.design.evaluator import CriterionEvaluator
from oed.design.rules import Rules
from oed.design.search import improve, select_greedily
from oed.measurement import Series
from oed.planning import cut_off as cutting
from oed.planning import travel
from oed.planning.known import Known, known, roots
from oed.planning.option import Option

#: machines drawn to tell which readings are lost
DRAWS = 48
#: machines drawn for a first look
ROUGH = 12
#: machines drawn to tell what linearisation cuts off, at the most; for each pattern of
#: lost readings, at the least
CUT, CUT_LEAST = 96, 3
#: chance of being read beyond which no machines are drawn
CERTAIN = 0.999


@dataclasses.dataclass(frozen=True, eq=False)
class Stage:
    """One stage.

    option      the measurement;  chosen candidates of it
    seconds     time for mounting and reading
    available   (N,) probability that each chosen candidate can be read at all
    cut_off     (readings,) root mean square, SI, of what linearisation cuts off after
                the stage
    known       of the machine after it
    information (n, n) that it adds
    """

    option: Option
    chosen: Index
    seconds: float
    available: Array
    cut_off: Array
    known: Known
    information: Array

    @property
    def covariance(self) -> Array:
        """Mean square errors (n, n) of the machine's parameters after it, in tolerance
        units.
        """
        return self.known.square

    @property
    def series(self) -> tuple[Series, ...]:
        """The readings to take."""
        return self.option.taken(self.chosen)


def choose(
    option: Option,
    count: int,
    held: Array,
    criterion: Criterion,
    chances: Array,
    climbs: int = 1,
    seconds: float = np.inf,
) -> Index:
    """`count` candidates by greedy choice and exchange, each weighed with its chance of
    being read; as many as `seconds` pay for where their times differ.

    held (n, n) is the information about the machine's parameters before.
    """
    wide = option.candidates.blocks.shape[2]
    base = np.eye(wide)
    base[: len(held), : len(held)] = held
    worth = np.flatnonzero(chances > 1e-3)
    if len(worth) < count:
        worth = np.argsort(-chances, kind="stable")[:count]
    evaluator = CriterionEvaluator(
        option.candidates.blocks[worth] * np.sqrt(chances[worth])[:, None, None],
        criterion,
        base,
    )
    time = option.seconds[worth]
    if np.ptp(time) == 0.0:  # times that are all alike are paid for by the number
        rules, starts = Rules(size=count), []
    else:
        rules = Rules(size=count, budget=seconds, cost=time)
        starts = [_cheapest(time, count, seconds)]
    starts.append(select_greedily(evaluator, rules, 0.0, level=0))
    for level in range(evaluator.levels) if climbs else ():
        starts = [improve(evaluator, rules, s, level, climbs) for s in starts]
    found = max(starts, key=evaluator.value)
    return np.sort(
        worth[found]
        if len(found)
        else np.argsort(option.seconds, kind="stable")[:count]
    )


def _cheapest(time: Array, count: int, seconds: float) -> Index:
    """The quickest candidates, `count` at the most, within `seconds`."""
    order = np.argsort(time, kind="stable")[:count]
    return np.asarray(order[np.cumsum(time[order]) <= seconds], dtype=np.intp)


def told(
    option: Option,
    chosen: Index,
    before: Array | Known,
    rng: np.random.Generator,
    exact: bool = True,
    draws: int | None = None,
) -> Stage:
    """The stage that reads the chosen candidates of a machine of which `before` is
    known, or a covariance (n, n).

    `exact` = False draws few machines, and takes no cut-off; else `draws` where
    readings may be lost, and half as many to tell what is cut off.
    """
    chosen = np.sort(chosen)  # the order of their readings
    state = known(before)
    chances = travel.available(option, state)[chosen]
    draws = (draws or DRAWS) if exact else ROUGH
    machines = _machines(option, chosen, state, chances, draws, rng)
    blocks, cut = option.candidates.blocks[chosen], np.zeros(0)
    rows, owner = (
        blocks.reshape(-1, blocks.shape[2]),
        np.repeat(np.arange(len(chosen)), blocks.shape[1]),
    )
    gained = np.array([_gram(rows[p[owner] > 0.0]) for p in machines.patterns])
    if exact:
        left = machines.left(gained)
        each = max(min(draws // 2, CUT) // len(machines.patterns), CUT_LEAST)
        found = cutting.cut_off(
            option, chosen, left, machines.patterns, machines.which, each, rng
        )
        cut = found.rms
        if found.columns is not None:
            gained = _disturbed(
                option, chosen, machines.patterns, found.columns, np.isfinite(cut)
            )
    after = machines.after(gained, rng)
    seconds = option.mounting + float(option.seconds[chosen].sum())
    added = inverse(after.square) - inverse(state.square)
    return Stage(option, chosen, seconds, chances, cut, after, added)


@dataclasses.dataclass(frozen=True, eq=False)
class _Machines:
    """Machines before a stage: kinds (P, n, n), errors (P, n) with those of the set-up
    `own` (P, s), and losses.

    patterns (G, N) of candidates taken;  which (P,) of them each machine follows
    """

    kinds: Array
    errors: Array | None
    own: Array
    lost: Mask
    patterns: Array
    which: Index

    def prior(self, wide: int) -> Array:
        """Information (P, wide, wide) about parameters, and 1 about each other unknown."""
        n = self.kinds.shape[1]
        made = np.tile(np.eye(wide), (len(self.kinds), 1, 1))
        made[:, :n, :n] = np.linalg.inv(self.kinds)
        return made

    def left(self, gained: Array) -> Array:
        """Covariances (P, w, w) of all unknowns after information (G, w, w) of each
        pattern.
        """
        joint = np.linalg.inv(self.prior(gained.shape[1]) + gained[self.which])
        return np.asarray(0.5 * (joint + np.swapaxes(joint, 1, 2)))

    def after(self, gained: Array, rng: np.random.Generator) -> Known:
        """What is known after information (G, w, w) of each pattern."""
        n, wide, joint = self.kinds.shape[1], gained.shape[1], self.left(gained)
        kinds = joint[:, :n, :n]
        if self.errors is None:
            return Known(kinds, None, self.lost, np.asarray(kinds.mean(axis=0)))
        others = rng.standard_normal((len(kinds), wide - n))
        others[:, : self.own.shape[1]] = self.own
        before = np.einsum(
            "pnm,pm->pn", self.prior(wide), np.hstack([self.errors, others])
        )
        read = np.einsum(
            "pnm,pm->pn",
            roots(gained)[self.which],
            rng.standard_normal((len(kinds), wide)),
        )
        errors = np.einsum("pnm,pm->pn", joint[:, :n], before - read)
        # the mean over the noise, for a machine that has lost readings; one that has
        # not is as its covariance says
        far = np.einsum("pnm,pm->pn", joint[:, :n], before)
        noise = joint[:, :n] @ gained[self.which] @ np.swapaxes(joint[:, :n], 1, 2)
        square = np.where(
            self.lost[:, None, None], noise + far[:, :, None] * far[:, None], kinds
        )
        return Known(kinds, errors, self.lost, np.asarray(square.mean(axis=0)))


def _machines(
    option: Option,
    chosen: Index,
    state: Known,
    chances: Array,
    draws: int,
    rng: np.random.Generator,
) -> _Machines:
    """Those that are known, or, where readings may be lost, so many drawn from them."""
    extra = option.candidates.blocks.shape[2] - state.columns
    if option.travel is None or chances.min() >= CERTAIN:
        own = rng.standard_normal(
            (len(state.kinds) if state.errors is not None else 0, extra)
        )
        which = np.zeros(len(state.kinds), dtype=np.intp)
        return _Machines(
            state.kinds, state.errors, own, state.lost, np.ones((1, len(chosen))), which
        )
    kinds, errors, lost = state.drawn(max(draws // len(state.kinds), 1), rng)
    own = rng.standard_normal((len(kinds), extra))
    taken = travel.within(option, chosen, errors, own[:, : travel.own_columns(option)])
    patterns, which = np.unique(taken, axis=0, return_inverse=True)
    return _Machines(
        kinds,
        errors,
        own,
        lost | ~taken.all(axis=1),
        patterns.astype(float),
        which.ravel(),
    )


def _disturbed(
    option: Option, chosen: Index, patterns: Array, columns: Array, reached: Array
) -> Array:
    """Information (G, w + m, w + m) of each pattern with columns (G, readings, m) of
    what is cut off; readings that no machine reaches tell nothing.
    """
    rows = cutting.rows(option, chosen)
    owner = np.repeat(np.arange(len(chosen)), cutting.sizes(option, chosen))
    wide = [
        np.hstack([rows, c])[(p[owner] > 0.0) & reached]
        for p, c in zip(patterns, columns, strict=True)
    ]
    return np.array([_gram(w) for w in wide])


def _gram(rows: Array) -> Array:
    return np.asarray(rows.T @ rows)


def information(blocks: Array, shares: Array, columns: int) -> Array:
    """Information (n, n) about the machine, n = `columns`, of blocks (N, k, n + s) with
    shares (N,) of being read.
    """
    flat = (blocks * np.sqrt(shares)[:, None, None]).reshape(-1, blocks.shape[2])
    m = flat.T @ flat
    if blocks.shape[2] == columns:
        return np.asarray(m)
    own = m[columns:, columns:] + np.eye(blocks.shape[2] - columns)
    side = m[columns:, :columns]
    return np.asarray(m[:columns, :columns] - side.T @ np.linalg.solve(own, side))
