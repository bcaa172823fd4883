"""Selection of a stage's readings by greedy choice and exchange.

Each candidate's information is weighted with the probability that it is captured.
"""

from __future__ import annotations

import numpy as np

from oed.base import Array, Index
from oed.design import Criterion, Rules
from oed.planning.option import Option

#: capture probability below which a candidate is not worth a look
HOPELESS = 1e-3


def select_readings(
    option: Option,
    count: int,
    prior_information: Array,
    criterion: Criterion,
    probability: Array,
    sweeps: int = 1,
    seconds: float = np.inf,
) -> Index:
    """Select `count` candidates; fewer where `seconds` do not pay for them.

    prior_information  (n, n) about the machine's parameters
    probability        (C,) that each candidate is captured
    sweeps             exchange sweeps; 0: greedy choice alone
    """
    base = np.eye(option.unknowns)
    n = len(prior_information)
    base[:n, :n] = prior_information
    pool = np.flatnonzero(probability > HOPELESS)
    if len(pool) < count:
        pool = np.argsort(-probability, kind="stable")[:count]
    weights = np.sqrt(probability[pool])[:, None, None]
    blocks = option.candidates.blocks[pool] * weights
    time = option.candidate_seconds[pool]
    rules, starts = Rules.of(size=count), []
    if np.ptp(time) > 0.0:  # of equal readings the number limits the time
        rules = Rules.of(size=count, seconds=time, budget=seconds)
        starts.append(_shortest(time, count, seconds))
    best = rules.quick_plan(blocks, criterion, base, starts, sweeps)
    if not len(best):
        order = np.argsort(option.candidate_seconds, kind="stable")
        return np.sort(order[:count])
    return np.sort(pool[best])


def _shortest(time: Array, count: int, seconds: float) -> Index:
    """The shortest candidates, at most `count`, within `seconds`."""
    order = np.argsort(time, kind="stable")[:count]
    in_time = np.cumsum(time[order]) <= seconds
    return np.asarray(order[in_time], dtype=np.intp)
