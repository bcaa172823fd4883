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
import functools
import itertools
import math

import numpy as np

from oed.base import Index
from oed.design import Rules
from oed.gap.before.separation import SHARP, Separation, SeparationEvaluator
from oed.result import SeparationRecord

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
    pairs: list[SeparationRecord]
    value: float
    above: float
    volume: float
    seconds: float
    proven: bool

    @property
    def efficiency(self) -> float:
        """exp(value - above), at most 1."""
        return float(np.exp(min(self.value - self.above, 0.0)))


def choose(
    everything: Separation,
    rules: Rules,
    rng: np.random.Generator,
    *,
    share: float = SHARE,
    fixed: Index | None = None,
    rounds: int = 12,
) -> RunChoice:
    """Choose runs of a pool (`oed.gap.before.runs`) in addition to the `fixed` ones.

    rules     number of runs, or a budget; set-ups
    share     of D in the compound: 0 only separates effects, 1 is D alone
    fixed     runs that are part of any plan
    rounds    of the search

    Raises ValueError where the rules allow no run, or the share is not from 0 to 1.
    """
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"the share of D must lie between 0 and 1, not {share:g}")
    fixed = np.empty(0, dtype=np.intp) if fixed is None else fixed
    count = everything.count
    free = np.setdiff1d(np.arange(count), fixed)
    if rules.size is not None and not 0 < rules.size <= len(free):
        raise ValueError(
            f"cannot choose {rules.size} different runs out of {len(free)} candidates"
        )
    if not rules.additions(np.empty(0, dtype=np.intp), count).any():
        raise ValueError(
            "the rules allow no run at all: raise the number of runs or the budget"
        )
    everything = dataclasses.replace(everything, share=share)
    rest = dataclasses.replace(everything, base=everything.of(fixed)).subset(free)
    size = rules.sole_size
    proven = size is not None and math.comb(len(free), size) <= ENUMERATED
    if size is not None and proven:
        selected, above, log_least = _enumerate(rest, size)
    else:
        selected, above, log_least = _search(rest, rules.subset(free), rng, rounds)
    runs = np.sort(np.concatenate([free[selected], fixed]))
    m, pairs = everything.of(runs), everything.pairs(runs)
    least = pairs[0].separation
    shift = share * everything.log_scale / everything.size
    return RunChoice(
        runs=runs,
        separation=least,
        bound=max(float(np.exp(0.5 * log_least)), least),
        pairs=pairs,
        value=float(everything.worth(m)) + shift,
        above=above + shift,
        volume=float(everything.log_det(m)) + everything.log_scale,
        seconds=rules.time_of(free[selected]),
        proven=proven,
    )


def _enumerate(separation: Separation, size: int) -> tuple[Index, float, float]:
    """The best of all plans, its compound, and the largest least log lambda of all."""
    places = itertools.combinations(range(separation.count), size)
    plans = np.array(list(places), dtype=np.intp)
    values, log_least = [], []
    for chunk in np.array_split(plans, -(-len(plans) // CHUNK)):
        m = separation.base + separation.grams[chunk].sum(axis=1)
        values.append(separation.worth(m))
        log_least.append(np.log(separation.lambdas(m).min(axis=0)))
    value = np.concatenate(values)
    best = int(np.argmax(value))
    return plans[best], float(value[best]), float(np.concatenate(log_least).max())


def _search(
    everything: Separation, rules: Rules, rng: np.random.Generator, rounds: int
) -> tuple[Index, float, float]:
    """The best plan that the search reaches, and bounds of every plan.

    The bounds are those of the compound and of the least log lambda. The targets whose
    constants absorb most lead the search; others join while a plan shows them to be
    worse.
    """
    count = everything.count
    numbers = everything.hardest(np.arange(count))
    for _ in range(JOINS):
        separation = everything.with_targets(numbers)
        slack = functools.partial(_slack, separation)
        relaxed = rules.relax(count, separation.smoothed, SHARP, slack)
        evaluator = SeparationEvaluator(separation)
        runs = rules.search(evaluator, relaxed, rng, rounds)
        joined = sorted({*numbers, *everything.hardest(runs)})
        if joined == numbers:
            break
        numbers = joined
    alone = dataclasses.replace(everything.with_targets(numbers), share=0.0)
    slack = functools.partial(_slack, alone)
    bound = rules.relax(count, alone.smoothed, SHARP, slack).bound
    return runs, relaxed.bound, bound


def _slack(separation: Separation, sharp: float) -> float:
    """Gap that is good enough: the smoothed minimum is off by the second part."""
    return GAP + math.log(len(separation.targets)) / sharp
