"""Choice of runs that separate wanted effects: payload, direction, feed, tool, time.

Each ordered pair of a wanted effect and a rival gives targets: combinations of the
effect's coefficients at their prior sizes, to be separated from the rival with the
parameters profiled out. The least lambda_{k|j} over all targets is maximised,
compounded with D so that the parameters stay identifiable
(`oed.gap.before.separation`). Candidates are whole runs, each under one condition and
at a cost. The plan comes from greedy starts and exchanges (`oed.design.search`), and a
relaxation to weights between 0 and 1 bounds every plan (`oed.design.relaxation`).
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np

from oed.arrays import Array, Index
from oed.design import relaxation
from oed.design.relaxation import Relaxation
from oed.design.rules import Rules
from oed.design.search import search, select_greedily
from oed.gap.before.pool import PairSeparation, Pool
from oed.gap.before.separation import SHARP, Separation, SeparationJudge

#: share of D in the compound
SHARE = 0.1
#: plans up to which all of them are tried, so that the best is proven
ENUMERATED = 20_000
#: plans that are computed at once
CHUNK = 256
#: times that targets may join a search
JOINS = 4
#: gap of the relaxation that is good enough, in log lambda
GAP = 1e-3


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunChoice:
    """Chosen runs.

    runs          (n,) numbers of the candidates, ascending
    separation    least sqrt(lambda_k|j) over all targets
    bound         of the separation: no plan under the rules exceeds it
    pairs         every pair and combination, ascending by separation
    value         of the compound, in logs
    above         bound of the value: no plan's exceeds it
    volume        log det of the parameters' information with their prior
    seconds       that the runs take, set-ups included, where costs are known
    proven        all plans were tried: separation and value belong to the best
    """

    runs: Index
    separation: float
    bound: float
    pairs: tuple[PairSeparation, ...]
    value: float
    above: float
    volume: float
    seconds: float
    proven: bool

    @property
    def efficiency(self) -> float:
        """exp(value - above), at most 1."""
        return float(np.exp(min(self.value - self.above, 0.0)))


@dataclasses.dataclass(frozen=True)
class _BoundedPlan:
    """A plan and its bounds.

    runs         numbers of the candidates
    above        bound of the compound
    log_least    bound of the least log lambda
    """

    runs: Index
    above: float
    log_least: float


def choose(
    pool: Pool,
    rules: Rules,
    rng: np.random.Generator,
    *,
    share: float = SHARE,
    fixed: Index | None = None,
    rounds: int = 12,
) -> RunChoice:
    """Choose runs of the pool under the rules, in addition to those that are `fixed`.

    rules     number of runs, or a budget; set-ups
    share     of D in the compound: 0 only separates effects, 1 is D alone
    fixed     runs that are part of any plan
    rounds    of the search

    Raises ValueError where the rules allow no run, or the share is not from 0 to 1.
    """
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"the share of D must lie between 0 and 1, not {share:g}")
    fixed = np.empty(0, dtype=np.intp) if fixed is None else fixed
    count = len(pool.rows)
    free = count - len(fixed)
    if rules.size is not None and not 0 < rules.size <= free:
        raise ValueError(
            f"cannot choose {rules.size} different runs out of {free} candidates"
        )
    if not rules.additions(np.empty(0, dtype=np.intp), count).any():
        raise ValueError(
            "the rules allow no run at all: raise the number of runs or the budget"
        )
    if rules.only_size and rules.size is not None:
        few = math.comb(free, rules.size) <= ENUMERATED
        if few:
            plan = _enumerate(pool, rules.size, share, fixed)
            return _choice(pool, plan, fixed, share, rules, proven=True)
    plan = _search(pool, rules, rng, share, fixed, rounds)
    return _choice(pool, plan, fixed, share, rules, proven=False)


def _choice(
    pool: Pool,
    plan: _BoundedPlan,
    fixed: Index,
    share: float,
    rules: Rules,
    *,
    proven: bool,
) -> RunChoice:
    """Figures of a plan together with the fixed runs."""
    runs = np.sort(np.concatenate([plan.runs, fixed]))
    separation = pool.all_targets(share)
    pairs = pool.pair_separations(runs)
    least = pairs[0].separation
    shift = share * pool.log_scale / separation.size
    return RunChoice(
        runs=runs,
        separation=least,
        bound=max(float(np.exp(0.5 * plan.log_least)), least),
        pairs=pairs,
        value=float(separation.worth(separation.of(runs))) + shift,
        above=plan.above + shift,
        volume=pool.volume(runs),
        seconds=rules.time_of(plan.runs) if rules.cost is not None else 0.0,
        proven=proven,
    )


def _enumerate(pool: Pool, size: int, share: float, fixed: Index) -> _BoundedPlan:
    """The best of all plans."""
    free = np.setdiff1d(np.arange(len(pool.rows)), fixed)
    places = list(itertools.combinations(range(len(free)), size))
    plans = free[np.array(places, dtype=np.intp)]
    separation = pool.all_targets(share, fixed)
    values, log_least = [], []
    for chunk in np.array_split(plans, -(-len(plans) // CHUNK)):
        m = separation.base + pool.grams[chunk].sum(axis=1)
        values.append(separation.worth(m))
        log_least.append(np.log(separation.lambdas(m).min(axis=0)))
    value = np.concatenate(values)
    best = int(np.argmax(value))
    largest = float(np.concatenate(log_least).max())
    return _BoundedPlan(plans[best], float(value[best]), largest)


def _search(
    pool: Pool,
    rules: Rules,
    rng: np.random.Generator,
    share: float,
    fixed: Index,
    rounds: int,
) -> _BoundedPlan:
    """The best plan that the search reaches, with bounds of every plan.

    The targets whose constants absorb most lead it; others join while a plan shows them
    to be worse.
    """
    count = len(pool.rows)
    free = np.setdiff1d(np.arange(count), fixed)
    targets, inner = pool.hardest(np.arange(count)), rules.subset(free)
    for _ in range(JOINS):
        separation = pool.separation(targets, share, fixed).subset(free)
        relaxed = _relax(separation, inner)
        judge = SeparationJudge(separation)
        starts = [select_greedily(judge, inner, 0.0, level) for level in (0, 1)]
        gains = np.maximum(relaxed.slopes, 0.0)
        selected = search(judge, inner, relaxed.weights, gains, starts, rng, rounds)
        runs = free[selected]
        hardest = pool.hardest(np.concatenate([runs, fixed]))
        joined = sorted(set(targets) | set(hardest))
        if joined == targets:
            break
        targets = joined
    alone = pool.separation(targets, 0.0, fixed).subset(free)
    return _BoundedPlan(runs, relaxed.bound, _relax(alone, inner).bound)


def _relax(separation: Separation, rules: Rules) -> Relaxation:
    """The relaxation's weights and bound.

    Under the number of runs or the budget, whichever is tighter.
    """
    best: Relaxation | None = None
    for total, cost in rules.totals(separation.count):
        per = np.ones(separation.count) if cost is None else cost
        relaxed = _relax_under(separation, total, per)
        if best is None or relaxed.bound < best.bound:
            best = relaxed
    assert best is not None
    return best


def _relax_under(separation: Separation, total: float, per: Array) -> Relaxation:
    """The relaxation under one total of costs (C,), ever more sharply."""
    grams = separation.grams / per[:, None, None]
    scaled = dataclasses.replace(separation, grams=grams)
    log_count = math.log(max(len(separation.targets), 1))
    relaxed: Relaxation | None = None
    for sharp in SHARP:
        step = dataclasses.replace(scaled, sharp=sharp)
        slack = GAP + log_count / sharp  # the smoothed minimum is off by as much
        start = None if relaxed is None else relaxed.weights
        sharper = relaxation.solve(step, total, per, slack, start)
        if relaxed is not None:
            bound = min(sharper.bound, relaxed.bound)
            sharper = dataclasses.replace(sharper, bound=bound)
        relaxed = sharper
    assert relaxed is not None
    return dataclasses.replace(relaxed, weights=relaxed.weights / per)
