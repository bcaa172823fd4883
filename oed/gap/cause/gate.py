"""Gate: whether a gap stands out in one place where the evidence reports none.

The evidence shares its prior among forms; a gap that none of them has well may stand
out in one leg, run or stretch of time all the same. The scan over places tests that
without any prior. Its p-value, corrected for all places, can count against no gap by
this much at most: its odds are divided by B = 1 / (-e p ln p) (Sellke, Bayarri, Berger
2001).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.gap.cause import answers
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.place import locate

#: p-value below which the scan counts
SIGNIFICANT = 0.05


def reweigh(
    searches: Sequence[Search],
    hypotheses: Sequence[Hypothesis],
    shares: Array,
    rng: np.random.Generator,
) -> Array:
    """Probabilities (hypotheses,) after the scan, from those by the evidence.

    They change only where these report no gap.
    """
    groups = answers.group(searches, hypotheses, shares)
    ranked, best = answers.rank(groups)
    if ranked[0].effects:
        return shares
    search = searches[best.law]
    law = search.law_at(search.noise_level(best))
    p = locate.least_p_value(search.problem, law, rng)
    no_gap = np.array([not h.is_gap for h in hypotheses], dtype=bool)
    changed = np.where(no_gap, shares / bayes_factor(p), shares)
    return np.asarray(changed / changed.sum())


def bayes_factor(p: float) -> float:
    """Largest Bayes factor of a p-value against what it tests; 1 if not significant."""
    if not 0.0 < p <= 1.0:
        raise ValueError(f"p-value {p}: give one above 0, at most 1")
    return 1.0 / (-math.e * p * math.log(p)) if p < SIGNIFICANT else 1.0
